"""Rounding does not change these orders."""

import numpy as np
import pytest

from cvxshear.util import ranking

HALF = np.sqrt(0.5)


@pytest.mark.parametrize("off", [-4, -1, 0, 1, 4])
def test_entries_that_differ_by_rounding_go_by_position(off):
    other = HALF + off * np.spacing(HALF)
    assert ranking.order([0.1, HALF, other]) == [1, 2, 0]
    assert ranking.first_largest([HALF, 0.1, other]) == 0
    assert ranking.largest(np.array([[HALF, other], [other, 1.0]])).tolist() == [0, 1]
    assert ranking.ranked(["b", "a"], {"a": other, "b": HALF}.__getitem__) == ["b", "a"]


def test_other_values_are_sorted_the_largest_first():
    values = np.random.default_rng(3).normal(size=50)
    assert ranking.order(values) == np.argsort(-values).tolist()
    assert ranking.first_largest(values) == np.argmax(values)


def test_small_differences_count_beside_a_large_value():
    assert ranking.order([1e12, 1.0, 2.0]) == [0, 2, 1]


def test_infinite_values_are_equal_and_nan_comes_last():
    assert ranking.order([np.nan, -np.inf, np.inf, 1.0, np.inf]) == [2, 4, 3, 1, 0]


def test_log_odds_have_an_absolute_margin():
    assert ranking.ranked("ab", {"a": -300.00005, "b": -300.0}.__getitem__, same=ranking.SAME_ODDS) == ["a", "b"]
    assert ranking.ranked("ab", {"a": -300.0005, "b": -300.0}.__getitem__, same=ranking.SAME_ODDS) == ["b", "a"]


def test_probabilities_are_likelihood_times_prior_over_their_sum():
    likelihood, prior = np.array([0.2, 0.5, 0.0]), np.array([0.9, 0.05, 0.05])
    with np.errstate(divide="ignore"):
        found = ranking.weigh(np.log(likelihood) - 2000.0, np.log(prior))
    np.testing.assert_allclose(found, likelihood * prior / (likelihood @ prior), rtol=1e-12)
    many = ranking.weigh(np.log(np.array([[1.0, 3.0], [1.0, 1.0]])))
    np.testing.assert_allclose(many, [[0.25, 0.75], [0.5, 0.5]])
