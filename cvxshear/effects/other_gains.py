"""Sensors of which each reads by a factor of its own too much or too little."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class OtherGains(OpenClass):
    """The measured shape entry at each floor is 1 + g_j times the true one, in every configuration and mode.

    Expected size: 5 % of each reading, between 1 and 22 % in two thirds of all cases.
    """

    name = "other_gains"
    summary = "Every sensor reads too much or too little, each by its own factor."
    formula = "measured phi_j = (1 + g_j) phi_j for every floor j with a sensor"
    source = "sensors of different make, or calibrated by different hands"
    stage = "shape"
    probability = 0.01
    holds_in_words = "that the sensors show the motion"
    place_in_words = "what stands out is the sensor at"

    floors: tuple[int, ...] = ()
    """The floors at which any shape was measured, those of `parameters`."""

    def bound(self, experiment: Experiment) -> Self:
        own = super().bound(experiment)
        own.floors = tuple(_floors(experiment))
        return own

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"floor {floor}", "", lower=-0.9, upper=9.0) for floor in _floors(experiment)]

    def usual_size(self, scale: Scale) -> float:
        return 0.05

    def cause_at(self, entry: int, place: Place, experiment: Experiment) -> tuple[str, Place]:
        return "sensor_gain", Place(floor=_floors(experiment)[entry])

    def lacks(self, experiment: Experiment) -> str:
        return "" if len(_floors(experiment)) > 1 else "shapes at two floors or more"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        observation = state.observation
        for parameter, (floor, gain) in enumerate(zip(self.floors, values, strict=True), own.start):
            observation = observation.scaled(floor - 1, 1.0 + float(gain), parameter)
        return dataclasses.replace(state, observation=observation)


def _floors(experiment: Experiment) -> list[int]:
    """List the floors at which any shape was measured."""
    return sorted({int(floor) for each in experiment.configurations for floor in each.measured_floors})
