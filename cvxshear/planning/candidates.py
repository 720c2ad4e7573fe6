"""Candidates of a plan: information that sensors and tests add to the prior of a frame.

The information of the parameters is a sum over the chosen candidates,

    M(w) = M_0 + sum over j of w_j G_j,   G_j = J_j' J_j,

with w_j = 1 for a chosen candidate. The scale of every measured shape is unknown. Eliminating the scale from each shape
would spoil the sum, so the scale is a parameter here, and the criteria use the covariance with the other parameters
marginalized. If the design values are uncertain, every matrix has a version for each of several allowed frames, and a
criterion is an average over these frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

KNOWN_EXACTLY = 1e-12
"""Largest length of a row of the question, with each parameter relative to its size, for an exactly known parameter."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Prior information and the information of each candidate, in well-scaled coordinates.

    The goal's parameters are x = F z_a; z_a are the first of these coordinates z. The information of all
    candidates with equal weights is the identity.

    Parameters
    ----------
    base : ndarray, shape (q, p, p)
        Information without any candidate, for each of q frames.
    rows : ndarray, shape (q, n, d, p)
        J_j of each candidate.
    asked : ndarray, shape (q, s, a)
        F.
    """

    base: Floats
    rows: Floats
    asked: Floats

    @staticmethod
    def averaged(frames: Sequence[Candidates]) -> Candidates:
        """Return the candidates on several frames; a criterion is an average over these frames."""
        parts = [[each.base for each in frames], [each.rows for each in frames], [each.asked for each in frames]]
        return Candidates(*map(np.concatenate, parts))

    @cached_property
    def added(self) -> Floats:
        """Information that each candidate adds, G_j, shape (q, n, p, p)."""
        return self.rows.swapaxes(2, 3) @ self.rows

    @cached_property
    def log_volume(self) -> Floats:
        """log det of the covariance of the goal's parameters if the covariance of z_a is the identity."""
        return np.asarray(np.sum(np.log(np.linalg.svd(self.asked, compute_uv=False) ** 2), axis=-1))

    @property
    def count(self) -> int:
        """Number of candidates."""
        return int(self.rows.shape[1])

    def information(self, weights: Floats) -> Floats:
        """Compute M(w), shape (..., q, p, p), for weights w of shape (..., n)."""
        return np.asarray(self.base + np.tensordot(weights, self.added, axes=(-1, 1)))

    def subset(self, chosen: Ints | list[int]) -> Floats:
        """Return the information of the chosen candidates, shape (q, p, p)."""
        return np.asarray(self.base + self.added[:, chosen].sum(axis=1))

    def own(self, information: Floats) -> Floats:
        """Compute the covariance of z_a with all others marginalized, shape (..., q, a, a)."""
        a = self.asked.shape[-1]
        return np.asarray(np.linalg.inv(information), dtype=np.float64)[..., :a, :a]

    def own_with_each(self, chosen: Ints | list[int], others: Ints | list[int]) -> Floats:
        """Compute the covariance of z_a with the chosen candidates and each one of the others, shape (k, q, a, a).

        C - C J' (1 + J C J')^-1 J C needs only one inverse for all of them.
        """
        a = self.asked.shape[-1]
        covariance = np.linalg.inv(self.subset(chosen))
        J = self.rows[:, others]
        seen = J @ covariance[:, None]
        inner = np.eye(J.shape[2]) + seen @ J.swapaxes(2, 3)
        columns = seen[..., :a]
        result: Floats = covariance[:, None, :a, :a] - columns.swapaxes(2, 3) @ np.linalg.solve(inner, columns)
        return result.swapaxes(0, 1)

    def covariance(self, own: Floats) -> Floats:
        """Compute the covariance of the goal's parameters, (..., s, s), from the covariances of z_a, as a mean."""
        return np.asarray(np.mean(self.asked @ own @ self.asked.swapaxes(1, 2), axis=-3))

    def slopes(self, information: Floats, weight: Floats) -> Floats:
        """Differentiate the frames' mean of tr(weight C_aa) by the weights, shape (n,); C is the whole covariance.

        The derivative for one frame is -tr(weight C_a. G_j C_.a).

        Parameters
        ----------
        information : ndarray, shape (q, p, p)
        weight : ndarray, shape (q, a, a)
        """
        a = self.asked.shape[-1]
        columns = np.linalg.inv(information)[..., :a]
        spread = columns @ weight @ columns.swapaxes(1, 2)
        return np.asarray(-np.tensordot(self.added, spread, axes=([0, 2, 3], [0, 1, 2])) / len(spread))


def candidates(known: Floats, fixed: Floats, rows: Floats, question: Floats, weight: float) -> Candidates:
    """Build the candidates on one frame in well-scaled coordinates.

    Parameters
    ----------
    known : ndarray, shape (k, p)
        Rows of the prior information, in standard deviations: K'K is its information.
    fixed : ndarray, shape (e, p)
        Rows whose product with every allowed change is zero: exact knowledge.
    rows : ndarray, shape (n, d, p)
        Derivatives of each candidate's data in standard deviations.
    question : ndarray, shape (s, p)
        Rows that compute the goal's parameters from all p parameters.
    weight : float
        Weight of every candidate in the coordinates' scaling: this information becomes the identity.

    Raises
    ------
    InputError
        If the goal's parameters are all known exactly.
    """
    free = free_changes(fixed)
    left, sizes, right = np.linalg.svd(question @ free)
    rank = int(np.sum(sizes > KNOWN_EXACTLY * max(1.0, sizes[0] if len(sizes) else 1.0)))
    if not rank or sizes[0] <= KNOWN_EXACTLY:
        raise InputError("what the plan is for is known exactly already; plan for something that is not")
    basis = free @ right.T
    known, rows = known @ basis, rows @ basis
    scale = _lower(np.concatenate([known, np.sqrt(weight) * rows.reshape(-1, rows.shape[2])]))
    known, rows = known @ scale, rows @ scale
    asked = left[:, :rank] * sizes[:rank] @ scale[:rank, :rank]
    return Candidates((known.T @ known)[None], rows[None], asked[None])


def free_changes(fixed: Floats) -> Floats:
    """Find an orthonormal basis, shape (p, f), of the changes of p parameters with zero products with fixed rows."""
    return np.asarray(linalg.null_space(fixed, rcond=1e-12)) if len(fixed) else np.eye(fixed.shape[1])


def _lower(whole: Floats) -> Floats:
    """Find lower triangular L with (whole L)'(whole L) = 1: the first coordinates depend only on the first of z."""
    # QR of the columns in reverse order gives whole' whole = U U' with U upper triangular; L is U^-T.
    triangle = np.asarray(np.linalg.qr(whole[:, ::-1], mode="r"))
    upper = triangle.T[::-1, ::-1]
    return np.asarray(linalg.solve_triangular(upper, np.eye(len(upper))).T)
