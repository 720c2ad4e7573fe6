"""The columns' own mass moves with both floors it hangs between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class MassCoupling(Effect):
    """The columns' mass mu a story, consistent (13/35, 9/70) in place of lumped (1/2, 0).

    Each story's columns give mu (13/35 - 1/2) to the diagonal at either end and mu 9/70 between the two; the
    floor masses stay what they are, with half the columns of each adjoining story lumped into them. So no floor is
    lighter than these halves: mu <= m_i, and mu / 2 <= m_N. The weight above a story is that of the lumped masses, so
    gravity acts before.

    Expected size: a tenth of the mean floor mass; columns and walls weigh 5 to 20 % of a floor in buildings, less in
    laboratory frames, where it seldom shows: 5 %.
    """

    name = "mass_coupling"
    summary = (
        "The columns' own mass moves with both floors they join, which couples neighbouring floors through the mass."
    )
    formula = "M + mu sum over stories of [[13/35 - 1/2, 9/70], [9/70, 13/35 - 1/2]]"
    source = "consistent mass matrix of a Bernoulli beam in sway, Archer 1963"
    stage = "inertia"
    parameters = (Parameter("mu", "kg", lower=0.0),)
    probability = 0.05

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        stories = len(state.story_stiffness)
        ends = _ends(stories)
        unit = (13 / 35 - 1 / 2) * np.diag(ends) + (9 / 70) * (np.eye(stories, k=1) + np.eye(stories, k=-1))
        dM = state.system.dM.copy()
        dM[own] += unit
        return state.with_mass(state.system.M + values[0] * unit, dM)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1 * scale.floor_mass])

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        n = experiment.stories
        held = np.hstack([-np.eye(n), np.zeros((n, n)), 0.5 * _ends(n)[:, None]])
        return Constraints(G=held, h=np.zeros(n))

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = with_std(values[0], std[0], units[0])
        return f"the columns of a story weigh {size}, and their mass moves with both floors that they join"


def _ends(stories: int) -> Floats:
    """Stories that end at each floor: the ground's end of the first does not move, none stands on the top floor."""
    ends = np.full(stories, 2.0)
    ends[-1] = 1.0
    return ends
