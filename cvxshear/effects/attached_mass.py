"""Masses attached to a floor by a spring: a tank, a machine on mounts, a tuned damper, a loose load."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, shown_states
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import System
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats

LEAST_MASS = 1e-6
"""Minimum attached mass, as a fraction of the mean floor mass, added to the parameter. The frame then has modes even if
the parameter is zero. The frequencies move by less than a millionth, unless the two are tuned to each other."""

LEAST_FREQUENCY, MOST_FREQUENCY = 0.5, 1.5
"""Bounds of the attachment's frequency, in parts of the lowest and of the highest measured frequency. A slower
attachment acts like a missing mass on every mode, a faster one like an added mass."""

START_MASS = 0.05
"""Attached mass at the start of a fit, in parts of the mean floor mass; without a declared total, in parts of the
largest added mass, or in kg without added mass. Fits from almost no mass stay at their start."""

FROM_THE_LOWEST, FROM_THE_HIGHEST = (1.1, 0.8, 2.0), (0.6, 1.2)
"""Frequencies at the start of fits, in parts of the lowest and of the highest measured one. The places of twelve
simulated tanks and dampers were reached from five of them as from ten; without 0.8 and 2.0 three of nine were missed.
For a base with its own mass, on soil of stiffness s below story 1 of stiffness k, every floor moves with the series of
both springs and an attachment to floor 1. The attachment has (k / (k + s))^2 of the base's mass and the frequency of
the base between soil and story, which is above most modes."""

STIFFEST_MOUNTING = 10.0
"""Bound of the frequency of loads on their mountings, in parts of the highest measured frequency. Faster loads act
within 1 % like loads on the bare floor."""


class _OnSprings(Effect):
    """Masses that move relative to the floors, at a frequency near the measured ones."""

    source = "Den Hartog, Mechanical Vibrations: the undamped absorber"
    stage = "attachment"
    adds_motion = True
    measured: tuple[float, float] = (1.0, 1.0)
    """Lowest and highest measured frequency, Hz."""

    def bound(self, experiment: Experiment) -> Self:
        """Make a copy with bounds of the frequency about the measured ones."""
        measured = np.concatenate([each.frequencies for each in experiment.configurations])
        lowest, highest = float(measured.min()), float(measured.max())
        own = self.having(self.ranged(experiment, lowest, highest))
        own.measured = lowest, highest
        return own

    @abstractmethod
    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        """Return the parameters for the range of the measured frequencies, Hz."""


class AttachedMass(_OnSprings):
    """M + m e_v e_v', K + m (2 pi f)^2 d d', d = e_v - e_j: one more degree of freedom v, without a sensor.

    f is the frequency of the mass on a fixed floor. The mass is not part of the floor masses or the declared total, and
    gravity does not include its weight. The frame has one more mode. Modes are numbered without the attachment's own
    mode, the one with the largest share of kinetic energy in the attachment. If two modes share this energy, as for a
    damper tuned to a mode, either may have been measured; then the numbers are the ones that fit the measured
    frequencies best (`data/pairing.py:numbered`).

    Expected size: 15 % of a floor's mass; tuned dampers weigh 1 to 5 % of the whole frame, tanks and machines 5 to 20 %
    of a floor (Soong and Dargush, Passive Energy Dissipation Systems). The prior of the frequency is uniform over the
    measured range. Such objects are visible, so one frame in fifty has an overlooked one. Dampers and tanks usually
    stand at the place of the largest motion, so the top floor has the same probability as all other floors together. In
    one state of several, the object was added or removed between the tests.
    """

    name = "attached_mass"
    summary = "A mass on a spring moves on one floor with a motion of its own: a tank, a machine, a tuned damper."
    formula = "M + m e_v e_v', K + m (2 pi f)^2 d d',  d = e_v - e_j"
    parameters = (Parameter("mass", "kg", lower=0.0), Parameter("frequency", "Hz", lower=0.01, upper=100.0, start=1.0))
    sits_at = ("floor",)
    probability = 0.02

    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        total = experiment.frame.known_total
        added = max(float(each.added_mass.max()) for each in experiment.configurations)
        floor = (added or 1.0) if total is None else total / experiment.stories
        start = FROM_THE_LOWEST[0] * lowest
        low, high = LEAST_FREQUENCY * lowest, MOST_FREQUENCY * highest
        return (
            Parameter("mass", "kg", lower=0.0, start=START_MASS * floor),
            Parameter("frequency", "Hz", low, high, null=start, start=start),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting points: one mass, with frequencies in the measured range."""
        mass, frequency = self.parameters
        lowest, highest = self.measured
        places = [*(part * lowest for part in FROM_THE_LOWEST), *(part * highest for part in FROM_THE_HIGHEST)]
        return tuple((mass.start, min(place, frequency.upper)) for place in places)

    def places(self, experiment: Experiment) -> list[Place]:
        floors = range(1, experiment.stories + 1)
        return [Place(floor=floor, state=state) for state in (None, *shown_states(experiment)) for floor in floors]

    def weight(self, place: Place, experiment: Experiment) -> float:
        return float(max(1, experiment.stories - 1)) if place.floor == experiment.stories else 1.0

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        stories = len(state.story_stiffness)
        by_mass = np.zeros(len(state.system.dM))
        by_mass[own.start] = 1.0
        by_mass[:stories] = LEAST_MASS / stories
        mass = float(values[0] + LEAST_MASS * np.mean(state.floor_mass))
        return with_attached(state, place.floor_index, mass, by_mass, float(values[1]), own.start + 1)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.floor_mass, np.inf])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        mass, frequency = (with_std(value, error, unit) for value, error, unit in zip(values, std, units, strict=True))
        said = f"a mass of {mass} swings on floor {place.floor} at {frequency} of its own{place.in_state}"
        return said if place.floor != 1 else f"{said}, or the base has a mass of its own on soft ground"


class LoadMounting(_OnSprings):
    """Every declared added mass a_j is attached to floor j by a spring a_j (2 pi f)^2.

    f is the frequency of the loads on fixed floors. In a mode of frequency w a load then acts as the mass a_j / (1 - (w
    / f)^2), which grows with the mode's frequency below f.

    The prior of f is uniform between the lowest measured frequency and ten times the highest; above, loads act within 1
    % like loads on the bare floor. Most weights are clamped or screwed down; weights on rubber, on sand bags or in a
    loose stack move in one loaded test out of thirty.
    """

    name = "load_mounting"
    summary = "The added masses are not fast to the floors: on rubber, on sand bags or in a loose stack they move."
    formula = "a_j off floor j; M + a_j e_v e_v', K + a_j (2 pi f)^2 d d',  d = e_v - e_j, for every load j"
    parameters = (Parameter("frequency", "Hz", lower=0.01, upper=1000.0, start=10.0),)
    probability = 0.03

    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        stiff = STIFFEST_MOUNTING * highest
        return [Parameter("frequency", "Hz", lower=lowest, upper=stiff, null=stiff, start=2.0 * highest)]

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting frequencies, from the measured range to above it."""
        lowest, highest = self.measured
        return tuple((float(each),) for each in (np.sqrt(lowest * highest), 1.2 * highest, 2.0 * highest))

    def lacks(self, experiment: Experiment) -> str:
        return "" if any(each.added_mass.any() for each in experiment.tested) else "added_mass"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        loads = state.tested.added_mass
        M, none = state.system.M.copy(), np.zeros(len(state.system.dM))
        at = np.arange(len(loads))
        M[at, at] -= loads
        state = state.with_mass(M, state.system.dM)
        for floor in np.flatnonzero(loads).tolist():
            state = with_attached(state, floor, float(loads[floor]), none, float(values[0]), own.start)
        return state

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f"the added masses are not fast to the floors: they swing at {with_std(values[0], std[0], units[0])}"


def with_attached(state: State, floor: int, mass: float, by_mass: Floats, frequency: float, own: int) -> State:
    """Attach a mass to one floor, with its own degree of freedom and without a sensor.

    Parameters
    ----------
    state : State
    floor : int
        Index of the floor, counted from 0.
    mass : float
        Attached mass, kg.
    by_mass : ndarray, shape (P,)
        Derivatives of the mass by all parameters.
    frequency : float
        Frequency of the mass on a fixed floor, Hz.
    own : int
        Index of the frequency among the parameters.
    """
    system = state.system
    square = (2 * np.pi * frequency) ** 2
    d = np.zeros(len(system.K) + 1)
    d[-1], d[floor] = 1.0, -1.0
    unit = np.outer(d, d)
    M, K, dM, dK = (_bordered(each) for each in (system.M, system.K, system.dM, system.dK))
    M[-1, -1] = mass
    dM[:, -1, -1] = by_mass
    K += mass * square * unit
    dK += (by_mass * square)[:, None, None] * unit
    dK[own] += mass * 2 * square / frequency * unit
    return dataclasses.replace(state, system=System(M, K, dM, dK), observation=state.observation.extended())


def _bordered(matrices: Floats) -> Floats:
    """Append a row and a column of zeros to each matrix; `numpy.pad` takes many times longer for small ones."""
    *several, rows, columns = matrices.shape
    found = np.zeros((*several, rows + 1, columns + 1))
    found[..., :-1, :-1] = matrices
    return found
