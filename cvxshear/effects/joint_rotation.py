"""Beams that are not rigid let the joints turn."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class JointRotation(Effect):
    """Columns that bend between joints that turn, the rotations condensed out.

    A story of stiffness k = 12 E I / h^3 and height h, with sway u and joint rotation theta at either end,
    has the stiffness of the Bernoulli beam, k [1, h/2; h^2/3, h^2/6 coupling]. The beams of each floor resist
    with r, N m/rad; the columns are clamped at the ground. eta = mean(k h^2) / r, zero for rigid beams: in a tall
    frame of equal stories under equal shears V every joint turns by V h / r, which adds V h^2 / r, eta times V / k, to
    the sway of each story. Only the ratios of the heights matter.

    Expected size 0.5: with beams as stiff as the columns, I_b / L = I_c / h, one bay has r = 12 E I_b / L and
    k h^2 = 24 E I_c / h, so eta = 2; frames tested as shear frames have beams several times stiffer (Chopra, Dynamics
    of Structures, on the beam-to-column stiffness ratio).
    """

    name = "joint_rotation"
    summary = "The beams bend, so that the joints turn and each story is softer than columns clamped at both ends."
    formula = (
        "story element k [[1, h/2], [h/2, h^2/3]] with coupling h^2/6, plus r = mean(k h^2) / eta a floor, "
        "rotations condensed"
    )
    source = (
        "Bernoulli beam element, Przemieniecki, Theory of Matrix Structural Analysis; static condensation, Guyan 1965"
    )
    stage = "joint"
    parameters = (Parameter("eta", "", lower=0.0, upper=100.0, null=0.0, start=0.05),)
    uses_heights = True

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.5])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            "the beams bend and the joints turn, which adds "
            f"{in_percent(values[0], std[0])} to the sway of a story among equal ones (eta = {values[0]:.2g})"
        )

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        softer, d_softer = state.joint_flexibility.copy(), state.d_joint_flexibility.copy()
        unit, d_unit = state.usual_flexibility()
        softer[1:] += values[0] * unit
        d_softer[:, 1:] += values[0] * d_unit[:, None]
        d_softer[own, 1:] += unit
        return dataclasses.replace(state, joint_flexibility=softer, d_joint_flexibility=d_softer)
