"""A mass that the declaration of one configuration misses."""

from __future__ import annotations

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.typing import Floats


class AddedMass(Effect):
    """M + mass e e' at one floor in one configuration; negative where more was declared than was there."""

    name = "added_mass"
    summary = "In one configuration a floor carries more or less mass than was declared."
    formula = "M + mass e_j e_j' in one configuration"
    source = "rigid mass at floor j"
    stage = "mass"
    parameters = (Parameter("mass", "kg"),)
    sits_at = ("floor", "configuration")
    needs = ("several configurations",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        at = place.floor - 1
        M, dM = state.system.M.copy(), state.system.dM.copy()
        M[at, at] += values[0]
        dM[own, at, at] += 1.0
        return state.with_mass(M, dM)
