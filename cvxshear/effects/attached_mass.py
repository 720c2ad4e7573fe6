"""A mass that hangs or stands on one floor by a spring: a tank, a machine on mounts, a tuned damper."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import System
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats

LEAST_MASS = 1e-6
"""Part of the mean floor mass that the attached mass has more than its parameter says, so that the frame has modes
where that is zero; it moves a frequency by less than a millionth unless the two are tuned to each other."""

SLOWEST, FASTEST = 0.5, 1.5
"""Bounds of the attachment's frequency, in parts of the lowest and of the highest that was measured: one that is slower
acts like a missing mass on every mode, one that is faster like an added mass."""

START_MASS, START_FREQUENCY = 0.05, 1.05
START_FREQUENCIES = (0.65, 0.95, 1.05, 1.2, 1.7, 2.5)
"""Where fits start: a mass in parts of the mean mass of a floor, of the largest added mass where none is declared, else
in kg; frequencies in parts of the lowest measured. From a mass of that order fits of frames with tanks and dampers of
2 to 5 % of their mass end at the best place from one of these frequencies at least; from next to none they stay where
they are."""

AMONG_THE_HIGHEST = (0.6, 1.2)
"""Frequencies where further fits start, in parts of the highest that was measured. A base with a mass of its own, on
soil of stiffness s below story 1 of stiffness k, is to every floor the series of both with an attachment to floor 1 of
(k / (k + s))^2 of the base's mass, at the frequency that the base has between soil and story: above most modes."""


class AttachedMass(Effect):
    """M + m e_v e_v', K + m (2 pi f)^2 d d', d = e_v - e_j: one motion v more, which no sensor shows.

    f is the frequency that the mass would have on a floor that stands still. The mass is not part of the floor masses
    nor of the declared total, and its weight is not in that of gravity. The frame has one mode more; modes are numbered
    without the attachment's own, the one whose kinetic energy is most its own. Only where two modes share that energy,
    as a damper makes of the mode that it is tuned to, either may have been measured; then the numbers are those that
    fit the measured frequencies best (`data/pairing.py:numbered`).

    Expected size: 15 % of a floor's mass; tuned dampers weigh 1 to 5 % of the whole frame, tanks and machines 5 to 20 %
    of a floor (Soong and Dargush, Passive Energy Dissipation Systems). Any frequency among those that were measured
    is as probable. Such things can be seen, so one frame in fifty has one that nobody thought of; dampers and tanks
    stand where the frame moves most, so that the top floor is as probable as all the others together.
    """

    name = "attached_mass"
    summary = "A mass on a spring moves on one floor with a motion of its own: a tank, a machine, a tuned damper."
    formula = "M + m e_v e_v', K + m (2 pi f)^2 d d',  d = e_v - e_j"
    source = "Den Hartog, Mechanical Vibrations: the undamped absorber"
    stage = "attachment"
    parameters = (Parameter("mass", "kg", lower=0.0), Parameter("frequency", "Hz", lower=0.01, upper=100.0, start=1.0))
    sits_at = ("floor",)
    adds_motion = True
    probability = 0.02

    def bound(self, experiment: Experiment) -> Self:
        """Make a copy whose frequency lies about those that were measured."""
        measured = np.concatenate([each.frequencies for each in experiment.configurations])
        lowest, highest = float(measured.min()), float(measured.max())
        total = experiment.frame.known_total
        added = max(float(each.added_mass.max()) for each in experiment.configurations)
        floor = (added or 1.0) if total is None else total / experiment.stories
        mass = Parameter("mass", "kg", lower=0.0, start=START_MASS * floor)
        start = START_FREQUENCY * lowest
        frequency = Parameter(
            "frequency", "Hz", lower=SLOWEST * lowest, upper=FASTEST * highest, null=start, start=start
        )
        return self.having((mass, frequency))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """One mass, and frequencies among those that were measured."""
        mass, frequency = self.parameters
        lowest, highest = frequency.start / START_FREQUENCY, frequency.upper / FASTEST
        starts = [(mass.start, part * lowest) for part in START_FREQUENCIES]
        # The smaller of two masses, where a fit from the larger one steps over the place.
        starts += [(size * mass.start, part * highest) for part in AMONG_THE_HIGHEST for size in (1.0, 0.5)]
        return tuple((size, float(min(place, frequency.upper))) for size, place in starts)

    def weight(self, place: Place, experiment: Experiment) -> float:
        return float(max(1, experiment.stories - 1)) if place.floor == experiment.stories else 1.0

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        system = state.system
        motions, stories = len(system.K), len(state.story_stiffness)
        mass = float(values[0] + LEAST_MASS * np.mean(state.floor_mass))
        square = float((2 * np.pi * values[1]) ** 2)
        d = np.zeros(motions + 1)
        d[-1], d[place.floor_index] = 1.0, -1.0
        unit = np.outer(d, d)
        by_mass = np.zeros(len(system.dM))
        by_mass[own.start] = 1.0
        by_mass[:stories] = LEAST_MASS / stories
        more = ((0, 1), (0, 1))
        M, K = np.pad(system.M, more), np.pad(system.K, more)
        dM, dK = (np.pad(slopes, ((0, 0), *more)) for slopes in (system.dM, system.dK))
        M[-1, -1] = mass
        dM[:, -1, -1] = by_mass
        K += mass * square * unit
        dK += (by_mass * square)[:, None, None] * unit
        dK[own.start + 1] += mass * 2 * square / values[1] * unit
        return dataclasses.replace(state, system=System(M, K, dM, dK), observation=state.observation.extended())

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.floor_mass, np.inf])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        mass, frequency = (with_std(value, error, unit) for value, error, unit in zip(values, std, units, strict=True))
        said = f"a mass of {mass} swings on floor {place.floor} at {frequency} of its own"
        return said if place.floor != 1 else f"{said}, or the base has a mass of its own on soft ground"
