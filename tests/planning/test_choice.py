"""Test the convex program and the choice: valid bounds, agreeing solvers, exchange against enumeration."""

import numpy as np
import pytest

from cvxshear.planning.choice import CRITERIA, choose, equally_spaced, exchanged, relaxed, values_of
from cvxshear.planning.planner import mass_grid
from tests.planning.common import exhaustive, frame_model, information_of, tapered
from tests.studies.planning import OTHERS, beside_others, floors_of, random_frame

NAMES = tuple(CRITERIA)


def floors(stories, number, modes=3, **keys):
    model = frame_model(tapered(stories, **keys), modes)
    return model.sensors([model.expected(np.zeros(stories))], number)


@pytest.mark.parametrize("name", NAMES)
def test_a_criterion_is_what_it_says(name):
    of = floors(5, 3)
    information = information_of(of, [0, 2, 4])
    covariance = of.covariance(of.own(information))
    eigenvalues = np.linalg.eigvalsh(covariance)
    expected = {
        "D": np.exp(np.mean(np.log(eigenvalues)) / 2),
        "A": np.sqrt(np.mean(np.diag(covariance))),
        "E": np.sqrt(eigenvalues[-1]),
    }
    assert CRITERIA[name].value(of, information) == pytest.approx(expected[name], rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_no_choice_is_below_the_bound(name):
    """Enumerate all choices of four out of ten, also for rough shares."""
    of = floors(10, 4)
    by = CRITERIA[name]
    best, chosen = exhaustive(of, 4, by)
    found = choose(of, 4, by, enumerate_up_to=0)
    assert found.bound <= best <= found.value * (1 + 1e-9)
    assert found.value <= 1.001 * best
    assert 1 - found.bound / best < 0.3
    rng, p = np.random.default_rng(2), len(of.base)
    for _ in range(20):
        rough, dual = rng.uniform(0, 1, 10), rng.normal(size=(p, p))
        assert by.bound(of, rough * 4 / rough.sum(), 4, dual + dual.T) <= best
        own = of.own(of.information(rough))
        assert by.tangent(of, own, 1e6 * (dual + dual.T))[0] <= by.measure(of, own) + 1e-9
    assert choose(of, 4, by).bound == choose(of, 4, by).value == pytest.approx(best)
    assert list(choose(of, 4, by).chosen) == chosen
    assert choose(of, 4, by).gap == 0.0


@pytest.mark.parametrize("name", NAMES)
def test_the_program_ends_where_its_bound_is(name):
    """The bound is within 0.001 of the value at the shares, so both are optimal within this gap."""
    of = floors(10, 4)
    by = CRITERIA[name]
    weights, bound = relaxed(of, 4, by)
    assert weights.sum() == pytest.approx(4.0, abs=1e-4)
    at_shares = float(by.value(of, of.information(weights)))
    assert bound <= at_shares <= 1.001 * bound


def test_equal_distances_are_those_of_the_e_defense_frame():
    """Eighteen stories have sensors at floors 3, 6, 9, 12, 15, 18; an odd height also has one at the top floor."""
    assert [floor + 1 for floor in equally_spaced(18, 6)] == [3, 6, 9, 12, 15, 18]
    assert equally_spaced(7, 2) == [3, 6]


def test_a_tall_frames_gap_is_small():
    of, _ = floors_of(random_frame(np.random.default_rng(24), 24), 6)
    assert choose(of, 6, CRITERIA["D"]).gap < 0.05


def test_an_exchange_takes_the_best_neighbour():
    of, by = floors(7, 3), CRITERIA["A"]
    value, chosen = exchanged(of, [0, 1, 2], by)
    neighbours = [sorted({*chosen} - {out} | {into}) for out in chosen for into in range(7) if into not in chosen]
    assert value <= values_of(of, neighbours, by).min() * (1 + 1e-9)
    assert value == pytest.approx(float(by.value(of, information_of(of, chosen))))


def test_the_choice_is_never_worse_than_the_others():
    pytest.importorskip("pysensors")
    for name, ratios in beside_others(frames=2, seed=3, tallest=8).items():
        assert ratios.shape == (2, len(OTHERS))
        assert ratios.min() >= 1 - 1e-9, name


def test_the_grid_has_single_floors_all_and_halves_at_the_limit_and_half_of_it():
    grid = np.array(mass_grid(np.array([10.0, 4.0, 6.0])))
    for wanted in ([0, 0, 0], [10, 0, 0], [5, 0, 0], [0, 4, 0], [0, 0, 6], [10, 4, 6], [5, 2, 3], [0, 4, 6], [0, 2, 3]):
        assert np.sum(np.all(np.isclose(grid, wanted), axis=1)) == 1, wanted
    assert sorted(map(tuple, mass_grid(np.array([2.0, 0.0])))) == [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]
