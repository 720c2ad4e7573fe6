"""Compare the bounds in the documentation with the code, and the measured table with its promised limits."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cvxshear.paper import paper_setups
from cvxshear.paper.setups import bound, six_story
from cvxshear.report.describe.studied import in_percent

DOCUMENTED = (Path(__file__).parents[2] / "docs" / "noise-study.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "setup", [*paper_setups(), six_story()], ids=lambda each: f"{each.stories}-{each.mode_shape_std}"
)
def test_the_bounds(setup):
    assert f"Cramér-Rao bound, % | {' | '.join(in_percent(bound(setup) / setup.truth))} |" in DOCUMENTED


@pytest.mark.parametrize("floor", range(1, 7))
def test_the_bound_by_the_floor_without_a_sensor(floor):
    setup = replace(six_story(), measured_floors=np.delete(np.arange(1, 7), floor - 1))
    largest = np.max(bound(setup) / setup.truth)
    assert re.search(rf"^\| {floor} \| {100 * largest:.1f} \|", DOCUMENTED, re.MULTILINE)


def test_the_measured_efficiency_and_coverage():
    """Read six tables. In each, the efficient method's lines follow its name."""
    efficient = [part.split("\n\n")[0] for part in DOCUMENTED.split("| efficient | bias, %")[1:]]
    assert len(efficient) == 6
    for table in efficient:
        ratios, held = (
            np.array(line.split("|")[3:-1], dtype=float)
            for line in table.splitlines()
            if line.startswith(("|  | error / bound", "|  | truth in the 95 %"))
        )
        assert np.max(ratios) <= 1.10
        assert np.all((held >= 93) & (held <= 97))
