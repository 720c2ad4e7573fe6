"""A foundation that turns: the whole frame rocks."""

from __future__ import annotations

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.effects.flexibility import add_flexibility
from cvxshear.typing import Floats


class BaseRocking(Effect):
    """Flexibility + z z' / k_theta."""

    name = "base_rocking"
    summary = (
        "The base turns under the overturning moment, so that the whole frame rocks as a rigid body on top of its sway."
    )
    formula = "flexibility + z z' / k_theta"
    source = "rigid-body rotation about the base against a rotational spring"
    stage = "flexibility"
    parameters = (Parameter("inverse_k_theta", "rad/(N m)", lower=0.0),)
    needs = ("heights",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        z = state.elevations
        return add_flexibility(state, values[0], np.outer(z, z), own)
