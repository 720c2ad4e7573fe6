"""The columns' own mass moves with both floors it hangs between."""

from __future__ import annotations

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.typing import Floats


class MassCoupling(Effect):
    """The columns' mass mu a story, consistent (13/35, 9/70) in place of lumped (1/2, 0).

    Each story's columns give mu (13/35 - 1/2) to the diagonal at either end and mu 9/70 between the two; the
    floor masses stay what they are, with half the columns of each adjoining story lumped into them. The weight
    above a story is that of the lumped masses, so gravity acts before.
    """

    name = "mass_coupling"
    summary = (
        "The columns' own mass moves with both floors they join, which couples neighbouring floors through the mass."
    )
    formula = "M + mu sum over stories of [[13/35 - 1/2, 9/70], [9/70, 13/35 - 1/2]]"
    source = "consistent mass matrix of a Bernoulli beam in sway, Archer 1963"
    stage = "inertia"
    parameters = (Parameter("mu", "kg", lower=0.0),)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        stories = len(state.story_stiffness)
        # The ground's end of the first story does not move, and no story stands on the top floor.
        ends = np.full(stories, 2.0)
        ends[-1] = 1.0
        unit = (13 / 35 - 1 / 2) * np.diag(ends) + (9 / 70) * (np.eye(stories, k=1) + np.eye(stories, k=-1))
        dM = state.system.dM.copy()
        dM[own] += unit
        return state.with_mass(state.system.M + values[0] * unit, dM)
