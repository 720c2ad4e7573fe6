"""The search among sets of effects, with effects made to provoke it, and an effect of two parameters."""

from collections import Counter
from typing import ClassVar

import numpy as np
import pytest

from cvxshear import Experiment, backends, close_loop
from cvxshear.effects import Effect, GroundSpring, Parameter, Place, Placed, SensorGain
from cvxshear.identification.efficient import efficient, fitted_with
from cvxshear.identification.expectation import Expectation
from cvxshear.identification.misfit import Misfit
from cvxshear.loop import fitter as fitter_module
from cvxshear.loop.evidence import log_evidence
from cvxshear.loop.linear import Linearised
from tests.fe.experiments import simulated


class GainAgain(SensorGain):
    """The same effect under another name."""

    name: ClassVar[str] = "gain_again"


class HeldAndLoaded(GroundSpring):
    """A rod that holds a floor and hangs its own weight on it: a spring, and a mass besides."""

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

    def sizes(self, of):
        return np.array([0.1 * of.story_stiffness, 0.5 * of.floor_mass])

    def phrase(self, place, values, std, of, units):
        return Effect.phrase(self, place, values, std, of, units)


class Stiffer(Effect):
    """All stories stiffer by one factor: what the stiffnesses themselves already say."""

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

    def sizes(self, of):
        return np.array([0.1])


PROVOKING = (SensorGain(), GainAgain(), GroundSpring(), HeldAndLoaded(), Stiffer())


@pytest.fixture
def fits(monkeypatch):
    """The sets that are fitted while the search looks for them, each with how often."""
    counted = Counter()
    plain = fitter_module._fitted

    def counting(proposal, backend, tolerance):
        if tolerance == fitter_module.ROUGH:
            counted[frozenset(proposal.effects)] += 1
        return plain(proposal, backend, tolerance)

    monkeypatch.setattr(fitter_module, "_fitted", counting)
    return counted


def measured(effect, seed, **keys):
    declared, truth = simulated(effect, stories=4, configurations=2, rng=np.random.default_rng(seed), **keys)
    return Experiment.from_dict(declared), truth


@pytest.mark.parametrize(
    ("effect", "seed"), [("sensor_gain", 1), ("ground_spring", 2), (None, 3), ("joint_rotation", 4)]
)
def test_it_ends_and_visits_no_set_twice(fits, effect, seed):
    of, _ = measured(effect, seed)
    result = close_loop(of, effects=PROVOKING)
    assert fits
    assert set(fits.values()) == {1}
    assert len(fits) <= result.fits
    assert sum(model.probability for model in result.models) <= 1 + 1e-9
    assert "stiffer_throughout" not in [item.placed.effect.name for item in result.effects]


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
    """Where its prior is even, the data have not raised it, and it is said."""
    of, _ = measured(None, 5)
    result = close_loop(of, effects=[Stiffer().expecting(probability=0.6)])
    assert result.effects == ()
    (candidate,) = result.candidates
    assert candidate.probability == pytest.approx(0.6, abs=0.1)
    assert all(name.startswith("story_stiffness") for name in candidate.confounded_with)
    assert any("cannot tell whether there is stiffer throughout" in said for said in result.information)


def loaded_and_held():
    """A frame whose floor 3 carries 2 kg and is held with 4 kN/m: nothing in one parameter does both."""
    rng = np.random.default_rng(8)
    declared, truth = simulated("ground_spring", stories=4, configurations=2, rng=rng, floor=3, size=4000.0, noise=0.0)
    M = np.diag(truth["floor_mass"])
    M[2, 2] += 3.0
    k = truth["story_stiffness"]
    T = np.eye(4) - np.eye(4, k=1)
    K = (T * k) @ T.T
    K[2, 2] += 4000.0
    for table in declared["configuration"]:
        root = np.sqrt(np.diag(M) + table["added_mass"])
        values, vectors = np.linalg.eigh(K / np.outer(root, root))
        shapes = (vectors / root[:, None]).T
        shapes /= np.max(np.abs(shapes), axis=1, keepdims=True)
        table["frequencies"] = (np.sqrt(values) / (2 * np.pi) * (1 + 0.001 * rng.standard_normal(4))).tolist()
        table["mode_shapes"] = (shapes + 0.01 * rng.standard_normal((4, 4))).tolist()
    return Experiment.from_dict(declared)


def test_an_effect_of_two_parameters_of_different_units_works_everywhere():
    result = close_loop(loaded_and_held(), effects=[HeldAndLoaded(), SensorGain(), Stiffer()])
    (found,) = result.effects
    assert found.placed == Placed(found.placed.effect, Place(floor=3))
    assert found.placed.effect.name == "held_and_loaded"
    assert found.parameters["s"] == pytest.approx(4000.0, abs=4 * found.std["s"])
    assert found.parameters["mass"] == pytest.approx(3.0, abs=4 * found.std["mass"])
    assert "N/m" in found.size
    assert "kg" in found.size
    assert found.size.startswith("held and loaded at floor 3 (s = ")
    described = result.to_dict()
    assert set(described["effects"][0]["parameters"]) == {"s", "mass"}
    floors = {item.placed.place.floor for item in result.candidates if item.placed.effect.name == "held_and_loaded"}
    assert floors == {2, 3, 4}
    assert result.candidates[0].placed == found.placed


def test_the_linearised_model_of_two_parameters_is_that_of_the_fit():
    of = measured(None, 6)[0]
    start = efficient(of, backends.get("auto"))
    expectation = Expectation(start.scale)
    base = fitted_with(Misfit(of, (), expectation=expectation), start.theta, backends.get("auto"))
    free = type("Free", (HeldAndLoaded,), {"parameters": (Parameter("s", "N/m"), Parameter("mass", "kg"))})()
    placed = Placed(free, Place(floor=3))
    misfit = Misfit(of, [placed], expectation=expectation)
    fitted = fitted_with(misfit, np.append(base.theta, [0, 0]), backends.get("auto"))
    linear = Linearised(base, [placed], expectation)
    gain = log_evidence(fitted, expectation) - log_evidence(base, expectation)
    assert linear.gain(placed) == pytest.approx(gain, abs=0.1)
    assert np.all(np.abs(linear.predicted([placed])[8:] - fitted.theta[8:]) < 0.2 * fitted.std[8:])
