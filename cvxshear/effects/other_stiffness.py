"""A stiffness matrix that is not that of a shear frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import MOST_OPEN_STORIES, OpenClass, named_pair, pairs
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class OtherStiffness(OpenClass):
    """K + sum of s_ij d_ij d_ij' over all pairs of levels that no story joins, d_ij = e_j - e_i, e_0 = 0.

    Every symmetric K is such a network of springs between all pairs of levels, the ground among them: N of them are the
    stories, the other N(N-1)/2 this class. Springs may be negative.

    Expected size: 2 % of a story's stiffness, between 0.4 and 9 % in two thirds of all cases.
    """

    name = "other_stiffness"
    summary = "The floors are tied to each other in a way that no shear frame and no effect of the catalogue has."
    formula = "K + sum of s_ij d_ij d_ij', d_ij = e_j - e_i, over the pairs of levels at least two apart"
    source = "every symmetric matrix is a network of springs between all pairs of its nodes and the ground"
    stage = "spring"
    holds_in_words = "that only neighboring floors are tied to each other"
    place_in_words = "something that the catalogue does not hold ties"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(named_pair(i, j), "N/m") for i, j in pairs(experiment.stories, ground=True)]

    def cause_at(self, entry: int, place: Place, experiment: Experiment) -> tuple[str, Place]:
        i, j = pairs(experiment.stories, ground=True)[entry]
        return ("spring", Place(floor=i, to=j)) if i else ("ground_spring", Place(floor=j))

    def lacks(self, experiment: Experiment) -> str:
        tall = experiment.stories > MOST_OPEN_STORIES
        return f"at most {MOST_OPEN_STORIES} stories" if tall else super().lacks(experiment)

    def usual_size(self, scale: Scale) -> float:
        return 0.02 * scale.story_stiffness

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        unit = _springs(len(state.story_stiffness))
        dK = state.system.dK.copy()
        size = unit.shape[1]
        dK[own, :size, :size] += unit
        K = state.system.K.copy()
        K[:size, :size] += np.tensordot(values, unit, 1)
        return state.with_stiffness(K, dK)


@lru_cache(maxsize=8)
def _springs(stories: int) -> Floats:
    """d d' of each spring of unit stiffness, shape (N(N-1)/2, N, N)."""
    found = []
    for i, j in pairs(stories, ground=True):
        d = np.zeros(stories)
        d[j - 1] = 1.0
        if i:
            d[i - 1] = -1.0
        found.append(np.outer(d, d))
    return np.array(found)
