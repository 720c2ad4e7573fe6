"""Test the search among sets of effects, with effects built to break it and an effect of two parameters."""

import copy
from typing import ClassVar

import numpy as np
import pytest

from cvxshear import Experiment, backends, close_loop
from cvxshear.effects import Effect, GroundSpring, LocatedEffect, Parameter, Place, SensorGain
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import efficient, fitted_with
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.next_test import next_test
from cvxshear.loop import conclusion, search
from cvxshear.loop.close import search_for_effects
from cvxshear.loop.fitter import log_evidence
from cvxshear.loop.linear import Linearised
from cvxshear.util import errors
from tests.fe.experiments import simulated


class GainAgain(SensorGain):
    """The same effect under another name."""

    name: ClassVar[str] = "gain_again"


class HeldAndLoaded(GroundSpring):
    """A rod that holds a floor and loads it with its own weight: a spring and a mass."""

    name: ClassVar[str] = "held_and_loaded"
    summary: ClassVar[str] = "A rod holds a floor and loads it."
    formula: ClassVar[str] = "K + s e e', M + mass e e'"
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("s", "N/m", lower=0.0), Parameter("mass", "kg", lower=0.0))

    def apply(self, state, place, values, own):
        at = place.floor - 1
        held = super().apply(state, place, values[:1], slice(own.start, own.start + 1))
        M, dM = held.system.M.copy(), held.system.dM.copy()
        M[at, at] += values[1]
        dM[own.start + 1, at, at] += 1.0
        return held.with_mass(M, dM)

    def sizes(self, scale):
        return np.array([0.1 * scale.story_stiffness, 0.5 * scale.floor_mass])

    def phrase(self, place, values, std, scale, units):
        return Effect.phrase(self, place, values, std, scale, units)


class Stiffer(Effect):
    """One factor on all story stiffnesses. The stiffnesses themselves already contain this change."""

    name: ClassVar[str] = "stiffer_throughout"
    summary: ClassVar[str] = "Every story is stiffer by the same part."
    formula: ClassVar[str] = "(1 + a) K"
    source: ClassVar[str] = "made to be confounded"
    stage: ClassVar[str] = "spring"
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("a", "", lower=-0.5, upper=1.0),)

    def apply(self, state, place, values, own):
        dK = (1.0 + values[0]) * state.system.dK
        dK[own] += state.system.K
        return state.with_stiffness((1.0 + values[0]) * state.system.K, dK)

    def sizes(self, scale):
        return np.array([0.1])


PROVOKING = (SensorGain(), GainAgain(), GroundSpring(), HeldAndLoaded(), Stiffer())


def measured(effect, seed, **keys):
    declared, truth = simulated(effect, stories=4, configurations=2, rng=np.random.default_rng(seed), **keys)
    return Experiment.from_dict(declared), truth


def test_a_hopeless_misfit_ends_after_few_fits():
    """Deviations a hundred times too small, or one test in rad/s: the search must give up quickly."""
    too_sure, _ = simulated(None, stories=3, configurations=3, rng=np.random.default_rng(3))
    in_rad = copy.deepcopy(too_sure)
    for table in too_sure["configuration"]:
        table["frequency_std"] /= 100
        table["mode_shape_std"] /= 100
    found = search_for_effects(Experiment.from_dict(too_sure))
    assert found.fits <= 250
    assert found.programs <= 1000
    assert found.verdict not in ("adequate", "explained")
    assert found.steps[0].p_value < 1e-12
    in_rad["configuration"][0]["frequencies"] = [2 * np.pi * f for f in in_rad["configuration"][0]["frequencies"]]
    found = search_for_effects(Experiment.from_dict(in_rad))
    assert found.fits <= 250
    assert found.programs <= 1000
    # A frame (2 pi)^2 times stiffer has exactly these modes; `check` asks about the unit.
    assert [each.placed.effect.name for each in found.effects] == ["state_stiffness"]
    assert 1 + found.effects[0].parameters["e"] == pytest.approx((2 * np.pi) ** 2, rel=0.02)


def test_duplicates_are_named_together_and_share_their_probability():
    of, truth = measured("sensor_gain", 1)
    result = close_loop(of, effects=PROVOKING)
    (found,) = result.effects
    assert found.placed.place.floor == truth["floor"]
    (twin,) = [rival for rival in found.rivals if rival.twin]
    assert {found.placed.effect.name, twin.placed.effect.name} == {"sensor_gain", "gain_again"}
    assert twin.placed.place == found.placed.place
    assert twin.probability == pytest.approx(found.probability, rel=0.1)
    assert found.probability + twin.probability > 0.95
    alone = close_loop(of, effects=[SensorGain()]).effects[0]
    assert found.probability == pytest.approx(alone.probability / 2, abs=0.05)
    assert result.verdict == "ambiguous"


@pytest.mark.parametrize("seed", range(4))
def test_what_contains_the_true_effect_and_more_does_not_replace_it(seed):
    of, truth = measured("ground_spring", 10 + seed)
    result = close_loop(of, effects=[GroundSpring(), HeldAndLoaded()])
    assert result.effects[0].placed.effect.name == "ground_spring"
    assert result.effects[0].placed.place.floor == truth["floor"]
    assert len(result.effects) == 1


def test_what_the_stiffnesses_say_already_keeps_its_odds():
    """With a uniform prior the data do not raise its odds, and the report contains this fact."""
    of, _ = measured(None, 5)
    result = close_loop(of, effects=[Stiffer().expecting(probability=0.6)])
    assert result.effects == ()
    (candidate,) = result.candidates
    assert candidate.probability == pytest.approx(0.6, abs=0.1)
    assert all(name.startswith("story_stiffness") for name in candidate.confounded_with)
    assert any("stiffer throughout: these data tell nothing of it" in said for said in result.information)


def rod_modes(mass, k, added, rods):
    """Return frequencies and shapes of largest entry 1, one row per mode, of a frame with rods (floor, s, mass)."""
    n = len(mass)
    M = mass + added
    T = np.eye(n) - np.eye(n, k=1)
    K = (T * k) @ T.T
    for floor, spring, more in rods:
        K[floor - 1, floor - 1] += spring
        M[floor - 1] += more
    root = np.sqrt(M)
    values, vectors = np.linalg.eigh(K / np.outer(root, root))
    shapes = (vectors / root[:, None]).T
    return np.sqrt(values) / (2 * np.pi), shapes / np.max(np.abs(shapes), axis=1, keepdims=True)


def loaded_and_held(spring=4000.0, configurations=2, seed=8, noise=(0.001, 0.01)):
    """Return a frame whose floor 3 carries 3 kg and is held by a spring. No effect of one parameter does both."""
    rng = np.random.default_rng(seed)
    declared, truth = simulated(
        "ground_spring", stories=4, configurations=configurations, rng=rng, floor=3, size=spring, noise=0.0
    )
    for table in declared["configuration"]:
        added = np.asarray(table["added_mass"])
        frequencies, shapes = rod_modes(truth["floor_mass"], truth["story_stiffness"], added, [(3, spring, 3.0)])
        table["frequencies"] = (frequencies * (1 + noise[0] * rng.standard_normal(4))).tolist()
        table["mode_shapes"] = (shapes + noise[1] * rng.standard_normal((4, 4))).tolist()
        table["frequency_std"], table["mode_shape_std"] = noise
    return Experiment.from_dict(declared)


def test_an_effect_of_two_parameters_of_different_units_works_everywhere():
    result = close_loop(loaded_and_held(), effects=[HeldAndLoaded(), SensorGain(), Stiffer()])
    (found,) = result.effects
    assert found.placed == LocatedEffect(found.placed.effect, Place(floor=3))
    assert found.placed.effect.name == "held_and_loaded"
    assert found.parameters["s"] == pytest.approx(4000.0, abs=4 * found.std["s"])
    assert found.parameters["mass"] == pytest.approx(3.0, abs=4 * found.std["mass"])
    assert "N/m" in found.size
    assert "kg" in found.size
    assert found.size.startswith("held and loaded at floor 3 is there (s = ")
    described = result.to_dict()
    assert set(described["effects"][0]["parameters"]) == {"s", "mass"}
    floors = {item.placed.place.floor for item in result.candidates if item.placed.effect.name == "held_and_loaded"}
    assert floors == {2, 3, 4}
    assert result.candidates[0].placed == found.placed


def test_the_linearised_model_of_two_parameters_is_that_of_the_fit():
    """The linearised model integrates over one common size of both parameters, the fit over two: 0.14 in all."""
    of = measured(None, 6)[0]
    start = efficient(of, backends.get("auto"))
    expectation = EffectPrior(start.scale)
    base = fitted_with(Misfit(of, (), expectation=expectation), start.theta, backends.get("auto"))
    free = type("Free", (HeldAndLoaded,), {"parameters": (Parameter("s", "N/m"), Parameter("mass", "kg"))})()
    placed = LocatedEffect(free, Place(floor=3))
    misfit = Misfit(of, [placed], expectation=expectation)
    fitted = fitted_with(misfit, np.append(base.theta, [0, 0]), backends.get("auto"))
    linear = Linearised(base, [placed], expectation)
    gain = log_evidence(fitted, expectation) - log_evidence(base, expectation)
    assert linear.gains[0] == pytest.approx(gain, abs=0.15)
    assert np.all(np.abs(linear.predicted([placed])[8:] - fitted.theta[8:]) < 0.2 * fitted.std[8:])


def apart(accepted, rival, floor, mass, noise):
    """Return the deviations between two models with rods, by numpy: D^2 = r' (1 + J C J' + J_r C_r J_r')^-1 r."""
    added = mass * (np.arange(1, 5) == floor)

    def seen(estimate, theta):
        floors = [placed.place.floor for placed in estimate.effects]
        rods = [(at, *pair) for at, pair in zip(floors, theta[8:].reshape(-1, 2), strict=True)]
        return rod_modes(theta[:4], theta[4:8], added, rods)

    measured = seen(accepted, accepted.theta)

    def residual(estimate, theta):
        frequencies, shapes = seen(estimate, theta)
        scale = np.sum(shapes * measured[1], axis=1) / np.sum(shapes**2, axis=1)
        differences = (scale[:, None] * shapes - measured[1]) / noise[1]
        return np.concatenate([np.log(frequencies / measured[0]) / noise[0], differences.ravel()])

    spread = np.eye(20)
    for each in (accepted, rival):
        steps = 1e-5 * np.array([*each.theta[:8], *([1000.0, 1.0] * len(each.effects))])
        J = np.transpose(
            [(residual(each, each.theta + h) - residual(each, each.theta - h)) / (2 * h.sum()) for h in np.diag(steps)]
        )
        spread += J @ each.uncertainty.covariance() @ J.T
    r = residual(rival, rival.theta)
    return np.sqrt(r @ np.linalg.solve(spread, r))


def test_the_next_test_tells_rivals_of_two_parameters_apart(monkeypatch):
    """In one noisy test the rod may hold and load floor 2 or floor 3."""
    seen = []

    def proposing(accepted, rivals):
        seen.append((accepted, rivals))
        return next_test(accepted, rivals)

    monkeypatch.setattr(conclusion.next_test, "next_test", proposing)
    noise = (0.002, 0.03)
    result = close_loop(loaded_and_held(1500.0, 1, 9, noise), effects=[HeldAndLoaded()])
    assert result.verdict == "ambiguous"
    (found,) = result.effects
    # Floor 4 is a rival too: its probability is 3 %, more than a twentieth of the best set's.
    assert {found.placed.place.floor, *(rival.placed.place.floor for rival in found.rivals)} == {2, 3, 4}
    assert [rival.placed.place.floor for rival in found.rivals if rival.probability > 0.1] == [2]
    ((accepted, rivals),) = seen
    assert all(len(each.theta) == 8 + 2 * len(each.effects) for each in (accepted, *rivals))
    # Trial masses, relative to the mean floor mass, on every floor.
    mean = np.mean(accepted.theta[:4])
    distances = {
        (floor, part): min(apart(accepted, rival, floor, part * mean, noise) for rival in rivals)
        for floor in range(1, 5)
        for part in (0.1, 0.25, 0.5, 1.0)
    }
    floor, part = max(distances, key=distances.get)
    proposed = result.next_test
    assert (proposed.floor, proposed.added_mass) == (floor, pytest.approx(part * mean, rel=0.05))
    # The library's derivative uses the accepted model's scales of the shapes (Kaufman).
    assert proposed.standard_deviations == pytest.approx(distances[floor, part], rel=0.02)
    assert proposed.standard_deviations > 1.0


def test_a_search_whose_budget_is_spent_says_what_it_did_not_try(monkeypatch):
    """The budget counts fits by their size, so that the same sets are visited on every machine."""
    declared, _ = simulated("story_change", stories=4, configurations=3, rng=np.random.default_rng(3))
    whole = search_for_effects(Experiment.from_dict(declared))
    assert not any("budget" in said for said in whole.information)
    monkeypatch.setattr(search, "MOST_WORK", 5)
    short, again = (search_for_effects(Experiment.from_dict(declared)) for _ in range(2))
    (said,) = (text for text in short.information if "budget of work" in text)
    assert "not tried with every good set: " in said
    assert "exchanges of effects" in said
    assert short.fits == again.fits < whole.fits


def test_a_frame_of_many_stories_is_refused_at_once():
    tall = {"frame": {"stories": 101, "total_mass": 1e6}, "configuration": [{"frequencies": [0.2, 0.6]}]}
    with pytest.raises(errors.UnsuitableError, match="up to 100 stories, not 101: join stories"):
        search_for_effects(Experiment.from_dict(tall))
