"""The exact minimizer beside an answer: which inequalities hold it, and how far it is away.

On the inequalities that are active a program has a closed form. Where no other inequality is violated there, and no
multiplier has the wrong sign, it is the minimizer of the whole program. Which ones are active is guessed from the
answer and corrected as the primal-dual active-set method does (Hintermüller, Ito and Kunisch 2003): those of a
negative multiplier leave, those violated enter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from cvxshear.backends.certificate import Assembled, Point
from cvxshear.backends.independence import independent_rows
from cvxshear.util.typing import Bools, Floats

ROUNDS = 10
"""Sets of inequalities that are tried; a guess that is nearly right needs one or two."""

UNDETERMINED = 1e-13
"""Reciprocal condition number of the rows on the null space of the active constraints, below which they leave a
direction open."""

ROUNDING = 100 * float(np.finfo(float).eps)
"""Of a sum, relative to the sizes of its terms."""


@dataclass(frozen=True, eq=False)
class Minimizer:
    """The minimizer of a program, or of what is left of it once some inequalities are equalities.

    Parameters
    ----------
    point : Point
    rounding : ndarray, shape (n,)
        How far the unknowns may be off in 64 bits.
    """

    point: Point
    rounding: Floats


class UndeterminedError(Exception):
    """The rows and the active constraints leave a direction open."""


class UnsettledError(Exception):
    """The inequalities that hold the minimizer could not be found."""


def minimizer(of: Assembled, near: Point) -> Minimizer:
    """The minimizer of a program close to an answer.

    Parameters
    ----------
    of : Assembled
    near : Point

    Raises
    ------
    UndeterminedError
    UnsettledError
    """
    if not len(of.h):
        return _held(of, near.x, np.zeros(0, dtype=bool))
    active = _guessed(of, near)
    for _ in range(ROUNDS):
        found = _held(of, near.x, active)
        keeps = _kept(of, found)
        pulls = found.point.w >= -ROUNDING * of.magnitude(found.point.x) / of.inequality_lengths
        following = np.where(active, pulls, ~keeps)
        if np.array_equal(following, active):
            # Where active inequalities follow from others, one that contradicts them is not kept.
            if np.all(keeps):
                return found
            break
        active = following
    raise UnsettledError


def _guessed(of: Assembled, near: Point) -> Bools:
    """The inequalities whose multiplier is greater than their slack, both made free of units."""
    lengths = of.inequality_lengths
    active: Bools = near.w * lengths > np.maximum(of.h - of.G @ near.x, 0.0) / lengths
    return active


def _kept(of: Assembled, found: Minimizer) -> Bools:
    """Which inequalities a minimizer keeps, but for rounding."""
    x, absolute_G = found.point.x, of.absolute[1]
    rounding = found.rounding + ROUNDING * (np.abs(x) + np.linalg.norm(of.lengths * x) / of.lengths)
    tolerance = ROUNDING * np.abs(of.h) + absolute_G @ rounding
    kept: Bools = of.G @ x - of.h <= tolerance
    return kept


def _held(of: Assembled, x: Floats, active: Bools) -> Minimizer:
    """The minimizer with the active inequalities as equalities, by the null-space method, as a correction of x.

    LAPACK's xGGLSE does the same and keeps the null-space basis to itself, which the rounding is got from.
    """
    rows, sides = np.concatenate([of.A, of.G[active]]), np.concatenate([of.b, of.h[active]])
    lengths = of.row_lengths(rows)
    B, c = rows / of.lengths / lengths[:, None], (sides - rows @ x) / lengths
    keep = independent_rows(B)
    basis = _Basis(B[keep])
    across = basis.onto(c[keep])
    scaled = of.R / of.lengths
    along, inverse = _least_squares(basis.on_null_space(scaled), of.s - of.R @ x - scaled @ across)
    found = x + (across + basis.from_null_space(along[:, None])[:, 0]) / of.lengths
    multipliers = np.zeros(len(rows))
    multipliers[keep] = basis.multipliers(of.R.T @ (of.s - of.R @ found) / of.lengths)
    multipliers /= lengths
    w = np.zeros(len(of.h))
    w[active] = multipliers[len(of.b) :]
    reach = np.linalg.norm(basis.from_null_space(inverse), axis=1) / of.lengths
    return Minimizer(Point(found, multipliers[: len(of.b)], w), _rounding(of, found, reach, inverse))


def _rounding(of: Assembled, x: Floats, reach: Floats, inverse: Floats) -> Floats:
    """How far rounding takes a least-squares answer to first order (Higham 2002, section 20.1).

    Of n errors in a row, of either sign, a few times sqrt(n) are left.
    """
    relative = 4.0 * np.sqrt(max(len(x), 1)) * float(np.finfo(float).eps)
    residual = float(np.linalg.norm(of.R @ x - of.s))
    return np.asarray(relative * reach * (of.magnitude(x) + float(np.linalg.norm(inverse)) * residual))


def _least_squares(rows: Floats, sides: Floats) -> tuple[Floats, Floats]:
    """The minimizer of |rows u - sides|, and the inverse of the triangle that the rows are factorized into."""
    n = rows.shape[1]
    if not n:
        return np.zeros(0), np.zeros((0, 0))
    triangle = np.asarray(np.linalg.qr(np.column_stack([rows, sides]), mode="r"))[:n]
    U, q = triangle[:, :n], triangle[:, n]
    if len(U) < n or not float(lapack.dtrcon(U)[0]) > UNDETERMINED:
        raise UndeterminedError
    inverse, _ = lapack.dtrtri(U)
    return lapack.dtrtrs(U, q)[0], inverse


class _Basis:
    """The range of B' and its complement, the null space of B, kept as the reflections of a QR factorization.

    Parameters
    ----------
    B : ndarray, shape (p, n)
        Independent rows.
    """

    def __init__(self, B: Floats) -> None:
        self._p, self._n = B.shape
        if self._p:
            self._reflectors, self._tau, _, _ = lapack.dgeqrf(B.T)

    def _applied(self, side: str, trans: str, matrix: Floats) -> Floats:
        if not self._p:
            return matrix
        work = max(1, 64 * max(matrix.shape))
        result, _, _ = lapack.dormqr(side, trans, self._reflectors, self._tau, matrix, work)
        return np.asarray(result)

    def on_null_space(self, matrix: Floats) -> Floats:
        """matrix @ Z."""
        return self._applied("R", "N", matrix)[:, self._p :]

    def from_null_space(self, coordinates: Floats) -> Floats:
        """Z @ coordinates."""
        return self._applied("L", "N", np.concatenate([np.zeros((self._p, coordinates.shape[1])), coordinates]))

    def onto(self, c: Floats) -> Floats:
        """The shortest vector with B v = c."""
        if not self._p:
            return np.zeros(self._n)
        t = lapack.dtrtrs(self._reflectors[: self._p], c, trans=1)[0]
        padded = np.concatenate([t, np.zeros(self._n - self._p)])[:, None]
        return self._applied("L", "N", padded)[:, 0]

    def multipliers(self, pull: Floats) -> Floats:
        """The coefficients of B's rows that come closest to a vector."""
        if not self._p:
            return np.zeros(0)
        t = self._applied("L", "T", pull[:, None])[: self._p, 0]
        return np.asarray(lapack.dtrtrs(self._reflectors[: self._p], t)[0])
