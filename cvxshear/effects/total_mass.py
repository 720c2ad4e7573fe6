"""A declared total mass that is off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.util.typing import Floats


class TotalMass(Effect):
    """sum of the floor masses = total_mass (1 + e).

    Looked for where the total is declared exact and something else tells how heavy the frame is: added masses that
    differ, scaled shapes, a static test, or a prior that fixes the scale.

    Expected size 10 %: what was weighed or taken off drawings misses bolts, cladding or live load. Who declares a total
    as exact has weighed it: one in fifty is wrong by so much.
    """

    name = "total_mass"
    summary = "The frame is heavier or lighter than its declared total mass."
    formula = "sum of m = total_mass (1 + e)"
    source = "error of the declared total mass"
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    probability = 0.02
    releases = ("total_mass",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # It changes what the masses must add up to, not what they do.
        return state

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1])

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        total, n = experiment.frame.total_mass, experiment.stories
        assert total is not None, "it is looked for where a total is declared"
        row = np.concatenate([np.ones(n), np.zeros(n), [-total]])
        return Constraints(A=row[None], b=np.array([total]))

    def lacks(self, experiment: Experiment) -> str:
        frame = experiment.frame
        if frame.total_mass is None or frame.floor_masses is not None or frame.total_mass_std is not None:
            return "an exact total_mass"
        if not experiment.scale_known_otherwise:
            return "what else tells the scale of the masses, such as a second test with other added mass"
        return ""

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        word = "heavier" if values[0] > 0 else "lighter"
        return f"the frame is {in_percent(values[0], std[0])} {word} than its declared total mass"
