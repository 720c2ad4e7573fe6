"""Readings and declared statements that do not hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, off_by
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
    usual = 0.05
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
        scaled = state.observation.scaled(place.floor_index, 1.0 + values[0], own.start)
        return dataclasses.replace(state, observation=scaled)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = off_by(values[0], std[0], "too much", "too little")
        return f"the sensor at floor {place.floor} reads {size}{place.in_state}"


class WrongPrior(Effect):
    """Every residual of one soft prior, or of a total mass with a standard deviation, is off by a number of its own.

    Those numbers, in standard deviations of the statement, are normal about zero with one common size: the same as a
    standard deviation that is larger by that factor.

    Expected size: five times the declared standard deviation, between 2 and 14 times in two thirds of all cases; who
    judges "within 2 %" from drawings is wrong by 10 % now and then. One statement in thirty does not hold.
    """

    name = "wrong_prior"
    summary = "A statement that was declared with a standard deviation is wrong by several times that."
    formula = "residual of the prior - e, e normal about 0 with a standard deviation of about 5"
    source = "design values and judgement that do not hold for the frame as built"
    stage = "story"
    common_size = True
    usual = 5.0
    size_width = 1.0
    probability = 0.03
    parameters: tuple[Parameter, ...] = ()

    def places(self, experiment: Experiment) -> list[Place]:
        return [Place(prior=words) for words, rows in experiment.soft_statements if rows]

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "a prior with a standard deviation"

    def bound_at(self, experiment: Experiment, place: Place) -> Self:
        rows = dict(experiment.soft_statements)[str(place.prior)]
        return self.having(Parameter(f"e{i}" if rows > 1 else "e", "") for i in range(1, rows + 1))

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # It acts on the prior that its place names, not on the frame.
        return state

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        largest = float(np.max(np.abs(values)))
        return f'the statement "{place.prior}" is wrong by {largest:.1f} of its standard deviations'
