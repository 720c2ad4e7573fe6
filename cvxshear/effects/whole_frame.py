"""Flexibility of the frame as a whole: the weight above, axial strain of columns, rotation of the base."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import transformation
from cvxshear.util.quantities import per_force, significant, with_std
from cvxshear.util.typing import Floats


class Gravity(Effect):
    """K - gamma T diag(P_i / h_i) T', with P_i the weight of all mass at and above floor i.

    gamma is 1 for columns that stay straight (a string of rigid links: P/h a story) and 6/5 for columns clamped at both
    ends that bend (the consistent geometric stiffness of a cubic: 6 P / 5 h).

    Weight always acts. The effect shows only if the stiffness of a test was declared without the weight (weights that
    changed between tests): even odds. The prior of gamma is uniform over the interval.
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
        """State the share of a story's stiffness that the weight above cancels, if heights are declared."""
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


class _Flexible(Effect):
    """Flexibility + p D of the frame as a whole.

    The expected size is 15 % of the sway of the top under a force there.

    Undeclared heights are assumed equal; the parameter then counts lengths in stories.
    """

    stage = "flexibility"
    uses_heights = True
    cause: ClassVar[str]
    constant: ClassVar[str]

    @abstractmethod
    def pattern(self, heights: Floats) -> Floats:
        """Return D for a parameter of 1, shape (N, N), from the story heights."""

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_flexibility(values[0], self.pattern(state.heights), own)

    def _of_the_sway(self, scale: Scale) -> float:
        """Return the increase of the top's sway under a force there by a parameter of 1, relative to this sway."""
        return float(self.pattern(scale.heights)[-1, -1] / scale.sway)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 / self._of_the_sway(scale)])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            f"{self.cause}, which adds {significant(100 * values[0] * self._of_the_sway(scale), 2)} % to the sway of "
            f"the top under a force there ({self.constant} = {per_force(values[0], std[0], units[0])})"
        )


class AxialColumns(_Flexible):
    """Flexibility + D / EI, with D_ij = sum over stories s of M_is M_js h_s.

    M_is = max(z_i - (elevation of story s's mid-height), 0) is the moment of a unit force on floor i in story s.
    Columns clamped at both ends have their inflection at mid-height. So their axial forces, and with them the curvature
    of the frame as a whole, are constant over a story. Undeclared heights are assumed equal; then 1/EI counts lengths
    in stories.

    Expected size: 15 % of the sway of the top under a force there; chord drift is a tenth of the drift of frames of
    some ten stories, and more of taller ones (Taranath, Structural Analysis and Design of Tall Buildings). Only few
    frames, tall and slender ones, show the effect: 3 %.
    """

    name = "axial_columns"
    summary = (
        "The columns stretch on one side and shorten on the other, so that the whole frame bends like a cantilever."
    )
    formula = "flexibility + sum over stories s of M_is M_js h_s / EI,  M_is = max(z_i - mid-height of story s, 0)"
    source = "principle of virtual forces, columns with their inflection at mid-height"
    parameters = (Parameter("inverse_EI", "1/(N m2)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.03
    cause = "the frame bends as a whole, by columns that stretch and shorten or a wall"
    constant = "1/EI"

    def pattern(self, heights: Floats) -> Floats:
        z = np.cumsum(heights)
        moment = np.maximum(z[:, None] - (z - 0.5 * heights), 0.0)
        D: Floats = (moment * heights) @ moment.T
        return D


class BaseRocking(_Flexible):
    """Flexibility + z z' / k_theta.

    Undeclared heights are assumed equal; then 1/k_theta counts lengths in stories.

    Expected size: 15 % of the sway of the top under a force there. Soil and base plates of this flexibility soften the
    first mode of frames by a few percent (Stewart, Fenves and Seed 1999); frames bolted to a floor or a table seldom
    show it: 5 %.
    """

    name = "base_rocking"
    summary = (
        "The base turns under the overturning moment, so that the whole frame rocks as a rigid body on top of its sway."
    )
    formula = "flexibility + z z' / k_theta"
    source = "rigid-body rotation about the base against a rotational spring"
    parameters = (Parameter("inverse_k_theta", "rad/(N m)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.05
    cause = "the base turns"
    constant = "1/k_theta"

    def pattern(self, heights: Floats) -> Floats:
        z = np.cumsum(heights)
        return np.outer(z, z)
