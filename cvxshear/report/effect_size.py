"""How large an effect is in physical terms: what it does to stiffnesses, masses, shapes and frequencies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Parameter, Placed, compose
from cvxshear.effects.base import State
from cvxshear.experiment import Configuration
from cvxshear.frame import modes
from cvxshear.identification.efficient import Estimate
from cvxshear.quantities import percent, scaled, with_std
from cvxshear.typing import Floats

NOTHING = 1e-9
"""Relative change below which nothing is said of it."""


@dataclass(frozen=True, eq=False)
class Change:
    """What one effect does in one configuration.

    Parameters
    ----------
    configuration : str
    stiffness : ndarray, shape (N,)
        Change of the sway stiffness of each story, N/m: that of the force at the top over the story's drift.
    stiffness_share : ndarray, shape (N,)
        The same over what the stiffness is without the effect.
    mass : ndarray, shape (N,)
        Change of the mass that goes with each floor, kg.
    mass_share : ndarray, shape (N,)
        The same over what the floor carries without the effect.
    gain : ndarray, shape (N,)
        Relative change of what the sensors show.
    frequencies : ndarray, shape (N,)
        Relative change of the natural frequencies.
    """

    configuration: str
    stiffness: Floats
    stiffness_share: Floats
    mass: Floats
    mass_share: Floats
    gain: Floats
    frequencies: Floats


def changes(estimate: Estimate, placed: Placed) -> list[Change]:
    """What an effect of a fit does in each configuration, everything else staying as it is.

    Parameters
    ----------
    estimate : Estimate
    placed : Placed
        One of its effects.
    """
    own = estimate.own(placed)
    rest = [item for item in estimate.effects if item is not placed]
    without = np.delete(estimate.theta, np.arange(own.start, own.stop))
    return [
        _change(
            each,
            compose(estimate.experiment, each, rest, without),
            compose(estimate.experiment, each, estimate.effects, estimate.theta),
        )
        for each in estimate.experiment.configurations
        if placed.acts_on(each)
    ]


def _change(configuration: Configuration, before: State, after: State) -> Change:
    stiff = _sway_stiffness(before.system.K), _sway_stiffness(after.system.K)
    mass = before.system.M.sum(axis=1), after.system.M.sum(axis=1)
    diagonal = np.diag(after.system.M) - np.diag(before.system.M)
    moved = mass[1] - mass[0]
    # What couples floors moves mass between them and off the diagonal; what is heavier is seen in the row's sum.
    added = np.where(np.abs(moved) > NOTHING * mass[0], moved, diagonal)
    frequencies = [modes(state.system.M, state.system.K).frequencies for state in (before, after)]
    return Change(
        configuration.name,
        stiff[1] - stiff[0],
        stiff[1] / stiff[0] - 1.0,
        added,
        added / mass[0],
        after.gain / before.gain - 1.0,
        frequencies[1] / frequencies[0] - 1.0,
    )


def _sway_stiffness(K: Floats) -> Floats:
    """A force at the top over the drift of each story under it, shape (N,), N/m: k_i of a shear frame."""
    force = np.zeros(len(K))
    force[-1] = 1.0
    stiffness: Floats = 1.0 / np.diff(np.linalg.solve(K, force), prepend=0.0)
    return stiffness


def in_words(estimate: Estimate, placed: Placed) -> list[str]:
    """Sentences that say how large an effect is.

    Parameters
    ----------
    estimate : Estimate
    placed : Placed
        One of its effects.
    """
    found = changes(estimate, placed)
    return [*_physical(estimate, placed), *_stiffness(found), *_mass(found), *_gain(found), *_frequencies(found)]


def _stiffness(found: list[Change]) -> Iterator[str]:
    shares = np.array([item.stiffness_share for item in found])
    if np.max(np.abs(shares)) < NOTHING:
        return
    worst, story = np.unravel_index(np.argmax(np.abs(shares)), shares.shape)
    least, other = np.unravel_index(np.argmin(np.abs(shares)), shares.shape)
    most = found[int(worst)]
    word = "takes" if shares[worst, story] < 0 else "adds"
    way = "from" if shares[worst, story] < 0 else "to"
    factor, unit = scaled([10 * float(most.stiffness[story])], "N/m")
    sentence = (
        f"It {word} {abs(most.stiffness[story]) / factor:.3g} {unit}, {percent(abs(shares[worst, story]))} of the "
        f"story stiffness, {way} story {story + 1} in “{most.configuration}”, where it does most"
    )
    if shares.size > 1 and abs(shares[least, other]) > NOTHING:
        sentence += (
            f"; least in story {other + 1} in “{found[int(least)].configuration}”: {percent(abs(shares[least, other]))}"
        )
    yield sentence + "."


def _mass(found: list[Change]) -> Iterator[str]:
    shares = np.array([item.mass_share for item in found])
    if np.max(np.abs(shares)) < NOTHING:
        return
    worst, floor = (int(i) for i in np.unravel_index(np.argmax(np.abs(shares)), shares.shape))
    most = found[worst]
    word = "more" if shares[worst, floor] > 0 else "less"
    yield (
        f"The inertia at floor {floor + 1} in “{most.configuration}” is {abs(most.mass[floor]):.3g} kg {word}, "
        f"{percent(abs(shares[worst, floor]))} of what the floor carries."
    )


def _gain(found: list[Change]) -> Iterator[str]:
    for floor, gain in enumerate(found[0].gain, 1):
        if abs(gain) > NOTHING:
            word = "much" if gain > 0 else "little"
            yield f"The sensor at floor {floor} reads {percent(abs(gain))} too {word}; the frame itself is as it was."


def _frequencies(found: list[Change]) -> Iterator[str]:
    moved = np.array([item.frequencies for item in found])
    if np.max(np.abs(moved)) < NOTHING:
        return
    worst, mode = (int(i) for i in np.unravel_index(np.argmax(np.abs(moved)), moved.shape))
    word = "lowers" if moved[worst, mode] < 0 else "raises"
    yield (
        f"It {word} the natural frequency of mode {mode + 1} in “{found[worst].configuration}” by "
        f"{percent(abs(moved[worst, mode]))}, more than any other."
    )


def _physical(estimate: Estimate, placed: Placed) -> Iterator[str]:
    """A parameter that stands for a familiar quantity, such as a reciprocal stiffness, as that quantity."""
    translation = FAMILIAR.get(placed.effect.name)
    if translation is None:
        return
    at = estimate.own(placed)
    value, std = float(estimate.theta[at][0]), float(estimate.std[at][0])
    if value <= 0 or np.isnan(value):
        return
    words, quantity, unit = translation(estimate)
    familiar = quantity / value
    factor, prefixed = scaled([familiar], unit)
    # The standard deviation of a reciprocal: that of the value, relative.
    yield f"{words}: {with_std(familiar, familiar * std / value, prefixed, factor)}."


def _rocking(estimate: Estimate) -> tuple[str, float, str]:
    return "The base resists a turn with the rotational stiffness k_theta", 1.0, "N m/rad"


def _bending(estimate: Estimate) -> tuple[str, float, str]:
    return "The columns together resist bending of the frame as a whole with EI", 1.0, "N m²"


def _joints(estimate: Estimate) -> tuple[str, float, str]:
    n = estimate.experiment.stories
    heights = estimate.experiment.frame.story_heights
    assert heights is not None, "joint_rotation needs story heights"
    mean = float(np.mean(estimate.theta[n : 2 * n] * heights**2))
    return "The beams of a floor together resist a turn of its joints with r", mean, "N m/rad"


FAMILIAR: dict[str, Callable[[Estimate], tuple[str, float, str]]] = {
    "base_rocking": _rocking,
    "axial_columns": _bending,
    "joint_rotation": _joints,
}
"""Effects whose parameter is the reciprocal of what engineers look up: words, quantity times parameter, unit."""


def summary(placed: Placed, parameters: dict[str, float], std: dict[str, float | None]) -> list[tuple[str, str]]:
    """Name and value ± standard deviation of each parameter, with a remark where one sits on a physical bound."""
    return [
        (item.name, with_std(parameters[item.name], std[item.name], item.unit) + at_an_end(item, parameters[item.name]))
        for item in placed.effect.parameters
    ]


def at_an_end(item: Parameter, value: float) -> str:
    """A remark where a parameter's value is one of its physical bounds; empty elsewhere."""
    for bound, word in ((item.lower, "lower"), (item.upper, "upper")):
        if np.isfinite(bound) and abs(value - bound) <= 1e-9 * max(1.0, abs(bound)):
            return f" (at the {word} end of what is physical)"
    return ""
