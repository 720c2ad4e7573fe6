"""A story that is stiffer or softer in one configuration than in the others."""

from __future__ import annotations

import dataclasses

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.frame import stiffness_matrix, transformation
from cvxshear.typing import Floats


class StoryChange(Effect):
    """k_i (1 + change) in one configuration."""

    name = "story_change"
    summary = (
        "One story is softer or stiffer in one configuration than in the others: damage, or a joint that loosened."
    )
    formula = "k_i (1 + change) in one configuration"
    source = "change of one story's columns or joints between tests"
    stage = "story"
    parameters = (Parameter("change", "", lower=-0.99, upper=99.0),)
    sits_at = ("story", "configuration")
    needs = ("several configurations",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.story is not None
        at = place.story - 1
        k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
        dk[:, at] *= 1.0 + values[0]
        dk[own, at] += k[at]
        k[at] *= 1.0 + values[0]
        T = transformation(len(k))
        changed = dataclasses.replace(state, story_stiffness=k, d_story_stiffness=dk)
        return changed.with_stiffness(stiffness_matrix(k), (T * dk[:, None, :]) @ T.T)
