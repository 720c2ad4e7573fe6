"""Simulated experiments can be read, their truth explains them, and their noise is the declared one."""

import numpy as np
import pytest

from cvxshear.effects import LocatedEffect, Place, compose, named
from cvxshear.measurement.experiment import Experiment
from cvxshear.model import modes
from tests.fe.experiments import CHANGES, FREQUENCY_STD, MODE_SHAPE_STD, OF_MASSES, measured, simulated
from tests.fe.frame import SwayModes

EFFECTS = sorted({*CHANGES, *OF_MASSES, "sensor_gain", "spring"} - {"bracing", "floor_mass"})
"""Effects that an experiment can have. Braces are visible only with another effect; no floor masses are declared."""
TALL = {"ground_spring", "spring"}
"""Effects without a place in a frame of one or two stories."""
EXACT = 1e-8
"""Rounding errors in standard deviations of 1e-3 and 1e-2."""


def test_no_effect_is_a_shear_frame():
    declared, truth = simulated(None, stories=3, configurations=2, rng=np.random.default_rng(1), noise=0.0)
    assert_explained(declared, truth)
    assert (truth["effect"], truth["size"], truth["floor"], truth["story"], truth["configuration"]) == (None,) * 5


@pytest.mark.parametrize("stories", [3, 5])
@pytest.mark.parametrize("effect", EFFECTS)
def test_without_noise_the_truth_explains_the_data(effect, stories):
    """The shear frame alone does not: some frequency or shape entry is off by three standard deviations."""
    declared, truth = simulated(effect, stories=stories, configurations=3, rng=np.random.default_rng(2), noise=0.0)
    assert_explained(declared, truth)
    with pytest.raises(AssertionError):
        assert_explained(declared, {**truth, "effect": None}, within=3.0)


@pytest.mark.parametrize("effect", sorted(set(EFFECTS) - TALL))
def test_a_single_story(effect):
    declared, truth = simulated(effect, stories=1, configurations=2, rng=np.random.default_rng(10), noise=0.0)
    assert_explained(declared, truth)


@pytest.mark.parametrize("effect", sorted(set(EFFECTS) - {"spring"}))
def test_an_effect_sits_where_it_was_put(effect):
    place = {"floor": 2, "story": 3, "configuration": 1}
    rng = np.random.default_rng(3)
    declared, truth = simulated(effect, stories=3, configurations=2, rng=rng, noise=0.0, **place)
    (found,) = named([effect])
    parts = {"floor": "floor", "story": "story", "configuration": "state"}
    if effect == "sensor_gain":
        # These experiments have the effect in every test.
        parts["configuration"] = ""
    names = {**place, "configuration": "test 1"}
    assert {part: truth[part] for part in names} == {
        part: value if parts[part] in found.sits_at else None for part, value in names.items()
    }
    assert_explained(declared, truth)


def test_noise_is_what_it_is_declared_to_be():
    """Standardized differences of 400 tests have zero mean and unit deviation, each within four standard errors."""
    true = SwayModes(np.array([2.0, 5.0]), np.array([[0.1, 0.4], [0.2, -0.3]]))
    scaled = np.array([[0.5, 1.0], [1.0, -0.75]])
    rng = np.random.default_rng(6)
    tests = [measured(true, rng, name="test", added=np.zeros(2)) for _ in range(400)]
    frequencies = np.array([np.log(np.array(each["frequencies"]) / true.frequencies) for each in tests]) / FREQUENCY_STD
    entries = (np.array([each["mode_shapes"] for each in tests]) - scaled) / MODE_SHAPE_STD
    for z in (frequencies.ravel(), entries.ravel()):
        assert abs(z.mean()) < 4 / np.sqrt(z.size)
        assert abs(z.std() - 1) < 4 / np.sqrt(2 * z.size)
    assert (tests[0]["frequency_std"], tests[0]["mode_shape_std"]) == (0.001, 0.01)
    assert tests[0]["mode_shape_noise"] == "additive"


def place_of(truth):
    return Place(truth["floor"], truth["story"], truth["configuration"], truth["to"])


def assert_explained(declared, truth, within=EXACT):
    """Assert that the composed model of the truth is within these standard deviations of every datum."""
    tested = Experiment.from_dict(declared)
    effects = [LocatedEffect(named([truth["effect"]])[0], place_of(truth))] if truth["effect"] else []
    # Further parameters of an effect (the grip of a clamp) are at their null values.
    own = [truth["size"], *(item.null for item in effects[0].effect.parameters[1:])] if effects else []
    theta = np.concatenate([truth["floor_mass"], truth["story_stiffness"], own])
    for test in tested.configurations:
        state = compose(tested, test, effects, theta)
        found = modes(state.system.M, state.system.K)
        off = np.abs(found.frequencies / test.frequencies - 1) / FREQUENCY_STD
        assert off.max() < within
        shapes = state.observation.shown(found.shapes)
        shapes *= (np.sum(shapes * test.mode_shapes, axis=1) / np.sum(shapes**2, axis=1))[:, None]
        off = np.abs(shapes - test.mode_shapes) / MODE_SHAPE_STD
        assert off.max() < within
