"""Test single decisions of the loop with given numbers: the sets tried, the sets kept, and the messages."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats

from cvxshear import Experiment
from cvxshear.effects import LocatedEffect, Place, catalogue, open_classes
from cvxshear.loop import conclusion, held_out, next_test, residual, search, searches
from cvxshear.loop.conclusion import Posterior
from cvxshear.loop.evidence import _multipliers
from cvxshear.loop.fitter import ModelClass
from cvxshear.loop.hypotheses import Hypothesis, hypotheses
from cvxshear.loop.neighbors import groups, promising
from cvxshear.loop.posterior import replacement
from cvxshear.loop.search import Search, fits_alike
from cvxshear.loop.twins import Invariances, dual_fits_as_well, dual_frame, few_floors_seen
from cvxshear.loop.verdicts import FIELDS, VERDICTS
from cvxshear.priors.base import Constraints
from tests.frames import configuration, experiment


def put(name, **place):
    return LocatedEffect(next(each for each in (*catalogue(), *open_classes()) if each.name == name), Place(**place))


GAIN_1, GAIN_2, GAIN_3 = (put("sensor_gain", floor=floor) for floor in (1, 2, 3))
MASS_1, MASS_2 = (put("added_mass", floor=floor, state="b") for floor in (1, 2))
CHANGE, TIED = put("story_change", story=1, state="b"), put("other_stiffness")


def test_groups_are_of_a_state_of_a_name_all_and_single_open_classes():
    effects = frozenset([GAIN_1, GAIN_2, MASS_1, CHANGE, TIED])
    expected = [{MASS_1, CHANGE}, {GAIN_1, GAIN_2}, effects]
    for open_too in (False, True):
        found = groups(effects, open_too=open_too)
        assert sorted(map(len, found)) == ([1] if open_too else []) + [2, 2, 5]
        assert all(each in found for each in (*map(frozenset, expected), *([frozenset([TIED])] if open_too else [])))


def linearised(gains, forward=()):
    """Return gains of four effects, as a linearised model states them."""
    return SimpleNamespace(
        lacking=[GAIN_1, GAIN_2, MASS_1, CHANGE], gains=np.array(gains, dtype=float), forward=lambda odds: list(forward)
    )


def model_of(*effects, score=0.0, improbable=False, objective=1.0, rows=9, **more):
    fit = SimpleNamespace(at=SimpleNamespace(objective=objective, r=np.zeros(rows)), converged=True)
    estimate = SimpleNamespace(fit=fit, effects=tuple(effects), improbable=improbable, **more)
    return ModelClass(frozenset(effects), estimate, score - 0.0, 0.0)


FITTER = SimpleNamespace(log_priors=lambda lacking, beside: np.full(len(lacking), -4.0))


def test_further_effects_are_tried_as_far_as_they_may_catch_up():
    linear = linearised([14.0, 3.0, 12.0, -9.0], forward=[GAIN_1, MASS_1])
    singles = [set(each) for each in promising(model_of(), linear, FITTER, 0.0) if len(each) == 1]
    worth = {GAIN_1: 10.0, MASS_1: 8.0, GAIN_2: -1.0, CHANGE: -13.0}
    assert singles == [{placed} for placed in worth if placed is GAIN_1 or worth[placed] > 10.0 - 7.0]
    behind = [set(each) for each in promising(model_of(), linear, FITTER, 9.0 + 7.0) if len(each) == 1]
    assert behind == [{GAIN_1}]
    assert promising(model_of(), linear, FITTER, 0.0)[-1] == {GAIN_1, MASS_1}
    # The residuals are impossible, so the order alone counts.
    far = promising(model_of(objective=1e9), linear, FITTER, 0.0)
    assert [set(each) for each in far if len(each) == 1][:3] == [{GAIN_1}, {MASS_1}, {GAIN_2}]


def test_sets_fit_alike_within_a_tenth_of_chi_square_and_of_one():
    def with_chi2(chi2):
        return model_of(chi2=chi2)

    assert fits_alike(with_chi2(20.0), with_chi2(21.9))
    assert not fits_alike(with_chi2(20.0), with_chi2(22.3))
    assert fits_alike(with_chi2(0.5), with_chi2(0.59))
    assert not fits_alike(with_chi2(0.5), with_chi2(0.61))
    assert not fits_alike(with_chi2(0.5), ModelClass(frozenset(), None, -np.inf, 0.0))


def test_the_strength_of_an_effect_is_its_distance_from_null_in_deviations():
    gravity = put("gravity")
    estimate = SimpleNamespace(theta=np.array([9.0, 0.3, 1.1]), std=np.array([1.0, 0.1, np.nan]),
                               own=lambda placed: slice(1, 2) if placed is GAIN_1 else slice(2, 3))  # fmt: skip
    assert search._strength(estimate, GAIN_1) == pytest.approx(3.0)
    assert search._strength(estimate, gravity) == 0.0


def searched(*models, improbable=False):
    """Return a search that visited some sets, starting with the shear model."""
    found = object.__new__(Search)
    found.visited = {each.effects: each for each in models}
    found.base = models[0]
    found.pruned, found.expanded, found.reduced, found.regrouped = set(), set(), set(), set()
    return found


def test_the_beam_is_of_the_best_and_of_open_classes_that_add_to_no_better_set():
    items = [put("sensor_gain", floor=floor) for floor in range(1, 9)]
    models = [model_of(score=0.0), *(model_of(item, score=10.0 - k) for k, item in enumerate(items))]
    others = [put(name) for name in ("other_stiffness", "other_inertia", "other_gains")]
    models += [model_of(other, score=9.5 - k) for k, other in enumerate(others)]
    models += [model_of(others[0], items[0], score=8.9), model_of(others[0], items[1], score=20.0)]
    beam = searched(*models).beam
    assert [each.score for each in beam] == [20.0, 10.0, 9.5, 9.0, 8.5, 8.0, 7.0, 6.0, 5.0]
    # A set that only extends a better set is rarely expanded. The best set is, and every set if no set explains the
    # data.
    found = searched(models[0], model_of(items[0], score=9.0), model_of(items[0], items[1], score=6.9),
                     model_of(items[0], items[2], score=7.1), model_of(others[0], score=8.9))  # fmt: skip
    worth = {frozenset(each.effects): found._worth_following(each) for each in found.visited.values()}
    assert list(worth.values()) == [True, True, False, True, False]
    assert found._next(set(), 0.0) is found.best
    assert found._next({found.best.effects}, 1.5) is None
    assert found._next({found.best.effects}, 2.0).effects == {items[0], items[2]}


def test_a_better_fit_of_a_set_replaces_the_other_and_its_neighbors_are_looked_at_again():
    first = model_of(GAIN_1, score=1.0)
    found = searched(model_of(), first)
    found.expanded.add(first.effects)
    assert not found._record([model_of(GAIN_1, score=1.0)])
    assert found.visited[first.effects] is first
    better = model_of(GAIN_1, score=3.0)
    assert found._record([better, model_of(GAIN_2)])
    assert (found.visited[first.effects], found.expanded) == (better, set())


class Probed:
    """A search with a given best set, which records its calls."""

    def __init__(self, base, best, *, improbable=False, after=None):
        self.base = SimpleNamespace(score=base, improbable=improbable)
        self.best = SimpleNamespace(score=best, improbable=improbable, effects=frozenset())
        self.beam = [SimpleNamespace(effects=frozenset([at])) for at in range(5)]
        self.after, self.asked = after, []

    def probe(self):
        self.asked.append("probe")

    def run(self):
        self.asked.append("run")
        self.best.score = self.best.score if self.after is None else self.after

    def visit(self, sets):
        self.asked.append(len(list(sets)))


def test_the_most_promising_numberings_are_probed_and_the_best_leads():
    given = Probed(-9.0, 1.0)
    others = [Probed(float(base), 2.0 + base) for base in range(5)]
    assert searches._leader(given, others) is others[4]
    assert [each.asked for each in (given, *others)] == [["probe"], [], [], ["probe"], ["probe"], ["probe"]]
    assert searches._leader(given, []) is given


def test_what_is_near_the_best_numbering_is_searched_to_its_end():
    leader = Probed(0.0, 50.0)
    near, far, later = Probed(-10.0, 31.0), Probed(-20.0, 29.0), Probed(-30.0, 31.0, after=75.0)
    behind, hopeless = Probed(-40.0, 50.0 + 25.0 - 19.0), Probed(-101.0, 90.0)
    given = Probed(-300.0, -49.0)
    kept = searches._near(given, [leader, near, far, later, behind, hopeless], leader)
    assert kept == [given, leader, near, later, behind]
    assert (near.asked, far.asked, hopeless.asked, given.asked) == ([3, "run"], [3], [], [3])
    for given, runs in ((Probed(-300.0, -49.0), True), (Probed(-300.0, -51.0), False)):
        assert searches._near(given, [leader], leader) == [given, leader]
        assert ("run" in given.asked) is runs
    unsure = Probed(0.0, 50.0, improbable=True)
    given, hopeless = Probed(-300.0, -51.0), Probed(-101.0, 45.0)
    assert searches._near(given, [unsure, hopeless], unsure) == [given, unsure, hopeless]
    assert given.asked == [3, "run"]


def posterior(*models, prior=0.02):
    known = [GAIN_1, GAIN_2, GAIN_3, MASS_1, MASS_2, CHANGE, TIED]
    made = [ModelClass(frozenset(effects), SimpleNamespace(effects=tuple(effects), chi2=20.0, dof=9), float(np.log(p)),
                       0.0) for effects, p in models]  # fmt: skip
    return Posterior(made, [Hypothesis(placed, prior) for placed in known])


def test_effects_as_probable_are_ranked_by_what_changed_first():
    of = posterior(([GAIN_2], 0.3), ([MASS_1], 0.298), ([GAIN_1], 0.3), ([CHANGE], 0.1))
    assert of.ranked([GAIN_1, GAIN_2, MASS_1, CHANGE]) == [MASS_1, GAIN_1, GAIN_2, CHANGE]
    chance = {GAIN_1: 0.1, MASS_1: 0.098, CHANGE: 0.0985}
    assert of.ranked(chance, chance) == [GAIN_1, MASS_1, CHANGE]


def test_what_replaces_an_effect_is_of_its_state_then_of_its_kind():
    come = frozenset([GAIN_2, MASS_2])
    assert replacement(GAIN_1, frozenset([GAIN_1, CHANGE]), come) is GAIN_2
    assert replacement(CHANGE, frozenset([GAIN_1, CHANGE]), come) is MASS_2
    assert replacement(GAIN_1, frozenset([GAIN_1, GAIN_3]), frozenset([GAIN_2])) is GAIN_2
    assert replacement(GAIN_3, frozenset([GAIN_1, GAIN_3]), frozenset([GAIN_2])) is None
    assert replacement(GAIN_1, frozenset([GAIN_1]), frozenset()) is None


def test_sets_are_shown_from_a_thousandth_on_each_once():
    of = posterior(([GAIN_1], 0.6), ([GAIN_2], 0.3985), ([GAIN_3], 0.0011), ([MASS_1], 0.0004))
    shown = list(conclusion._shown_sets(of))
    assert [(each.effects, round(each.probability, 4)) for each in shown] == [
        ((GAIN_1,), 0.6), ((GAIN_2,), 0.3985), ((GAIN_3,), 0.0011)
    ]  # fmt: skip


def test_rival_sets_are_twins_and_then_what_may_be_there_without_the_effect():
    of = posterior(([GAIN_1], 0.5), ([GAIN_1, MASS_1], 0.2), ([GAIN_2], 0.2), ([GAIN_3], 0.024), ([], 0.076))
    rivals = [SimpleNamespace(placed=GAIN_3, twin=True), SimpleNamespace(placed=GAIN_2, twin=False)]
    added = SimpleNamespace(placed=GAIN_1, rivals=rivals)
    assert conclusion._rival_sets(of, [added]) == [{GAIN_3}, {GAIN_2}, frozenset()]
    assert conclusion._rival_sets(of, [SimpleNamespace(placed=GAIN_1, rivals=[])]) == []


@pytest.mark.parametrize(
    ("probabilities", "twin", "dof", "numbers", "kind", "expected"),
    [
        ([0.96, 0.97], False, 3, 1.0, GAIN_1, "explained"), ([0.96, 0.94], False, 3, 1.0, GAIN_1, "ambiguous"),
        ([0.96], True, 3, 1.0, GAIN_1, "ambiguous"), ([0.96], False, 0, 1.0, GAIN_1, "ambiguous"),
        ([0.96], False, 3, 0.94, GAIN_1, "ambiguous"), ([0.96], False, 3, 1.0, TIED, "located"),
        ([], False, 3, 0.91, GAIN_1, "adequate"), ([], False, 3, 0.89, GAIN_1, "ambiguous"),
        ([], False, 0, 0.91, GAIN_1, "ambiguous"),
    ],
)  # fmt: skip
def test_the_verdict(probabilities, twin, dof, numbers, kind, expected):
    added = [SimpleNamespace(placed=kind, probability=each, rivals=[SimpleNamespace(twin=twin)]) for each in
             probabilities]  # fmt: skip
    numbering = SimpleNamespace(changes=(), probability=numbers)
    for something, verdict in ((0.49, expected), (0.51, "ambiguous" if not added else expected)):
        of = SimpleNamespace(something=lambda something=something: something)
        found = conclusion._verdict(added, of, numbering, SimpleNamespace(dof=dof), unexplained=False)
        assert found == verdict
    assert conclusion._verdict(added, of, numbering, SimpleNamespace(dof=dof), unexplained=True) == "unexplained"
    changed = SimpleNamespace(changes=("a",), probability=0.96)
    if not added:
        assert conclusion._verdict(added, of, changed, SimpleNamespace(dof=3), unexplained=False) == "explained"


def test_a_residual_is_negligible_where_every_kind_of_data_says_so():
    def estimate(errors, *limits):
        noises = {name: SimpleNamespace(leading=limit and SimpleNamespace(key=name), negligible=limit) for name, limit
                  in limits}  # fmt: skip
        return SimpleNamespace(quality=SimpleNamespace(errors=errors), misfit=SimpleNamespace(noises=noises))

    limits = ("a", 0.001), ("b", 0.01)
    assert conclusion._negligible(estimate({"a": 0.0009, "b": 0.009}, *limits))
    assert conclusion._negligible(estimate({"a": None, "b": 0.009}, *limits))
    assert not conclusion._negligible(estimate({"a": 0.0009, "b": 0.011}, *limits))
    assert not conclusion._negligible(estimate({"a": 0.0009, "b": 0.0}, ("a", 0.001), ("b", None)))


@pytest.mark.parametrize(("value", "std", "said"), [
    (1e-9, 0.05, ["lower"]), (0.9e-4, 0.1, ["lower"]), (1.1e-4, 0.1, []), (1.9999, 0.2, ["upper"]),
    (1.9997, 0.2, []), (1.9981, np.inf, ["upper"]), (1.997, np.inf, []),
])  # fmt: skip
def test_a_parameter_at_an_end_is_said_by_a_thousandth_of_its_deviation(value, std, said):
    item = SimpleNamespace(name="x", lower=0.0, upper=2.0)
    placed = SimpleNamespace(effect=SimpleNamespace(parameters=(item,)))
    misfit = SimpleNamespace(expectation=SimpleNamespace(of=lambda placed: [std]))
    final = SimpleNamespace(theta=np.array([value]), own=lambda placed: slice(0, 1), misfit=misfit)
    assert list(conclusion._remarks(final, placed)) == [f"x is at the {end} end of what is physical" for end in said]


def test_what_was_not_visited_is_no_more_probable_than_before():
    linear = SimpleNamespace(lacking=[GAIN_1, GAIN_2], gains=np.array([3.0, -1.0]))
    fitter = SimpleNamespace(log_priors=lambda lacking, effects: np.array([-4.0, -2.0]))
    found = conclusion._unseen(linear, fitter, model_of())
    assert found == {GAIN_1: pytest.approx(1 / (1 + np.exp(4.0))), GAIN_2: pytest.approx(1 / (1 + np.exp(3.0)))}


def test_what_speaks_for_a_verdict_is_the_noise_stated_or_estimated():
    def said(dof, open_noises):
        misfit = SimpleNamespace(open_noises=open_noises, noises={"frequency": 1, "mode_shape": 2})
        noise = SimpleNamespace(noise=SimpleNamespace(factors={"frequency": 1.5, "mode_shape": 0.25}))
        return list(conclusion._rests_on(SimpleNamespace(dof=dof, misfit=misfit, noise=noise)))

    assert said(0, ())[0].startswith("nothing that could speak against it")
    assert said(3, ()) == ["the stated standard deviations"]
    assert said(3, ("mode_shape",)) == ["stated and estimated noise (mode shape 0.25 times the default)"]
    assert said(1, ("frequency", "mode_shape")) == [
        "estimated noise (frequency 1.5 times the default, mode shape 0.25 times the default)"
    ]


def frame_of(total=None, std=None, added=(0.0,), normalized=False, measured=True):
    tests = [SimpleNamespace(added_mass=np.array([each]), mass_normalized=normalized, measured=np.array([[measured]]))
             for each in added]  # fmt: skip
    frame = SimpleNamespace(known_total=total, total_mass_std=std)
    return SimpleNamespace(fitter=SimpleNamespace(experiment=SimpleNamespace(frame=frame, configurations=tests)))


def test_masses_are_in_proportion_to_loads_or_forces_where_no_total_holds_them():
    loads = put("load_scale")

    def said(*effects, **more):
        return len(list(conclusion._granted_of_the_scale(frame_of(**more), model_of(*effects))))

    assert said(total=3.0, added=(0.0, 1.0)) == 0
    assert said(total=3.0, std=0.1, added=(0.0, 1.0)) == said(added=(1.0,)) == 1
    assert said(loads, added=(0.0, 1.0)) == said() == said(normalized=True, measured=False) == 0
    assert said(normalized=True) == 1
    assert said(normalized=True, added=(1.0,)) == 2


def test_held_out_errors_are_the_largest_over_what_both_models_predict(monkeypatch):
    errors = {("before", "a"): {("a", 0): 0.1, ("a", 1): 0.4}, ("after", "a"): {("a", 0): 0.05},
              ("before", "b"): {("b", 0): 0.02}, ("after", "b"): {("b", 0): 0.03, ("b", 1): 0.5}}  # fmt: skip
    monkeypatch.setattr(held_out, "_prediction_errors", lambda estimate, name, *_: errors[estimate.what, name])
    tests = [SimpleNamespace(name=name, state=name, frequencies=np.ones(2)) for name in "ab"]
    both = SimpleNamespace(configurations=tests)
    before, after = (SimpleNamespace(what=what, effects=(), experiment=both) for what in ("before", "after"))
    assert held_out.held_out_frequency_errors(before, after, None) == (0.1, 0.05)
    del errors["before", "b"][("b", 0)], errors["before", "a"][("a", 0)]
    assert held_out.held_out_frequency_errors(before, after, None) == (None, None)


def test_tests_are_left_out_that_the_others_can_judge():
    def tests(*states):
        each = [SimpleNamespace(name=str(k), state=state, frequencies=np.ones(3)) for k, state in enumerate(states)]
        return SimpleNamespace(configurations=each)

    def names(states, concerned):
        return [name for name, _ in held_out._left_out(tests(*states), set(concerned))]

    assert names("aab", "") == ["0", "1", "2"]
    assert names("aab", "b") == ["0", "1"]
    assert names("aab", "a") == []
    assert names("abc", "a") == ["1", "2"]
    assert names("ab", "a") == []
    assert len(names("a" * 30, "")) == 24
    only = held_out._left_out(tests("a"), set())
    assert [mask.tolist() for _, mask in only] == np.eye(3, dtype=bool).tolist()
    alone = SimpleNamespace(configurations=[SimpleNamespace(frequencies=np.ones(1), name="a")])
    assert held_out._left_out(alone, set()) == []


def test_twins_are_what_makes_the_same_derivatives_with_the_frame():
    rng = np.random.default_rng(3)
    frame, own, other = rng.standard_normal((12, 3)), rng.standard_normal((12, 1)), rng.standard_normal((12, 1))
    two = np.hstack([own, other])
    lacking = {
        GAIN_2: -2.0 * own + frame @ rng.standard_normal((3, 1)), GAIN_3: own + 2e-4 * other, MASS_1: other,
        MASS_2: two, CHANGE: np.zeros((12, 0)),
    }  # fmt: skip
    owner = (None, None, None, GAIN_1)
    found = Invariances(SimpleNamespace(scale=None), np.hstack([frame, own]), owner, lacking)
    assert found.twins(GAIN_1) == [GAIN_2]
    assert found.twins(MASS_2) == []
    assert Invariances(None, np.hstack([frame, frame[:, :1] + 5e-4 * own]), owner, lacking).twins(GAIN_1) == []
    # An effect of two parameters may have a twin of two parameters.
    pair = Invariances(None, np.hstack([frame, two]), (None, None, None, MASS_2, MASS_2),
                       {GAIN_2: two @ [[1.0, 2.0], [3.0, 1.0]] + frame[:, :1], MASS_1: other})  # fmt: skip
    assert pair.twins(MASS_2) == [GAIN_2]


class Keyed(list):
    """A mapping that compares keys by identity."""

    def __getitem__(self, key):
        return next(value for own, value in self if own is key)


def test_what_hardly_changes_the_data_beyond_what_others_do_is_untold():
    frame, sizes = np.eye(6)[:, :2], SimpleNamespace(expected_sizes=lambda scale: np.array([2.0]))
    a, b = (SimpleNamespace(effect=sizes) for _ in range(2))
    for size, untold in ((0.49, True), (0.51, False)):
        column = np.array([[5.0, 5.0, size, 0.0, 0.0, 0.0]]).T
        lacking = Keyed([(a, column), (b, np.eye(6)[:, [2]])])
        lookup = SimpleNamespace(estimate=SimpleNamespace(scale=None), free=frame, lacking=lacking)
        assert Invariances.untold(lookup, a, [a]) is untold
        assert Invariances.untold(lookup, a, [a, b]) is True


def test_the_dual_frame_has_the_eigenvalues_of_the_frame_and_its_mass():
    rng = np.random.default_rng(4)
    frame = np.concatenate([rng.uniform(5, 10, 4), rng.uniform(2e3, 3e3, 4)])

    def eigenvalues(theta):
        T = np.eye(4) - np.eye(4, k=1)
        return np.sort(np.linalg.eigvals((T * theta[4:]) @ T.T / theta[:4, None]).real)

    dual = dual_frame(frame)
    np.testing.assert_allclose(eigenvalues(dual), eigenvalues(frame))
    assert dual[:4].sum() == pytest.approx(frame[:4].sum())
    np.testing.assert_allclose(dual_frame(dual), frame)


def test_frames_far_apart_fit_where_few_floors_or_frequencies_alone_are_seen():
    def experiment(seen, added=0.0, static=()):
        masses = np.array([added, 0.0])
        tests = [SimpleNamespace(measured=np.array(rows, dtype=bool), added_mass=masses) for rows in seen]
        return SimpleNamespace(configurations=tests, stories=4, static=static)

    half, more, none = [[1, 0, 0, 0], [0, 0, 0, 1]], [[1, 1, 0, 0], [0, 0, 0, 1]], [[0, 0, 0, 0]]
    assert few_floors_seen(experiment([half, half]))
    assert not few_floors_seen(experiment([half, more]))
    assert dual_fits_as_well(experiment([none, none]))
    for other in (experiment([none, half]), experiment([none], added=1.0), experiment([none], static=(1,))):
        assert not dual_fits_as_well(other)


def deviation(label, deviations, entries, error=None):
    return SimpleNamespace(label=label, deviations=deviations, entries=entries, error=error)


def test_a_residual_sits_where_its_parts_are_improbable_among_all_there_are(monkeypatch):
    """The level of a hundredth is divided among five parts and two floors."""
    level = 0.01 / 7
    limit = stats.norm.isf(level / 2)
    of_three, of_two = (np.sqrt(special.chdtri(n, level) / n) for n in (3, 2))
    parts = [deviation("f1", 1.01 * limit, 1, 0.02), deviation("f2", -0.99 * limit, 1), deviation("f3", -9.0, 1),
             deviation("s1", 1.01 * of_three, 3), deviation("s2", 0.99 * of_three, 3)]  # fmt: skip
    monkeypatch.setattr(residual, "by_part", lambda estimate: parts)
    monkeypatch.setattr(residual, "by_floor", lambda estimate: {2: 1.01 * of_two, 3: 0.99 * of_two})
    found = residual.where_it_sits(None)
    assert [each.split(" (")[0] for each in found][:2] == ["f3", "f1"]
    assert {each.split(" (")[0] for each in found} == {"f1", "f3", "s1", "floor 2"}
    assert f"f1 (+2.00 %, {1.01 * limit:+.1f} standard deviations)" in found
    assert "f3 (-9.0 standard deviations)" in found
    assert any(each.startswith("s1 (") and each.endswith("standard deviations a floor)") for each in found)


def test_residuals_of_a_floor_are_those_of_all_tests_in_the_noise_of_each_kind(monkeypatch):
    datum = SimpleNamespace(by_floor=lambda model: {3: np.array([2.0, 4.0]), 1: np.array([])})
    other = SimpleNamespace(by_floor=lambda model: {3: np.array([3.0]), 2: np.array([1.0])})
    monkeypatch.setattr(residual, "_compared", lambda estimate: [(datum, None, 2.0), (other, None, 1.0)])
    assert residual.by_floor(None) == {2: 1.0, 3: pytest.approx(np.sqrt((1 + 4 + 9) / 3))}


def given_states(*states, reference=None):
    each = [SimpleNamespace(name=f"{k}", state=state or f"{k}") for k, state in enumerate(states)]
    known = tuple(dict.fromkeys(test.state for test in each))
    frame = SimpleNamespace(reference=reference)
    experiment = SimpleNamespace(configurations=each, frame=frame, states=known)
    return SimpleNamespace(experiment=experiment, effects=(GAIN_1,))


def test_states_are_tested_again_that_still_stand_and_that_models_disagree_on():
    other = put("added_mass", floor=1, state="1")
    rivals = [SimpleNamespace(effects=(other,))]
    names = [test.name for test in next_test._first_of_states(given_states(None, None, None), rivals)]
    assert sorted(names) == ["0", "1"]
    names = [test.name for test in next_test._first_of_states(given_states("a", "b", "b"), rivals)]
    assert names == ["1"]
    names = [test.name for test in next_test._first_of_states(given_states(None, None, reference="0"), rivals)]
    assert names == ["1"]


def test_sensors_are_added_while_each_is_worth_it(monkeypatch):
    """One additional floor multiplies the distance by 1.5, the fourth by 1.1; three deviations are enough."""
    worth = {0: 1.0, 1: 1.5, 2: 1.4, 3: 1.1}
    said = [None]
    monkeypatch.setattr(next_test, "_said", lambda *_: said)
    accepted = SimpleNamespace(experiment=SimpleNamespace(stories=4))
    first = SimpleNamespace(measured=np.ones((1, 1), dtype=bool), measured_floors=np.array([1]))
    for size, floors, apart in ((1.0, (1, 2, 3), 2.1), (2.05, (1, 2), 3.075)):
        said[0] = SimpleNamespace(at=lambda floors, size=size: size * np.prod([worth[floor] for floor in floors]))
        found = next_test._with_sensors(accepted, [], next_test.NextTest(1, 2.0, "a", size), first)
        assert (found.measured_floors, found.standard_deviations) == (floors, pytest.approx(apart))
    test = next_test.NextTest(1, 2.0, "a", 3.1)
    assert next_test._with_sensors(accepted, [], test, first) is test
    blind = SimpleNamespace(measured=np.zeros((1, 1), dtype=bool), measured_floors=np.array([1]))
    assert next_test._with_sensors(accepted, [], next_test.NextTest(1, 2.0, "a", 0.5), blind).measured_floors is None


def test_multipliers_of_active_rows_balance_the_gradient():
    rows = np.array([[1.0, 0.0], [0.0, 2.0], [-1.0, 0.0], [0.0, 0.0]])
    found = _multipliers(rows, np.array([True, True, True, True]), np.array([-3.0, -4.0]))
    np.testing.assert_allclose(found, [3.0, 2.0, 0.0, 0.0])
    found = _multipliers(rows, np.array([False, True, True, False]), np.array([-3.0, -4.0]))
    np.testing.assert_allclose(found, [0.0, 2.0, 0.0, 0.0])


def test_a_headline_has_the_parts_for_which_there_are_words():
    """Semicolons separate the parts. A part without a name in braces is always shown."""
    plain = dict.fromkeys(FIELDS, "")
    ambiguous = VERDICTS["ambiguous"]
    said = ambiguous.says(added=True, **plain | {"found": "a spring", "doubt": "a mass would do", "change": ""})
    assert said == "a spring; but a mass would do"
    assert ambiguous.says(added=False, **plain | {"model": "the frame", "change": "less"}) == (
        "the frame explains the data; less"
    )
    located = VERDICTS["located"]
    assert located.says(added=True, **plain) == "no cause in the catalogue accounts for it"
    with pytest.raises(ValueError, match="may name"):
        dataclasses.replace(located, headline="{nobody} knows")


def told_by(**more):
    """Return a search, the set of its verdict and the other facts, with no fact important enough for a message."""
    frame = SimpleNamespace(story_heights=np.ones(2))
    tests = [SimpleNamespace(name="a", other_modes=())]
    experiment = SimpleNamespace(stories=2, configurations=tests, frame=frame)
    backend = SimpleNamespace(name="osqp")
    known = [Hypothesis(GAIN_1, 0.1), Hypothesis(MASS_1, 0.1)]
    fitter = SimpleNamespace(experiment=experiment, stand_ins=0, fits=9, backend=backend, hypotheses=known)
    final = SimpleNamespace(
        noise=SimpleNamespace(settled=True), fit=SimpleNamespace(converged=True, reason="step limit"), effects=(),
        quality=SimpleNamespace(max_frequency_error=1.2e-4), theta=np.arange(4.0),
    )  # fmt: skip
    posterior = SimpleNamespace(numberings=(), untold=list)
    parts = {"search": SimpleNamespace(fitter=fitter, spent=False, visited={}), "posterior": posterior, "final": final}
    for key, value in more.items():
        owner = {**parts, "fitter": fitter, "experiment": experiment, "noise": final.noise, "fit": final.fit}
        name, _, attribute = key.partition("_")
        setattr(owner[name], attribute, value)
    return parts


@pytest.mark.parametrize(
    ("more", "start"),
    [
        ({}, None), ({"noise_settled": False}, "the estimate of the standard deviations that nobody declared did not"),
        ({"search_spent": True}, "the search ended after 0 sets of effects"),
        ({"fit_converged": False}, "the final fit did not converge (step limit)"),
        ({"posterior_untold": lambda: [GAIN_1]}, f"{GAIN_1.label}: these data tell nothing of it"),
        ({"fitter_stand_ins": 3}, "3 of 9 fits that osqp refused were made by auto"),
        ({"search_visited": {1: SimpleNamespace(failure="it gave up"), 2: SimpleNamespace(failure=None)}},
         "1 of 2 sets of effects could not be fitted (it gave up)"),
        ({"final_effects": (put("joint_rotation"),), "experiment_frame": SimpleNamespace(story_heights=None)},
         "story heights are not declared"),
        ({"final_effects": (put("joint_rotation"),)}, None),
        ({"experiment_frame": SimpleNamespace(story_heights=None)}, None),
    ],
)  # fmt: skip
def test_what_a_reader_should_know_besides_is_said_where_it_applies(more, start):
    parts = told_by(**more)
    said = list(conclusion._information(parts["search"], parts["posterior"], parts["final"], negligible=False))
    assert len(said) == (start is not None)
    assert start is None or said[0].startswith(start)
    (first, *_) = conclusion._information(parts["search"], parts["posterior"], parts["final"], negligible=True)
    assert "frequencies are off by 0.0001 at most" in first


@pytest.mark.parametrize(("probability", "changes", "said"), [(0.5, (), True), (0.002, ("x",), False),
                                                              (0.0005, ("x",), True)])  # fmt: skip
def test_that_other_modes_are_hardly_probable_is_said_where_no_numbering_has_them(probability, changes, said):
    tests = [SimpleNamespace(name="a", other_modes=("b",)), SimpleNamespace(name="c", other_modes=())]
    numberings = (SimpleNamespace(probability=probability, changes=changes),)
    parts = told_by(experiment_configurations=tests, posterior_numberings=numberings)
    found = list(conclusion._information(parts["search"], parts["posterior"], parts["final"], negligible=False))
    assert found == (['the modes of "a" are those given: that they are the other ones named is hardly probable'] if said
                     else [])  # fmt: skip


def test_statements_of_effects_that_are_not_there_are_granted_where_the_data_hardly_tell():
    """Only assumptions about the frame and the affected states are listed, each once, with its states."""
    heavier, softer = put("state_mass", state="b"), put("state_stiffness", state="b")
    elsewhere = put("state_mass", state="c")
    asked = []

    def untold(placed, others):
        asked.append((placed, list(others)))
        return placed is not softer

    searching = SimpleNamespace(lacking=lambda found: [heavier, softer, elsewhere, GAIN_1],
                                invariances=lambda found: SimpleNamespace(untold=untold))  # fmt: skip
    said = list(conclusion._granted(searching, model_of(MASS_1)))
    assert said == [heavier.effect.granted.format(state='"b"')]
    assert [each[0] for each in asked] == [heavier, softer]
    assert all(others == [heavier, softer] for _, others in asked)
    assert list(conclusion._granted(searching, model_of(GAIN_2))) == []


def test_inequalities_that_were_declared_are_granted():
    def stated(**more):
        return SimpleNamespace(constraints=lambda stories: Constraints(**more))

    experiment = SimpleNamespace(stories=2, stated={
        "k below 5": stated(upper=np.full(4, 5.0)), "m above 1": stated(lower=np.ones(4)),
        "falling": stated(G=np.ones((1, 4)), h=np.zeros(1)), "a ratio": stated(A=np.ones((1, 4)), b=np.zeros(1)),
    })  # fmt: skip
    said = list(conclusion._granted_of_bounds(experiment))
    assert said == [f'that "{words}" holds, as declared' for words in ("k below 5", "m above 1", "falling")]


def test_candidates_have_the_gain_and_the_odds_of_the_linearised_model_or_of_a_fit(monkeypatch):
    """One of three hypotheses is in the set, one is judged by derivatives and one is not judged. All three count for
    chance."""
    monkeypatch.setattr(conclusion, "_in_noise_of", lambda final, kept, fitter: SimpleNamespace(chi2=final.chi2 + 12.0))
    monkeypatch.setattr(conclusion, "parameter_names", lambda experiment, effects: [])
    known = [Hypothesis(placed, 0.1) for placed in (GAIN_1, GAIN_2, MASS_1)]
    fitter = SimpleNamespace(hypotheses=known, assumed=(), log_priors=lambda lacking, beside: np.array([-3.0]))
    final = SimpleNamespace(effects=(GAIN_1,), chi2=30.0, dof=20, experiment=None)
    judged = ModelClass(frozenset([GAIN_1]), final, 0.0, 0.0)
    linear = SimpleNamespace(
        lacking=[GAIN_2], gains=np.array([-0.5]), decrease=lambda placed: 7.0,
        precision_gained=lambda placed: 1.09, confounders=lambda placed, names: ("k",),
    )  # fmt: skip
    searching = SimpleNamespace(fitter=fitter, linearised=lambda judged: linear, visited={})
    chance = {GAIN_1: 0.9, GAIN_2: 0.2, MASS_1: 0.0}
    of = SimpleNamespace(of_effects=chance, keeps_odds=lambda placed: True,
                         ranked=lambda effects, chances: sorted(effects, key=lambda each: -chances[each]))  # fmt: skip
    first, second, third = conclusion._candidates(of, searching, judged)
    assert (first.placed, first.probability, first.chi2, first.dof) == (GAIN_1, 0.9, 30.0, 20)
    assert first.confounded_with == ()
    assert first.p_value == pytest.approx(3 * stats.chi2.sf(12.0, 1))
    unseen = 1 / (1 + np.exp(3.5))
    assert (second.placed, second.chi2, second.dof, second.confounded_with) == (GAIN_2, 23.0, 19, ("k",))
    assert second.probability == pytest.approx(0.2 + 0.8 * unseen)
    assert second.p_value == pytest.approx(3 * stats.chi2.sf(7.0, 1))
    assert (third.placed, third.probability, third.chi2, third.dof, third.p_value) == (MASS_1, 0.0, 30.0, 19, 1.0)
    searching.visited[frozenset([GAIN_1, GAIN_2])] = None
    linear.precision_gained = lambda placed: 1.11
    second = conclusion._candidates(of, searching, judged)[1]
    assert (second.probability, second.confounded_with) == (0.2, ())


def test_probability_of_an_effect_is_shared_by_its_places_as_the_file_expects_it():
    """The probability for all three floors is 2 %. A floor declared with 30 % has 30 %; excluded floors get no
    share."""
    mass, stiffness = [10.0, 8.0, 6.0], [2e4, 1.5e4, 1e4]
    frame = {"total_mass": 24.0}
    table = experiment(mass, stiffness, configuration(mass, stiffness), frame=frame)
    gain = next(each for each in catalogue() if each.name == "sensor_gain")

    def chances(*expected):
        of = Experiment.from_dict(table | ({"effect": list(expected)} if expected else {}))
        return {item.placed.place.floor: item for item in hypotheses(of, [gain])}

    plain = chances()
    assert 1 - np.prod([1 - item.probability for item in plain.values()]) == pytest.approx(gain.probability)
    assert {item.size for item in plain.values()} == {None}
    said = chances({"name": "sensor_gain", "floor": 2, "probability": 0.3, "size": 0.2},
                   {"name": "sensor_gain", "floor": 3, "exclude": True})  # fmt: skip
    assert sorted(said) == [1, 2]
    assert (said[2].probability, said[2].size) == (pytest.approx(0.3), 0.2)
    assert 1 - said[1].probability == pytest.approx((1 - gain.probability) ** (1 / 2))
    anywhere = chances({"name": "sensor_gain", "probability": 0.5})
    assert 1 - np.prod([1 - item.probability for item in anywhere.values()]) == pytest.approx(0.5)
    assert hypotheses(Experiment.from_dict(table), [gain], [plain[2].placed])[1].placed.place.floor == 3
