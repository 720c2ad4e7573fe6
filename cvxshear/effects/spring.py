"""Two floors that something besides the stories between them ties together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.quantities import scaled, with_std
from cvxshear.util.typing import Floats


class Spring(Effect):
    """K + s d d', d = e_to - e_floor, between two floors at least two levels apart.

    Between neighbors it would be a story's own stiffness; to the ground it is ground_spring.

    Expected size: a fifth of the mean story stiffness. A brace over two stories is a member of the frame and as stiff
    as a story, a stair or a cable a tenth of it. What ties floors that are apart can be seen, so one frame in thirty
    has one that nobody declared.
    """

    name = "spring"
    summary = (
        "Something ties two floors that are not neighbors: a brace over several stories, a stair, a cable, a core."
    )
    formula = "K + s d d',  d = e_to - e_floor"
    source = "linear spring between two floors"
    stage = "spring"
    parameters = (Parameter("s", "N/m", lower=0.0),)
    sits_at = ("floor", "to")
    probability = 0.03

    def places(self, experiment: Experiment) -> list[Place]:
        n = experiment.stories
        return [Place(floor=low, to=high) for low in range(1, n + 1) for high in range(low + 2, n + 1)]

    def lacks(self, experiment: Experiment) -> str:
        return "" if experiment.stories > 2 else "three stories"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        assert place.to is not None
        d = np.zeros(len(state.story_stiffness))
        d[place.to - 1], d[place.floor - 1] = 1.0, -1.0
        unit = np.outer(d, d)
        dK = state.system.dK.copy()
        dK[own] += unit
        return state.with_stiffness(state.system.K + values[0] * unit, dK)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.2 * scale.story_stiffness])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        factor, unit = scaled([float(values[0])], units[0])
        return f"a spring of {with_std(values[0], std[0], unit, factor)} ties floors {place.floor} and {place.to}"
