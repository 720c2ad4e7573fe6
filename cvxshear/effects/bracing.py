"""Braces that carry a part of every story's shear."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class Bracing(Effect):
    """A part beta of every story's stiffness is braces, which turn no joint.

    Joints that turn soften the columns alone, and a story that changes in one state changes its braces first
    (story_change). Chord drift and a base that turns act on columns and braces alike: a brace pulls at the columns
    that it ends at. So it shows only beside effects that turn joints, and in no frame whose beams are rigid.

    Expected: any share is as probable; of frames of several stories one in thirty is braced, and nobody said so.
    """

    name = "bracing"
    summary = "Braces carry a part of every story's shear, which joints that turn do not soften."
    formula = "K = T diag(beta k) T' + frame of the columns (1 - beta) k with joints that turn"
    source = "diagonals hinged at both ends, which resist the drift of their story alone"
    stage = "bracing"
    parameters = (Parameter("beta", "", lower=0.0, upper=0.99),)
    probability = 0.03

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        beta = values[0]
        columns, d_columns = state.column_stiffness, (1.0 - beta) * state.d_column_stiffness
        brace, d_brace = state.brace_stiffness + beta * columns, beta * state.d_column_stiffness
        d_columns[own] -= columns
        d_brace[own] += columns
        return dataclasses.replace(
            state,
            column_stiffness=(1.0 - beta) * columns,
            d_column_stiffness=d_columns,
            brace_stiffness=brace,
            d_brace_stiffness=state.d_brace_stiffness + d_brace,
        )

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f"braces make up {in_percent(values[0], std[0])} of the stiffness of every story"
