"""A state whose floors carry other masses than declared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.util.typing import Floats


class OtherLoads(OpenClass):
    """M + diag(mass_i) in one state; no floor can lose more than it holds.

    Expected size: 10 % of a floor's mass, between 2 and 45 % in two thirds of all cases.
    """

    name = "other_loads"
    summary = "In one state every floor carries another mass than was declared."
    formula = "M + diag(mass_i), in one state"
    source = "live load, furniture, instruments: each floor by itself"
    stage = "mass"
    probability = 0.01
    sits_at = ("state",)
    needs = ("several states",)
    holds_in_words = "that the floors carry what was declared"
    place_in_words = "what differs most is"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"floor {i}", "kg") for i in range(1, experiment.stories + 1)]

    def usual_size(self, scale: Scale) -> float:
        return 0.1 * scale.floor_mass

    def cause_at(self, entry: int, place: Place, experiment: Experiment) -> tuple[str, Place]:
        return "added_mass", Place(floor=entry + 1, state=place.state)

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        n = experiment.stories
        declared = np.array([each.added_mass for each in experiment.tested if each.state == place.state])
        G = np.hstack([-np.eye(n), np.zeros((n, n)), -np.eye(n)])
        return Constraints(G=G, h=declared.min(axis=0))

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        at = np.arange(len(values))
        M, dM = state.system.M.copy(), state.system.dM.copy()
        M[at, at] += values
        dM[np.arange(own.start, own.stop), at, at] += 1.0
        return state.with_mass(M, dM)
