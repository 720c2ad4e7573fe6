"""Changes of stories between states, and the braces' part of the stories."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent, off_by
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class StoryChange(Effect):
    """k_i (1 + change) in one state.

    If a part of the story's stiffness is braces, the braces change first. A loss reduces the braces until they are
    gone, a gain increases them up to twice their stiffness, and the columns take the rest. The parameter is always the
    share of the whole story's stiffness.

    Expected size 25 %: damage, a loosened joint or a repair is detectable from some percent, and a story with a loss of
    more than half no longer belongs to the same frame.
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
        Index of the story, counted from 0.
    change : float
    parameter : int
        Row of the derivatives by the change.
    """
    k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
    brace, d_brace = state.brace_stiffness.copy(), state.d_brace_stiffness.copy()
    gained, d_gained = change * k[at], change * dk[:, at]
    d_gained[parameter] += k[at]
    if abs(gained) > brace[at]:
        # The braces are gone, or have twice their stiffness; the columns take the rest.
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

    Springs to the ground and between floors, the base and the weight do not change. In a state with an unmeasured mass
    scale, heavier floors fit equally well; so does a clock that runs slow by half of e.

    Expected size 10 %: frequencies fall by 2 to 10 % with the amplitude of the motion, and by the same amount with
    temperature and cracking of the whole frame (Clinton et al. 2006 on the Millikan Library; Peeters and De Roeck 2001
    on a bridge); the stiffness falls by twice this amount. One in twenty frames that are tested in several states has
    this effect.
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

        # The columns' stiffness is the reference for beams and joints, which soften with the columns.
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
    """A part beta of every story's stiffness is braces, which do not rotate joints.

    Rotating joints soften the columns alone, and a story that changes in one state changes its braces first
    (story_change). Chord drift and base rotation act on columns and braces alike, because a brace pulls at the columns
    at its ends. So the effect is detectable only with effects that rotate joints, and not in a frame with rigid beams.

    Expected: a uniform prior of the share; one in thirty frames of several stories has undeclared braces.
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
