"""Declared added masses that are all off by one factor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class LoadScale(Effect):
    """Every declared added mass is 1 + e times what was declared.

    Looked for where the total mass is declared and masses were added: with a frame whose mass only the added masses
    tell, the factor is one of all masses and stiffnesses, which nothing measures. Where the total is declared exact,
    a total that is off (total_mass) does the same to every mode.

    Expected size 10 %: weights that were counted and not weighed, on a scale that nobody calibrated, or declared in
    another unit of force; they are weighed more often than not, so one test in fifty.
    """

    name = "load_scale"
    summary = "All added masses are heavier or lighter than declared by the same factor."
    formula = "added mass a_j (1 + e) on every floor j, in every state"
    source = "calibration of the scale that weighed the added masses"
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    probability = 0.02
    granted = "that the added masses weigh what was declared"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        added = np.diag(state.tested.added_mass)
        dM = state.system.dM.copy()
        dM[own] += added
        return state.with_mass(state.system.M + values[0] * added, dM)

    def lacks(self, experiment: Experiment) -> str:
        if not any(each.added_mass.any() for each in experiment.tested):
            return "added_mass"
        frame = experiment.frame
        return "total_mass or floor_masses" if frame.total_mass is None and frame.floor_masses is None else ""

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        word = "heavier" if values[0] > 0 else "lighter"
        return f"the added masses are {in_percent(values[0], std[0])} {word} than declared"
