"""A story that is stiffer or softer in one state than in the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class StoryChange(Effect):
    """k_i (1 + change) in one state.

    Where a part of the story's stiffness is braces they change first: a loss takes from them until they are gone, a
    gain goes to them until they are twice what they were, and the columns have the rest. The number stays the share of
    the whole story's stiffness.

    Expected size 25 %: what damage, a loosened joint or a repair does to a story is seen from some percent up, and a
    story that has lost more than half is no story of this frame any more.
    """

    name = "story_change"
    summary = "One story is softer or stiffer in one state than in the others: damage, a repair, a joint that loosened."
    formula = "k_i (1 + change) in one state"
    source = "change of one story's columns or joints between tests"
    stage = "story"
    parameters = (Parameter("change", "", lower=-0.99, upper=99.0),)
    sits_at = ("story", "state")
    needs = ("several states",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.story is not None
        return with_changed_story(state, place.story - 1, values[0], own.start)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        assert place.story is not None
        return "added_mass", Place(floor=stories + 1 - place.story, state=place.state)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.25])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = in_percent(values[0], std[0])
        if values[0] > 0:
            return f"story {place.story} is {size} stiffer{place.in_state}"
        return f"story {place.story} lost {size} of its stiffness{place.in_state}"


def with_changed_story(state: State, at: int, change: float, parameter: int) -> State:
    """Multiply the stiffness of one story by 1 + change, its braces changed first.

    Parameters
    ----------
    state : State
    at : int
        The story, counted from 0.
    change : float
    parameter : int
        Row of the derivatives that is by the change.
    """
    k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
    brace, d_brace = state.brace_stiffness.copy(), state.d_brace_stiffness.copy()
    gained, d_gained = change * k[at], change * dk[:, at]
    d_gained[parameter] += k[at]
    if abs(gained) > brace[at]:
        # The braces are gone, or twice what they were; the columns have the rest.
        factor = 1.0 + np.sign(gained)
        brace[at] *= factor
        d_brace[:, at] *= factor
    else:
        brace[at] += gained
        d_brace[:, at] += d_gained
    k[at] += gained
    dk[:, at] += d_gained
    return dataclasses.replace(
        state, story_stiffness=k, d_story_stiffness=dk, brace_stiffness=brace, d_brace_stiffness=d_brace
    )
