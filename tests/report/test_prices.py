"""Test the printed prices of active bounds and exact priors, and how a backend's answers were accepted."""

import dataclasses
import re

import pytest

import cvxshear
from cvxshear.priors import Bounds
from cvxshear.report.describe import describe
from cvxshear.report.terminal import notebook_html

PRICE = re.compile(r"one more N/m on the upper bound of story stiffness 1 would lower the misfit by ([\d.e-]+)")
HOW = ("as_given", "polished", "replaced")


@pytest.fixture(scope="module")
def example():
    """Return the paper's example with declared noise."""
    declared = cvxshear.load("paper").to_dict()
    for each in declared["configuration"]:
        each |= {"frequency_std": 0.002, "mode_shape_std": 0.01}
    return cvxshear.Experiment.from_dict(declared)


def limited(example, upper):
    prior = Bounds("story_stiffness", upper=[upper, 1e9])
    return cvxshear.identify(dataclasses.replace(example, priors=(prior,)))


def test_a_printed_price_is_what_a_wider_bound_gains(example):
    held, wider = limited(example, 23500.0), limited(example, 23501.0)
    (price,) = PRICE.findall(" ".join(str(held).split()))
    assert float(price) == pytest.approx(held.parts[0].fit.chi2 - wider.parts[0].fit.chi2, rel=0.02)
    assert PRICE.search(" ".join(notebook_html(held).split()))
    (as_json,) = held.to_dict()["active"]
    assert float(price) == pytest.approx(as_json["dual"], rel=0.01)


def test_nothing_is_printed_where_no_bound_is_active(example):
    for result in (cvxshear.identify(example), limited(example, 1e9)):
        assert "price" not in str(result)


def test_accepted_polished_and_replaced_answers_are_printed(comparison):
    (table,) = next(each for each in describe(comparison).sections if each.key == "worst").parts
    assert table.head[2:5] == ("as given", "polished", "replaced")
    for name, solved, *accepted in (row[:5] for row in table.rows):
        rows = [each for each in comparison.rows if each.backend == name]
        assert list(map(int, accepted)) == [sum(getattr(x, how) for x in rows) for how in HOW]
        assert sum(map(int, accepted)) >= int(solved.split()[0])
    assert all(word in str(comparison) for word in table.head[3:5])
