"""A frame that is softer or stiffer as a whole in one state than in the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


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
    granted = "that the stories of {state} did not all soften or stiffen by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        factor = 1.0 + values[0]

        def slopes(k: Floats, dk: Floats) -> Floats:
            moved: Floats = factor * dk
            moved[own] += k
            return moved

        # The columns' stiffness is what beams and joints are measured by: they soften with it.
        return dataclasses.replace(
            state,
            story_stiffness=factor * state.story_stiffness,
            d_story_stiffness=slopes(state.story_stiffness, state.d_story_stiffness),
            brace_stiffness=factor * state.brace_stiffness,
            d_brace_stiffness=slopes(state.brace_stiffness, state.d_brace_stiffness),
            column_stiffness=factor * state.column_stiffness,
            d_column_stiffness=slopes(state.column_stiffness, state.d_column_stiffness),
        )

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_mass", place

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        word = "stiffer" if values[0] > 0 else "softer"
        return f'all stories of "{place.state}" are {in_percent(values[0], std[0])} {word}'
