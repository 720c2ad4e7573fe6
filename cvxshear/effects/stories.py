"""Stories that differ between states, and the part of them that is braces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent, off_by
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
    usual = 0.25

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.story is not None
        return with_changed_story(state, place.story - 1, values[0], own.start)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        assert place.story is not None
        return "added_mass", Place(floor=stories + 1 - place.story, state=place.state)

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
    return state.having(story_stiffness=k, d_story_stiffness=dk, brace_stiffness=brace, d_brace_stiffness=d_brace)


class StateStiffness(Effect):
    """Every story stiffness times 1 + e in one state, and with them the stiffness of its beams and joints.

    Springs to the ground and between floors, the base and the weight stay what they are. In a state whose mass scale
    nothing measured it cannot be told from heavier floors, nor from a clock that runs slow by half of e.

    Expected size 10 %: frequencies fall by 2 to 10 % with the amplitude of the motion and by as much with temperature
    and cracking of the whole frame (Clinton et al. 2006 on the Millikan Library; Peeters and De Roeck 2001 on a
    bridge), twice that in stiffness; of frames tested in several states one in twenty has it.
    """

    name = "state_stiffness"
    summary = "The whole frame is softer or stiffer in one state: amplitude, temperature, cracks, or a retrofit."
    formula = "k_i (1 + e) for every story i, in one state"
    source = "one factor on the elastic modulus of the frame"
    stage = "story"
    parameters = (Parameter("e", "", lower=-0.99, upper=99.0),)
    sits_at = ("state",)
    needs = ("several states",)
    probability = 0.05
    usual = 0.1
    granted = "that the stories of {state} did not all soften or stiffen by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        factor = 1.0 + values[0]

        def slopes(k: Floats, dk: Floats) -> Floats:
            moved: Floats = factor * dk
            moved[own] += k
            return moved

        # The columns' stiffness is what beams and joints are measured by: they soften with it.
        return state.having(
            story_stiffness=factor * state.story_stiffness,
            d_story_stiffness=slopes(state.story_stiffness, state.d_story_stiffness),
            brace_stiffness=factor * state.brace_stiffness,
            d_brace_stiffness=slopes(state.brace_stiffness, state.d_brace_stiffness),
            column_stiffness=factor * state.column_stiffness,
            d_column_stiffness=slopes(state.column_stiffness, state.d_column_stiffness),
        )

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_mass", place

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f'all stories of "{place.state}" are {off_by(values[0], std[0], "stiffer", "softer")}'


class Bracing(Effect):
    """A part beta of every story's stiffness is braces, which turn no joint.

    Joints that turn soften the columns alone, and a story that changes in one state changes its braces first
    (story_change). Chord drift and a base that turns act on columns and braces alike: a brace pulls at the columns
    that it ends at. So it shows only beside effects that turn joints, and in no frame whose beams are rigid.

    Expected: any share is as probable; of frames of several stories one in thirty is braced, and nobody said so.
    """

    name = "bracing"
    summary = "Braces carry a part of every story's shear, which joints that turn do not soften."
    formula = "K = T diag(beta k) T' + frame of the columns (1 - beta) k with joints that turn"
    source = "diagonals hinged at both ends, which resist the drift of their story alone"
    stage = "bracing"
    parameters = (Parameter("beta", "", lower=0.0, upper=0.99),)
    probability = 0.03

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        beta = values[0]
        columns, d_columns = state.column_stiffness, (1.0 - beta) * state.d_column_stiffness
        brace, d_brace = state.brace_stiffness + beta * columns, beta * state.d_column_stiffness
        d_columns[own] -= columns
        d_brace[own] += columns
        return state.having(
            column_stiffness=(1.0 - beta) * columns,
            d_column_stiffness=d_columns,
            brace_stiffness=brace,
            d_brace_stiffness=state.d_brace_stiffness + d_brace,
        )

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f"braces make up {in_percent(values[0], std[0])} of the stiffness of every story"
