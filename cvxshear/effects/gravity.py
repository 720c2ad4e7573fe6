"""The weight above a story reduces its sway stiffness (P-delta)."""

from __future__ import annotations

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, State
from cvxshear.frame import transformation
from cvxshear.typing import Floats


class Gravity(Effect):
    """K - gamma T diag(P_i / h_i) T', with P_i the weight of all mass at and above floor i.

    gamma is 1 for columns that stay straight (a string of rigid links: P/h a story) and 6/5 for columns
    clamped at both ends that bend (the consistent geometric stiffness of a cubic: 6 P / 5 h).
    """

    name = "gravity"
    summary = (
        "The weight above each story pulls the leaning frame further over and so reduces its sway stiffness (P-delta)."
    )
    formula = "K - gamma T diag(P_i / h_i) T',  P_i = g (mass at and above floor i)"
    source = (
        "Clough and Penzien, Dynamics of Structures, geometric stiffness: linear (1) and consistent cubic (6/5) shape"
    )
    stage = "gravity"
    parameters = (Parameter("gamma", "", lower=1.0, upper=1.2, null=0.0, start=1.1),)
    needs = ("heights",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        gamma = values[0]
        system = state.system
        T = transformation(len(state.heights))
        g = state.experiment.frame.gravity
        # Mass at and above each floor: row sums of M, added up from the top.
        load = g * np.cumsum(system.M.sum(axis=1)[::-1])[::-1]
        d_load = g * np.cumsum(system.dM.sum(axis=2)[:, ::-1], axis=1)[:, ::-1]
        unit = (T * (load / state.heights)) @ T.T
        dK = system.dK - gamma * ((T * (d_load / state.heights)[:, None, :]) @ T.T)
        dK[own] -= unit
        return state.with_stiffness(system.K - gamma * unit, dK)
