"""Share an uneven four-story frame among the tests of this folder."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cvxshear.effects import Effect, LocatedEffect, Parameter, Scale, State, compose
from cvxshear.effects import named as effects_named
from cvxshear.effects.base import Place
from cvxshear.measurement.experiment import Experiment
from cvxshear.model import Modes, modes
from tests.fe.elements import Floats
from tests.fe.frame import Building, SwayModes

HEIGHTS = np.array([0.42, 0.36, 0.33, 0.38])
STIFFNESS = np.array([26e3, 24e3, 21e3, 19e3])
MASS = np.array([12.0, 9.5, 11.0, 8.0])
ADDED = np.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 5.0]])
NAMES = ("plain", "loaded")
STORIES = len(MASS)

ROUNDING = 1e-11
"""Largest relative difference between the model and the finite elements if the formula is exact. Rounding errors are a
few units of 2e-16 times the condition number of K, which is under 1e3."""


def experiment(*, configurations: int = 2, heights: bool = True, **configuration: Any) -> Experiment:
    """Return an experiment on the frame. Its measured values do not matter to these tests."""
    shapes = [[1.0, 2.0, 3.0, 4.0]] if "mode_shapes" not in configuration else configuration.pop("mode_shapes")
    frame: dict[str, Any] = {"stories": STORIES, "total_mass": float(MASS.sum())}
    if heights:
        frame["story_heights"] = HEIGHTS.tolist()
    tests = [
        {"name": name, "added_mass": added.tolist(), "frequencies": [2.0], "mode_shapes": shapes, **configuration}
        for name, added in zip(NAMES[:configurations], ADDED, strict=False)
    ]
    return Experiment.from_dict({"frame": frame, "configuration": tests})


def building(number: int = 0) -> Building:
    """Return the same frame in finite elements, in one of its configurations."""
    return Building(HEIGHTS, STIFFNESS, MASS + ADDED[number])


def placed(name: str, **place: Any) -> LocatedEffect:
    """Return an effect of the catalogue at a place."""
    (effect,) = effects_named([name])
    return LocatedEffect(effect, Place(**place))


def theta(*own: float | tuple[float, ...], mass: Floats = MASS, stiffness: Floats = STIFFNESS) -> Floats:
    """Return the parameter vector: floor masses, story stiffnesses and the effects' own parameters."""
    return np.concatenate([mass, stiffness, *(np.atleast_1d(each) for each in own)])


def composed(
    effects: list[LocatedEffect], *own: float | tuple[float, ...], number: int = 0, stiffness: Floats = STIFFNESS
) -> State:
    """One configuration of the frame with these effects of this size."""
    tested = experiment()
    return compose(tested, tested.configurations[number], effects, theta(*own, stiffness=stiffness))


def modes_with(effects: list[LocatedEffect], *own: float, number: int = 0, stiffness: Floats = STIFFNESS) -> Modes:
    """Return the modes of that configuration, as the sensors measure them."""
    state = composed(effects, *own, number=number, stiffness=stiffness)
    found = modes(state.system.M, state.system.K)
    return dataclasses.replace(found, shapes=state.observation.shown(found.shapes))


def frequency_gap(model: Modes, fe: SwayModes) -> float:
    """Return the largest relative difference of a frequency."""
    return float(np.max(np.abs(model.frequencies / fe.frequencies - 1)))


def shape_gap(model: Modes, fe: SwayModes) -> float:
    """Return the largest difference of a mass-normalized shape entry, relative to the largest entry."""
    rows = fe.shapes.T
    signs = np.sign(np.sum(model.shapes * rows, axis=1, keepdims=True))
    return float(np.max(np.abs(model.shapes * signs - rows)) / np.max(np.abs(rows)))


def assert_same(model: Modes, fe: SwayModes, within: float = ROUNDING) -> None:
    """Assert that frequencies and mass-normalized shapes agree."""
    assert frequency_gap(model, fe) < within
    assert shape_gap(model, fe) < within


class Cable(Effect):
    """A custom effect of two parameters: a cable from the top to the ground, with a mass at the top."""

    name = "cable"
    summary = "A cable holds the top."
    formula = "K + s e e', M + m e e'"
    source = "none"
    stage = "spring"
    parameters = (Parameter("s", "N/m", lower=0.0), Parameter("m", "kg", lower=0.0))
    probability = 0.05

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1 * scale.story_stiffness, 0.1 * scale.floor_mass])

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        system = state.system
        M, K, dM, dK = system.M.copy(), system.K.copy(), system.dM.copy(), system.dK.copy()
        K[-1, -1] += values[0]
        M[-1, -1] += values[1]
        dK[own.start, -1, -1] += 1.0
        dM[own.start + 1, -1, -1] += 1.0
        return state.with_mass(M, dM).with_stiffness(K, dK)
