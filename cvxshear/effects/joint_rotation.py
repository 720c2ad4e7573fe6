"""Beams that are not rigid let the joints turn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class JointRotation(Effect):
    """Columns that bend between joints that turn, the rotations condensed out.

    A story of stiffness k = 12 E I / h^3 and height h, with sway u and joint rotation theta at either end,
    has the stiffness of the Bernoulli beam, k [1, h/2; h^2/3, h^2/6 coupling]. The beams of each floor resist
    with r, N m/rad; the columns are clamped at the ground. eta = mean(k h^2) / r, zero for rigid beams. Only the
    ratios of the heights matter.

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
    stage = "elastic"
    parameters = (Parameter("eta", "", lower=0.0, upper=100.0, null=0.0, start=0.05),)
    uses_heights = True

    def sizes(self, of: Scale) -> Floats:
        return np.array([0.5])

    def phrase(self, place: Place, values: Floats, std: Floats, of: Scale, units: Sequence[str]) -> str:
        return f"joints that turn, beams not being rigid (eta = {with_std(values[0], std[0])})"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        eta = values[0]
        k, h = state.story_stiffness, state.heights
        stories = len(k)
        beam = float(np.mean(state.frame_stiffness * h**2))
        uu, ut, tt = _stories(tuple(h.tolist()))
        Kuu, Kut, Ktt = (np.einsum("i,iab->ab", k, unit) for unit in (uu, ut, tt))
        # With S = eta / beam the inverse of Ktt + I / S is S (1 + Ktt S)^-1, which stays finite for rigid beams.
        S = eta / beam
        inverse = np.linalg.inv(np.eye(stories) + S * Ktt)
        turn = S * inverse
        K = Kuu - Kut @ turn @ Kut.T
        # Condensation is a congruence with [1; -turn Kut'], so a derivative of the full matrix passes through it.
        down = -turn @ Kut.T
        bent = ut @ down
        each = uu + bent + bent.transpose(0, 2, 1) + down.T @ tt @ down
        dK = np.einsum("pi,iab->pab", state.d_story_stiffness, each)
        # d turn / dS = (1 + S Ktt)^-1 (1 + S Ktt)^-1, with which S itself depends on eta and on the stiffnesses.
        inner = inverse @ Kut.T
        by_S = -inner.T @ inner
        dK[own] += by_S / beam
        dK[stories : 2 * stories] += by_S * (-S / beam) * (h**2 / stories)[:, None, None]
        return state.with_stiffness(K, dK)


@lru_cache(maxsize=16)
def _stories(heights: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
    """The blocks of every story of unit stiffness, each of shape (N, N, N); they depend on nothing but the heights."""
    blocks = zip(*(_story(i, h, len(heights)) for i, h in enumerate(heights)), strict=True)
    uu, ut, tt = (np.array(block) for block in blocks)
    return uu, ut, tt


def _story(i: int, h: float, stories: int) -> tuple[Floats, Floats, Floats]:
    """Story i of unit stiffness: its blocks (u, u), (u, theta), (theta, theta), each of shape (N, N).

    theta > 0 turns the joint so that the column leans towards +u: the drift is resisted by
    u_i - u_(i-1) - h (theta_i + theta_(i-1)) / 2.
    """
    sway = np.zeros(stories)
    sway[i] = 1.0
    joints = np.zeros(stories)
    joints[i] = 1.0
    tt = np.zeros((stories, stories))
    tt[i, i] = h**2 / 3
    if i > 0:
        sway[i - 1] = -1.0
        joints[i - 1] = 1.0
        tt[i - 1, i - 1] = h**2 / 3
        tt[i, i - 1] = tt[i - 1, i] = h**2 / 6
    return np.outer(sway, sway), -0.5 * h * np.outer(sway, joints), tt
