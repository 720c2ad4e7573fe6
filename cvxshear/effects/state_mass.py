"""A frame whose floors all weigh more or less in one state than in the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class StateMass(Effect):
    """Every floor mass of the frame times 1 + e in one state; declared added masses stay what they are.

    In a state whose mass scale nothing measured it cannot be told from softer stories.

    Expected size 10 %: of the 1.5 to 3 kN/m2 of live load in dwellings and offices (EN 1991-1-1) a part is there, on
    floors that weigh 5 to 10 kN/m2; between tests of a laboratory frame nobody changes all floors without writing it
    down, which leaves one frame in thirty.
    """

    name = "state_mass"
    summary = "All floors weigh more or less in one state by the same factor: live load, water, people."
    formula = "m_i (1 + e) for every floor i, in one state"
    source = "one factor on the floor masses"
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    sits_at = ("state",)
    needs = ("several states",)
    probability = 0.03
    granted = "that the floors of {state} did not all become heavier or lighter by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        at = np.arange(len(state.floor_mass))
        M, dM = state.system.M.copy(), state.system.dM.copy()
        M[at, at] += values[0] * state.floor_mass
        dM[at, at, at] += values[0]
        dM[own, at, at] += state.floor_mass
        return state.with_mass(M, dM)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_stiffness", place

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        word = "heavier" if values[0] > 0 else "lighter"
        return f'all floors of "{place.state}" are {in_percent(values[0], std[0])} {word}'
