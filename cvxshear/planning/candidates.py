"""What floors to measure and tests to make add to what is known of a frame: the candidates of a plan.

The information of the parameters is a sum over the candidates that are chosen,

    M(w) = M_0 + sum over j of w_j G_j,   G_j = J_j' J_j,

with w_j = 1 for what is chosen. The free scale of every measured shape would spoil the sum if it were eliminated from
each shape; it is a parameter of its own here, and what is asked is always a covariance with the others marginalised.
Where design values are vague every matrix is there once for each of several frames that they allow, and a criterion is
an average over these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.util.cached import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

KNOWN_EXACTLY = 1e-12
"""Length of a row of the question, each parameter in its own size, below which the parameter is known exactly."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """What is known and what each candidate would add, in coordinates in which it is well scaled.

    In these coordinates z the parameters asked for are x = F z_a, z_a the first of them, and the information of equal
    weights of all candidates is the identity.

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
        """Return the candidates on several frames, over which a criterion is an average."""
        parts = [[each.base for each in frames], [each.rows for each in frames], [each.asked for each in frames]]
        return Candidates(*map(np.concatenate, parts))

    @cached_property
    def added(self) -> Floats:
        """Information that each candidate adds, G_j, shape (q, n, p, p)."""
        return self.rows.swapaxes(2, 3) @ self.rows

    @cached_property
    def log_volume(self) -> Floats:
        """log det of the covariance of what is asked for where that of z_a is the identity, in its own directions."""
        return np.asarray(np.sum(np.log(np.linalg.svd(self.asked, compute_uv=False) ** 2), axis=-1))

    @property
    def count(self) -> int:
        """How many candidates there are."""
        return int(self.rows.shape[1])

    def information(self, weights: Floats) -> Floats:
        """M(w), shape (..., q, p, p), for weights w of shape (..., n)."""
        return np.asarray(self.base + np.tensordot(weights, self.added, axes=(-1, 1)))

    def subset(self, chosen: Ints | list[int]) -> Floats:
        """Return the information of the chosen candidates, shape (q, p, p)."""
        return np.asarray(self.base + self.added[:, chosen].sum(axis=1))

    def own(self, information: Floats) -> Floats:
        """Covariance of z_a with all others marginalised, shape (..., q, a, a)."""
        a = self.asked.shape[-1]
        return np.asarray(np.linalg.inv(information), dtype=np.float64)[..., :a, :a]

    def own_with_each(self, chosen: Ints | list[int], others: Ints | list[int]) -> Floats:
        """Covariance of z_a with the chosen candidates and one of the others, for each of these; shape (k, q, a, a).

        C - C J' (1 + J C J')^-1 J C: one inverse for all of them.
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
        """Covariance of the parameters asked for, shape (..., s, s), from that of z_a: the mean over the frames."""
        return np.asarray(np.mean(self.asked @ own @ self.asked.swapaxes(1, 2), axis=-3))

    def slopes(self, information: Floats, weight: Floats) -> Floats:
        """Differentiate by the weights the frames' mean tr(weight C_aa), C the whole covariance, shape (n,).

        Of one frame -tr(weight C_a. G_j C_.a).

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
    """Candidates on one frame in coordinates in which they are well scaled.

    Parameters
    ----------
    known : ndarray, shape (k, p)
        Rows of what is known without any candidate, in standard deviations: K'K is its information.
    fixed : ndarray, shape (e, p)
        Rows on which every change is zero: what is known exactly.
    rows : ndarray, shape (n, d, p)
        For each candidate its data's derivatives in standard deviations.
    question : ndarray, shape (s, p)
        Rows that make the parameters asked for of all p.
    weight : float
        That every candidate has in the information that is the identity.

    Raises
    ------
    InputError
        Where all that is asked for is known exactly.
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
    """Orthonormal columns, shape (p, f), that span the changes of p parameters on which fixed rows (e, p) are zero."""
    return np.asarray(linalg.null_space(fixed, rcond=1e-12)) if len(fixed) else np.eye(fixed.shape[1])


def _lower(whole: Floats) -> Floats:
    """Find lower triangular L with (whole L)'(whole L) = 1: the first coordinates depend on the first of z alone."""
    # QR of the columns in reverse order gives whole' whole = U U' with U upper triangular; L is U^-T.
    triangle = np.asarray(np.linalg.qr(whole[:, ::-1], mode="r"))
    upper = triangle.T[::-1, ::-1]
    return np.asarray(linalg.solve_triangular(upper, np.eye(len(upper))).T)
