"""What an effect does in physical terms: to stiffnesses, masses, shapes and frequencies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Placed, compose
from cvxshear.effects.state import State
from cvxshear.fit.efficient import Estimate
from cvxshear.measurement.experiment import Configuration
from cvxshear.model.shear import frame_modes, modes
from cvxshear.util.quantities import AUTOMATIC, Units, percent
from cvxshear.util.typing import Floats

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
    """Say what an effect of a fit does in each configuration, everything else staying as it is.

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
    n = len(after.story_stiffness)
    stiff = _sway_stiffness(before), _sway_stiffness(after)
    mass = before.system.M[:n, :n].sum(axis=1), after.system.M[:n, :n].sum(axis=1)
    diagonal = np.diag(after.system.M)[:n] - np.diag(before.system.M)[:n]
    moved = mass[1] - mass[0]
    # What couples floors moves mass between them and off the diagonal; what is heavier is seen in the row's sum.
    added = np.where(np.abs(moved) > NOTHING * mass[0], moved, diagonal)
    frequencies = [_frame_frequencies(state) for state in (before, after)]
    return Change(
        configuration.name,
        stiff[1] - stiff[0],
        stiff[1] / stiff[0] - 1.0,
        added,
        added / mass[0],
        after.gain / before.gain - 1.0,
        frequencies[1] / frequencies[0] - 1.0,
    )


def _frame_frequencies(state: State) -> Floats:
    """Frequencies of the frame's modes, without those of masses attached to it, shape (N,), Hz."""
    found = modes(state.system.M, state.system.K)
    return found.frequencies[frame_modes(found, state.system.M, len(state.story_stiffness))]


def _sway_stiffness(state: State) -> Floats:
    """Divide a force at the top by the drift of each story under it, shape (N,), N/m: k_i of a shear frame."""
    K, n = state.system.K, len(state.story_stiffness)
    force = np.zeros(len(K))
    force[n - 1] = 1.0
    stiffness: Floats = 1.0 / np.diff(np.linalg.solve(K, force)[:n], prepend=0.0)
    return stiffness


def consequences(estimate: Estimate, placed: Placed, units: Units = AUTOMATIC) -> list[str]:
    """Sentences that say what an effect of a fit does.

    Parameters
    ----------
    estimate : Estimate
    placed : Placed
        One of its effects.
    units : Units, optional
        In which masses and stiffnesses are shown.
    """
    found = changes(estimate, placed)
    if not found:
        return []
    return [*_stiffness(found, units), *_mass(found, units), *_gain(found), *_frequencies(found)]


def _stiffness(found: list[Change], units: Units) -> Iterator[str]:
    shares = np.array([item.stiffness_share for item in found])
    if np.max(np.abs(shares)) < NOTHING:
        return
    worst, story = np.unravel_index(np.argmax(np.abs(shares)), shares.shape)
    least, other = np.unravel_index(np.argmin(np.abs(shares)), shares.shape)
    most = found[int(worst)]
    word, way = ("takes", "from") if shares[worst, story] < 0 else ("adds", "to")
    factor, unit = units.of_stiffness([10 * float(most.stiffness[story])])
    sentence = (
        f"It {word} {abs(most.stiffness[story]) / factor:.3g} {unit}, {percent(abs(shares[worst, story]))} of the "
        f'story stiffness, {way} story {story + 1} in "{most.configuration}"'
    )
    if (worst, story) != (least, other) and abs(shares[least, other]) > NOTHING:
        sentence += (
            f', where it does most; least in story {other + 1} in "{found[int(least)].configuration}": '
            f"{percent(abs(shares[least, other]))}"
        )
    yield sentence + "."


def _mass(found: list[Change], units: Units) -> Iterator[str]:
    shares = np.array([item.mass_share for item in found])
    if np.max(np.abs(shares)) < NOTHING:
        return
    worst, floor = (int(i) for i in np.unravel_index(np.argmax(np.abs(shares)), shares.shape))
    most = found[worst]
    word = "more" if shares[worst, floor] > 0 else "less"
    factor, unit = units.of_mass([float(most.mass[floor])])
    size = f"{abs(most.mass[floor]) / factor:.3g} {unit}"
    yield (
        f'The inertia at floor {floor + 1} in "{most.configuration}" is {size} {word}, '
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
        f'It {word} the natural frequency of mode {mode + 1} in "{found[worst].configuration}" by '
        f"{percent(abs(moved[worst, mode]))}, more than any other."
    )
