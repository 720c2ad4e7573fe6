"""Test the bound by enumeration within windows: it is below every choice, and exact for complete windows."""

from itertools import combinations

import numpy as np
import pytest

from cvxshear.planning.choice import choose, values_of
from cvxshear.planning.criteria import CRITERIA
from cvxshear.planning.windows import Term, log_volume, path, patterns, variance, within_window
from tests.planning.common import exhaustive, frame_model, tapered
from tests.studies.planning import gaps

NAMES = tuple(CRITERIA)


def floors(stories, number, modes=3, **keys):
    model = frame_model(tapered(stories, **keys), modes)
    return model.sensors([model.expected(np.zeros(stories))], number)


def indicator(chosen, n):
    return np.isin(np.arange(n), chosen).astype(float)


def place(chosen, first, width):
    """Return the index of a choice within a window among all choices."""
    return sum(1 << (j - first) for j in chosen if first <= j < first + width)


@pytest.mark.parametrize("number", [2, 4])
def test_the_least_path_is_that_of_all_choices(number):
    rng = np.random.default_rng(number)
    n, width = 7, 3
    values, slopes = rng.standard_normal((n - width + 1, 2**width)), rng.standard_normal(n)
    every = list(combinations(range(n), number))
    within = np.array([[values[a, place(each, a, width)] for a in range(n - width + 1)] for each in every])
    sums = within.sum(axis=1) + [slopes[list(each)].sum() for each in every]
    assert path(values, slopes, number, np.add) == (pytest.approx(sums.min()), list(every[np.argmin(sums)]))
    least, chosen = path(values, np.zeros(len(slopes)), number, np.maximum)
    assert least == within.max(axis=1).min()
    assert within[every.index(tuple(chosen))].max() == least


def test_a_windows_choice_has_the_bits_of_its_place():
    assert patterns(3)[6].tolist() == [0, 1, 1]


@pytest.mark.parametrize("logarithm", [False, True])
def test_a_term_is_nowhere_below_what_its_window_says(logarithm):
    of = floors(8, 4, stiffness_std=0.5)
    (plain,) = variance(of, np.eye(of.asked.shape[1])[10])
    term = Term(plain.base, plain.rows, plain.v, logarithm)
    rng = np.random.default_rng(1)
    shares, slopes = rng.uniform(0, 1, 8), -rng.uniform(0, 0.01, 5)
    values = within_window(term, shares, 4, 2, 3, slopes)
    outside = [0, 1, 5, 6, 7]
    for each in combinations(range(8), 4):
        at = np.linalg.inv(term.information(indicator(each, 8)))
        exact = term.v @ at @ term.v
        said = values[place(each, 2, 3)] + slopes[np.isin(outside, each)].sum()
        assert said <= (np.log(exact) if logarithm else exact) + 1e-9
    # Complete enumeration leaves no part for the tangent.
    whole = within_window(term, shares, 4, 0, 8, np.zeros(0))
    exact = term.v @ np.linalg.inv(of.subset([0, 3, 5, 6])[0]) @ term.v
    assert whole[place([0, 3, 5, 6], 0, 8)] == pytest.approx(np.log(exact) if logarithm else exact, rel=1e-9)
    assert whole[place([0, 3, 5], 0, 8)] == np.inf


def test_terms_add_up_to_the_volume_where_an_equality_ties_parameters():
    of = floors(5, 2, frame={"total_mass": 1e5})
    assert of.asked.shape[2] < of.asked.shape[1]
    shares = indicator([1, 4], 5)
    terms, constant = log_volume(of, shares)
    total = sum(np.log(each.v @ np.linalg.inv(each.information(shares)) @ each.v) for each in terms)
    assert total + constant == pytest.approx(np.linalg.slogdet(of.own(of.subset([1, 4])))[1][0], abs=1e-8)


def test_the_slopes_of_a_term_are_those_of_differences():
    of = floors(5, 3)
    shares = np.full(5, 0.6)
    for term in (*variance(of, np.eye(of.asked.shape[1])[3]), *log_volume(of, shares)[0][:2]):

        def value(w, term=term):
            exact = term.v @ np.linalg.inv(term.information(w)) @ term.v
            return np.log(exact) if term.logarithm else exact

        slow = [(value(shares + 1e-6 * unit) - value(shares - 1e-6 * unit)) / 2e-6 for unit in np.eye(5)]
        np.testing.assert_allclose(term.slopes(shares), slow, rtol=1e-5, atol=1e-9 * np.abs(slow).max())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("std", [0.05, 0.5])
def test_no_choice_is_below_the_windows_bound(name, std):
    """Enumerate all choices of four out of ten; compare bounds from arbitrary shares and windows of any width."""
    of, by = floors(10, 4, stiffness_std=std, mass_std=std / 2), CRITERIA[name]
    best = exhaustive(of, 4, by)[0]
    rough = np.random.default_rng(2).uniform(0, 1, 10)
    bounds = []
    for width in (2, 5, 8):
        for shares in (np.full(10, 0.4), rough):
            bound, chosen = by.windowed(of, shares, 4, width, np.inf)
            assert bound <= best * (1 + 1e-9)
            assert len(chosen) == 4
        bounds.append(by.windowed(of, np.full(10, 0.4), 4, width, np.inf)[0])
    assert bounds[-1] > 0.97 * best
    whole, chosen = by.windowed(of, rough, 4, 10, np.inf)
    if name in ("D", "A"):
        assert whole == pytest.approx(best, rel=1e-8)
        assert values_of(of, [chosen], by)[0] == pytest.approx(best)


@pytest.mark.parametrize("name", NAMES)
def test_vague_design_values_leave_a_gap_of_five_percent_at_most(name):
    """The convex program alone has a gap of up to 110 %."""
    of, by = floors(15, 8, modes=4, stiffness_std=0.6, mass_std=0.12), CRITERIA[name]
    found, alone = choose(of, 8, by, enumerate_up_to=0), choose(of, 8, by, enumerate_up_to=0, widths=())
    assert found.gap <= 0.05
    assert alone.gap > 0.15
    assert found.value <= alone.value


def test_the_study_of_gaps_runs():
    rows = list(gaps(frames=1, shortest=6, tallest=8))
    assert [row[0] for row in rows] == list(NAMES)
    assert all(0 <= after <= before + 1e-9 for _, _, before, after, _ in rows)
