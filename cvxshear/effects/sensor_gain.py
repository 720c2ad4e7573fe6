"""A sensor whose calibration is off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class SensorGain(Effect):
    """The measured shape entry at one floor is 1 + g times the true one, in every mode: in every test, or in one state.

    In one state where the sensor was exchanged or mounted anew between tests; looked for where other states have a
    shape at that floor too, for else it is the sensor's gain in every test.

    Expected size 5 %: calibrations of accelerometers hold within 1 to 10 % (ISO 16063-21 and the data sheets of MEMS
    sensors).
    """

    name = "sensor_gain"
    summary = "The sensor at one floor reads too much or too little by the same factor in every mode."
    formula = "measured phi_j = (1 + g) phi_j"
    source = "calibration error of one sensor"
    stage = "shape"
    parameters = (Parameter("g", "", lower=-0.9, upper=9.0),)
    sits_at = ("floor", "state")

    def places(self, experiment: Experiment) -> list[Place]:
        seen: dict[int, dict[str, None]] = {}
        for each in experiment.configurations:
            for floor, entries in zip(each.measured_floors.tolist(), each.measured.T, strict=True):
                if entries.any():
                    seen.setdefault(floor, {})[each.state] = None
        everywhere = [Place(floor=floor) for floor in sorted(seen)]
        return everywhere + [
            Place(floor=floor, state=state) for floor in sorted(seen) if len(seen[floor]) > 1 for state in seen[floor]
        ]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        scaled = state.observation.scaled(place.floor - 1, 1.0 + values[0], own.start)
        return dataclasses.replace(state, observation=scaled)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.05])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        word = "much" if values[0] > 0 else "little"
        return f"the sensor at floor {place.floor} reads {in_percent(values[0], std[0])} too {word}{place.in_state}"
