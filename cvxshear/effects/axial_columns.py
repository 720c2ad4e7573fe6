"""Columns that stretch and shorten: the frame bends as a cantilever (chord drift)."""

from __future__ import annotations

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.effects.flexibility import add_flexibility
from cvxshear.typing import Floats


class AxialColumns(Effect):
    """Flexibility + z_i^2 (3 z_j - z_i) / (6 EI) for z_i <= z_j: a cantilever of uniform EI."""

    name = "axial_columns"
    summary = (
        "The columns stretch on one side and shorten on the other, so that the whole frame bends like a cantilever."
    )
    formula = "flexibility + z_i^2 (3 z_j - z_i) / (6 EI),  z_i <= z_j"
    source = "deflection of a cantilever under a point load, Bernoulli beam theory"
    stage = "flexibility"
    parameters = (Parameter("inverse_EI", "1/(N m2)", lower=0.0),)
    needs = ("heights",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        z = state.elevations
        low, high = np.minimum.outer(z, z), np.maximum.outer(z, z)
        return add_flexibility(state, values[0], low**2 * (3 * high - low) / 6, own)
