"""A mass that the declaration of one state misses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class AddedMass(Effect):
    """M + mass e e' at one floor in one state; negative where more was declared than was there.

    No floor can lose more than it holds. Expected size: 15 % of the mean floor mass, a weight that somebody carried
    up or took away.
    """

    name = "added_mass"
    summary = "In one state a floor carries more or less mass than was declared."
    formula = "M + mass e_j e_j' in one state"
    source = "rigid mass at floor j"
    stage = "mass"
    parameters = (Parameter("mass", "kg"),)
    sits_at = ("floor", "state")
    needs = ("several states",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        at = place.floor - 1
        M, dM = state.system.M.copy(), state.system.dM.copy()
        M[at, at] += values[0]
        dM[own, at, at] += 1.0
        return state.with_mass(M, dM)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        assert place.floor is not None
        return "story_change", Place(story=stories + 1 - place.floor, state=place.state)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.floor_mass])

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        assert place.floor is not None
        declared = [each.added_mass[place.floor - 1] for each in experiment.tested if each.state == place.state]
        row = np.zeros(2 * experiment.stories + 1)
        row[place.floor - 1] = row[-1] = -1.0
        return Constraints(G=row[None], h=np.array([min(declared, default=0.0)]))

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = with_std(abs(values[0]), std[0], units[0])
        word = "more" if values[0] > 0 else "less"
        return f"floor {place.floor} carries {size} {word}{place.in_state} than declared"
