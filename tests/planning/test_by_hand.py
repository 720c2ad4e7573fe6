"""Test limits, grids, targets and texts of plans with given numbers, and odds of verdicts by normal laws."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cvxshear.effects import LocatedEffect, Place, Scale, named
from cvxshear.planning import planner
from cvxshear.planning.chances import Target, _distances, _place, _right, chances, target
from cvxshear.planning.design import Design
from cvxshear.planning.planner import MassLimits, _names, _which
from cvxshear.planning.results import Plan
from cvxshear.util.errors import InputError


def put(name, **place):
    return LocatedEffect(named([name])[0], Place(**place))


def test_limits_are_of_each_floor_and_of_all_together():
    none = MassLimits.of(None, None, 3)
    assert (none.floor.tolist(), none.total, none.any) == ([0.0] * 3, 0.0, False)
    assert (MassLimits.of(2.0, None, 3).floor.tolist(), MassLimits.of(2.0, None, 3).total) == ([2.0] * 3, 6.0)
    assert MassLimits.of([1.0, 2.0], 9.0, 2).total == 3.0
    assert (MassLimits.of([1.0, 2.0], 2.5, 2).total, MassLimits.of(1.0, 2.5, 2).any) == (2.5, True)
    with pytest.raises(InputError, match="needs one of each floor"):
        MassLimits.of(None, 3.0, 3)


def test_the_grid_is_of_single_floors_all_and_halves_within_the_limits():
    grid = [tuple(test) for test in MassLimits(np.array([2.0, 4.0, 6.0]), 8.0).grid()]
    ends = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 2, 0), (0, 4, 0), (0, 0, 3), (0, 0, 6), (1, 2, 3),
            (16 / 12, 32 / 12, 4), (0, 2, 3), (0, 3.2, 4.8)]  # fmt: skip
    np.testing.assert_allclose(sorted(grid), sorted(map(tuple, np.array(ends, dtype=float))))
    two = MassLimits(np.array([2.0, 0.0]), 2.0).grid()
    assert sorted(map(tuple, two)) == [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]
    limits = MassLimits(np.array([2.0, 3.0]), 4.0)
    np.testing.assert_allclose(limits.practical(np.array([1.0049, 1.234])), [0.99, 1.23])
    np.testing.assert_allclose(limits.practical(np.array([2.01, 1.0])), [2.0, 0.99])
    np.testing.assert_allclose(limits.practical(np.array([2.0, 3.0])), [1.6, 2.4])


def test_modes_and_names_are_those_that_are_free():
    design = SimpleNamespace(stories=6, declared=())
    assert _which(None, design).tolist() == [0, 1, 2, 3]
    assert _which(None, SimpleNamespace(stories=3, declared=())).tolist() == [0, 1, 2]
    tests = (SimpleNamespace(modes=np.array([1, 3]), name="planned test 2"), SimpleNamespace(name="other"))
    measured = SimpleNamespace(stories=6, declared=tests)
    assert _which(None, measured).tolist() == [0, 2]
    assert _which(5, measured).tolist() == [0, 1, 2, 3, 4]
    assert _which([2, 6], measured).tolist() == [1, 5]
    for wrong in (7, 0, [2, 7], [3, 2]):
        with pytest.raises(InputError, match="modes"):
            _which(wrong, measured)
    assert _names(measured, 3) == ["planned test 1", "planned test 3", "planned test 4"]


def plan_of(**more):
    """Return a plan with only the named entries."""
    made = object.__new__(Plan)
    for key, value in more.items():
        object.__setattr__(made, key, value)
    return made


@pytest.mark.parametrize(("worst", "arbitrary"), [(1.0099, True), (1.0101, False), (None, True)])
def test_masses_are_arbitrary_where_all_tests_are_within_a_hundredth(worst, arbitrary):
    assert plan_of(grid_bound=1.0, grid_worst=worst).arbitrary_masses is arbitrary
    assert plan_of(grid_bound=None, grid_worst=None).arbitrary_masses is False


@pytest.mark.parametrize(("largest", "said"), [(-0.021, True), (0.019, False)])
def test_the_measured_frequency_farthest_from_the_frame_is_said_beyond_two_percent(largest, said):
    found = [SimpleNamespace(error=each) for each in (0.01, largest, -0.005)]
    design = SimpleNamespace(measured_frequencies=lambda: found, stories=4)
    averaged = SimpleNamespace(frames=[SimpleNamespace(design=design)] * 3)
    made = plan_of(averaged=averaged)
    assert made.misfit is (found[1] if said else None)
    design.measured_frequencies = list
    assert made.misfit is None
    assert made.frames == 3
    chosen = SimpleNamespace(floors=np.array([2, 4]), objective=0.3, bound=0.25, gap=0.2, arbitrary=True)
    made = plan_of(averaged=averaged, chosen=chosen, names=("a",), tests=(np.array([1.0]),))
    assert (made.sensors, made.objective, made.bound, made.gap) == ([2, 4], 0.3, 0.25, 0.2)
    assert made.floors_arbitrary
    design.stories = 2
    assert not made.floors_arbitrary
    assert made.planned_tests == [{"name": "a", "added_mass": made.tests[0]}]


def test_units_of_effects_are_their_distance_from_null_or_from_where_they_start():
    items = [SimpleNamespace(null=null, start=start) for null, start in ((1.0, 1.5), (0.0, 0.2), (3.0, 3.0))]
    design = SimpleNamespace(
        effects=[SimpleNamespace(effect=SimpleNamespace(parameters=items))], values=np.array([0.4, 0.0, 3.0]),
        sizes=np.array([5.0, 7.0]),
    )  # fmt: skip
    np.testing.assert_allclose(Design.units.fget(design), [5.0, 7.0, 0.6, 0.2, 1.0])


SCALE = Scale(10.0, 2e4, np.array([3.0, 3.0, 3.0]))
FRAME = SimpleNamespace(stories=3, story_heights=np.array([3.0, 3.0, 3.0]))


def test_a_target_is_an_effect_at_its_place_of_a_usual_size():
    found = target("ground_spring@2=500", FRAME, SCALE)
    assert (found.placed, found.size, found.unit) == (put("ground_spring", floor=2), 500.0, "N/m")
    spring = named(["ground_spring"])[0]
    assert target("ground_spring @ 3", FRAME, SCALE).size == pytest.approx(float(spring.expected_sizes(SCALE)[0]))
    gravity = target("gravity", FRAME, SCALE)
    item = gravity.placed.effect.parameters[0]
    assert gravity.size == pytest.approx(abs(item.start - item.null))
    # The size is uniform between 1 and 1.2 if the effect is present, and 0 otherwise.
    assert (gravity.mean, gravity.side) == (1.0, 0)
    assert gravity.std == pytest.approx(stats.uniform(1.0, 0.2).std() / gravity.size)
    assert (found.mean, found.std, found.side, found.null) == (0.0, 1.0, 1, 0.0)
    for text, said in (("gravity@1", "no place"), ("ground_spring", "sits at a floor"), ("ground_spring@4", "floor of"),
                       ("ground_spring@2=x", "must be a number"), ("added_mass@1", "single state")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            target(text, FRAME, SCALE)
    assert _place("x", ("story",), 2, "1", 3) == Place(story=1)
    with pytest.raises(InputError, match="floor of effect x"):
        _place("x", ("floor",), 2, "1", 3)


def test_an_effect_is_as_far_from_another_as_what_that_cannot_do_like_it():
    """Vectors along (1, 0) and (0.6, 0.8): distance is length times sine, or the length for opposite one-sided ones."""
    one, other = 3.0 * np.array([1.0, 0.0]), 2.0 * np.array([0.6, 0.8])
    G = np.array([[one @ one, one @ other], [one @ other, other @ other]])
    sided = [Target(put("ground_spring", floor=floor), 100.0, "N/m") for floor in (2, 3)]
    np.testing.assert_allclose(_distances(sided, G), [[0.0, 2.4], [1.6, 0.0]], atol=1e-12)
    against = G * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(_distances(sided, against), [[0.0, 3.0], [2.0, 0.0]], atol=1e-12)
    free = [sided[0], Target(put("sensor_gain", floor=3), 0.05)]
    np.testing.assert_allclose(_distances(free, against), [[0.0, 2.4], [2.0, 0.0]], atol=1e-12)
    none, first, second = chances(sided, np.array([G, 4.0 * G]))
    assert (none.label, none.nearest_distance, none.distance) == ("none of them", pytest.approx(3.0), None)
    assert none.nearest == second.label
    assert (first.distance, first.nearest_distance) == (pytest.approx(4.5), pytest.approx(3.6))
    assert (second.distance, second.nearest, second.size) == (pytest.approx(3.0), first.label, 100.0)
    assert second.nearest_distance == pytest.approx(2.4)
    for chance, at in zip((none, first, second), range(3), strict=True):
        assert chance.probability == pytest.approx(np.mean([_right(sided, scale * G)[at] for scale in (1.0, 4.0)]))
        assert chance.suffices is (chance.probability >= 0.9)


def test_the_odds_of_a_right_verdict_are_those_of_a_normal_number():
    """For an effect of unit size and either sign with information g, the evidence is y^2 / 2 (1 + g) - log(1 + g) / 2.

    Odds of 19 or more name the effect; odds below 1 name no effect.
    """
    g = 25.0
    gain = Target(put("sensor_gain", floor=3), 0.05)

    def beyond(log_odds):
        return np.sqrt(2 * (1 + g) / g * (log_odds + 0.5 * np.log(1 + g)) * g)

    none, there = _right([gain], np.array([[g]]))
    limit = [beyond(each) / np.sqrt(g) for each in (0.0, np.log(19.0))]
    normal = stats.norm
    assert none == pytest.approx(1 - 2 * normal.sf(limit[0]), abs=0.006)
    assert there == pytest.approx(normal.sf(limit[1] - np.sqrt(g)) + normal.cdf(-limit[1] - np.sqrt(g)), abs=0.006)


def test_masses_and_floors_are_chosen_by_turns_until_they_stay(monkeypatch):
    """Each turn starts with the floors of the previous turn; the result lists the lightest test first."""
    limits, asked = MassLimits(np.array([2.0, 2.0, 2.0]), 6.0), []

    def choose(problem, number, by, solver, **options):
        asked.append((problem, number))
        return SimpleNamespace(chosen=np.array([3, 0] if problem[0] == "tests" else [0, 2]))

    model = SimpleNamespace(
        expected=tuple, choices=lambda tests, floors, count: ("tests", tuple(floors)),
        sensors=lambda tests, number: ("sensors", tuple(tests)),
    )  # fmt: skip
    monkeypatch.setattr(planner, "choose", choose)
    monkeypatch.setattr(planner, "refined", lambda model, tests, floors, by, limits: tests)
    found = planner._masses(model, 2, 2, None, limits, "clarabel")
    grid = limits.grid()
    assert [test.tolist() for test in found] == [grid[0].tolist(), grid[3].tolist()]
    assert [each[0][0] for each in asked] == ["tests", "sensors", "tests", "sensors"]
    assert (asked[0][0][1], asked[2][0][1]) == ((0, 1, 2), (0, 2))
    asked.clear()
    planner._masses(model, 3, 2, None, limits, "clarabel")
    assert len(asked) == 1
    with pytest.raises(InputError, match=f"more than the {len(grid)} that"):
        planner._masses(model, 3, len(grid) + 1, None, limits, "clarabel")
