"""A foundation that turns: the whole frame rocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.util.quantities import per_force
from cvxshear.util.typing import Floats


class BaseRocking(Effect):
    """Flexibility + z z' / k_theta.

    Heights that nobody declared are taken as equal; then 1/k_theta counts lengths in stories.

    Expected size: 15 % of the sway of the top under a force there, the order at which soil and base plates soften
    the first mode of frames by a few percent (Stewart, Fenves and Seed 1999); with frames bolted to a floor or a table
    it is seldom seen: 5 %.
    """

    name = "base_rocking"
    summary = (
        "The base turns under the overturning moment, so that the whole frame rocks as a rigid body on top of its sway."
    )
    formula = "flexibility + z z' / k_theta"
    source = "rigid-body rotation about the base against a rotational spring"
    stage = "flexibility"
    parameters = (Parameter("inverse_k_theta", "rad/(N m)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.05
    uses_heights = True

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        z = state.elevations
        return state.with_flexibility(values[0], np.outer(z, z), own)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.sway / scale.elevations[-1] ** 2])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        share = values[0] * scale.elevations[-1] ** 2 / scale.sway
        return (
            f"the base turns, which adds {100 * share:.2g} % to the sway of the top under a force there "
            f"(1/k_theta = {per_force(values[0], std[0], units[0])})"
        )
