"""Columns that stretch and shorten: the frame bends as a whole (chord drift)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.util.quantities import per_force
from cvxshear.util.typing import Floats


class AxialColumns(Effect):
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
    stage = "flexibility"
    parameters = (Parameter("inverse_EI", "1/(N m2)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.03
    uses_heights = True

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_flexibility(values[0], chord_drift(state.heights), own)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.sway / chord_drift(scale.heights)[-1, -1]])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        share = values[0] * chord_drift(scale.heights)[-1, -1] / scale.sway
        return (
            f"the columns stretch and shorten, which adds {100 * share:.2g} % to the sway of the top under a force "
            f"there (1/EI = {per_force(values[0], std[0], units[0])})"
        )


def chord_drift(heights: Floats) -> Floats:
    """D for EI = 1, shape (N, N)."""
    z = np.cumsum(heights)
    moment = np.maximum(z[:, None] - (z - 0.5 * heights), 0.0)
    D: Floats = (moment * heights) @ moment.T
    return D
