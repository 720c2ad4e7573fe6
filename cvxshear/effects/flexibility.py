"""What makes a frame as a whole more flexible: columns that stretch, a base that turns."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.util.quantities import per_force, significant
from cvxshear.util.typing import Floats


class _Flexible(Effect):
    """Flexibility + p D of the frame as a whole.

    Its expected size is 15 % of the sway of the top under a force there.

    Heights that nobody declared are taken as equal; the parameter then counts lengths in stories.
    """

    stage = "flexibility"
    uses_heights = True
    cause: ClassVar[str]
    constant: ClassVar[str]

    @abstractmethod
    def pattern(self, heights: Floats) -> Floats:
        """D for a parameter of 1, shape (N, N), from the story heights."""

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_flexibility(values[0], self.pattern(state.heights), own)

    def _of_the_sway(self, scale: Scale) -> float:
        """Return what a parameter of 1 adds to the sway of the top under a force there, in parts of it."""
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

    M_is = max(z_i - (elevation of story s's mid-height), 0) is the moment that a unit force on floor i has in story s.
    Columns clamped at both ends have their inflection at mid-height, so their axial forces, and with them the
    curvature of the frame as a whole, are constant over a story. Heights that nobody declared are taken as equal;
    then 1/EI counts lengths in stories.

    Expected size: 15 % of the sway of the top under a force there; chord drift is a tenth of the drift of frames of
    some ten stories, and more of taller ones (Taranath, Structural Analysis and Design of Tall Buildings). It can be
    measured in few frames, tall and slender ones: 3 %.
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
    parameters = (Parameter("inverse_k_theta", "rad/(N m)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.05
    cause = "the base turns"
    constant = "1/k_theta"

    def pattern(self, heights: Floats) -> Floats:
        z = np.cumsum(heights)
        return np.outer(z, z)
