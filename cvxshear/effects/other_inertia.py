"""A mass matrix that is not diagonal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import MOST_OPEN_STORIES, OpenClass, named_pair, pairs
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class OtherInertia(OpenClass):
    """M_ij = M_ji = mu_ij for every pair of floors i < j.

    Expected size: 2 % of a floor's mass, between 0.4 and 9 % in two thirds of all cases; the columns' own mass couples
    neighboring floors by a tenth of what a story's columns weigh.
    """

    name = "other_inertia"
    summary = "The inertia of the floors is coupled in a way that no effect of the catalogue has."
    formula = "M + sum of mu_ij (e_i e_j' + e_j e_i') over all pairs of floors"
    source = "every symmetric mass matrix has N(N-1)/2 entries off its diagonal"
    stage = "inertia"
    holds_in_words = "that the inertia of each floor is its own"
    place_in_words = "something that the catalogue does not hold couples the inertia of"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(named_pair(i, j), "kg") for i, j in pairs(experiment.stories, ground=False)]

    def lacks(self, experiment: Experiment) -> str:
        tall = experiment.stories > MOST_OPEN_STORIES
        return f"at most {MOST_OPEN_STORIES} stories" if tall else super().lacks(experiment)

    def usual_size(self, scale: Scale) -> float:
        return 0.02 * scale.floor_mass

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        i, j = np.array(pairs(len(state.story_stiffness), ground=False)).T - 1
        M, dM = state.system.M.copy(), state.system.dM.copy()
        rows = np.arange(own.start, own.stop)
        for a, b in ((i, j), (j, i)):
            M[a, b] += values
            dM[rows, a, b] += 1.0
        return state.with_mass(M, dM)
