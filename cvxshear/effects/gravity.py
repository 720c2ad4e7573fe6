"""The weight above a story reduces its sway stiffness (P-delta)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import transformation
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class Gravity(Effect):
    """K - gamma T diag(P_i / h_i) T', with P_i the weight of all mass at and above floor i.

    gamma is 1 for columns that stay straight (a string of rigid links: P/h a story) and 6/5 for columns
    clamped at both ends that bend (the consistent geometric stiffness of a cubic: 6 P / 5 h).

    Weight always acts; whether the stiffness of a test is the one without it, so that it shows, is a matter of what
    was declared (weights that changed between tests): even odds. Any gamma of the interval is as probable.
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
    probability = 0.5

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

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            f"the weight above takes {with_std(values[0], std[0])} times P/h from every story's stiffness (gravity; "
            "1 for columns that stay straight, 1.2 for columns clamped at both ends)"
        )

    def known_anyway(self, experiment: Experiment, floor_mass: Floats, story_stiffness: Floats) -> str:
        """How much of a story's stiffness the weight above takes, where heights are declared."""
        heights = experiment.frame.story_heights
        if heights is None:
            return ""
        shares = []
        for each in experiment.tested:
            load = experiment.frame.gravity * np.cumsum((floor_mass + each.added_mass)[::-1])[::-1] / heights
            shares.append(float(np.max(load / (story_stiffness + load))))
        return (
            f"the weight above takes up to {100 * max(shares):.2g} % of a story's stiffness (P/h, up to 6/5 of it for "
            "columns that bend); the stiffnesses given are what is left"
        )
