r"""Compute the exact minimizer near an answer, and a bound on the error of each of its unknowns.

A program with its active inequalities as equalities has a closed form. If no other inequality is violated there, and
no multiplier has the wrong sign, it is the minimizer of the whole program. The active set is guessed from the answer
and corrected by the primal-dual active-set method (Hintermüller, Ito and Kunisch 2003): inequalities with a negative
multiplier leave the set, violated ones enter it.

With B x = c the active constraints, Z a basis of the null space of B, H = Z (RZ)^+ and P = (I - H R) B^+, an error
f in the rows' residual, g in its product with R' and d in the constraints change the minimizer to first order by

.. math:: \delta x = H f + Z (Z'R'RZ)^{-1} Z' g + P d

(Björck 1991). In 64 bits |f| <= u (|R| |x| + |s|), |g| <= u |R|' |Rx - s| and |d| <= u (|B| |x| + |c|) entry by entry,
with u = 4 sqrt(m) eps for a sum of m terms: rounding errors have either sign (Higham and Mary 2019). So the bound on
each unknown is the sum of the absolute values of the three matrices times these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from cvxshear.backends.canonical import LAPACK_BLOCK, RANK_TOLERANCE, independent_rows
from cvxshear.programs.certificate import Assembled, Point, length
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats, Ints

#: Number of corrections of the answer by the closed form. The second one corrects the rounding of the first, so that
#: constraints hold to the last digits of their terms.
CORRECTIONS = 2

#: Largest ratio of the longest to the shortest row without sorting of rows and pivoting of columns. These keep the
#: rounding of heavy rows out of light ones (Cox and Higham 1998). Without them, 12 of 274 answers to programs with
#: units from 1e-9 to 1e9 are outside their bounds (`python -m tests.studies hard_programs 216 11`).
GRADED = 1e3

#: Distance of 1 to the next floating-point number.
EPSILON = float(np.finfo(float).eps)

#: Rounding of a sum, relative to the sizes of its terms.
SUM_ROUNDING = 100 * EPSILON


@dataclass(frozen=True, eq=False)
class Minimizer:
    """The minimizer of a program, or of the program with some inequalities as equalities.

    Parameters
    ----------
    point : Point
    errors : ndarray, shape (n,)
        Bound on the error of each unknown, from rounding in 64 bits.
    deviations : ndarray, shape (n,)
        Standard deviation of each unknown if the rows' residual is noise: (diag Z (Z'R'RZ)^-1 Z')^(1/2) times the
        root mean square of the residual.
    """

    point: Point
    errors: Floats
    deviations: Floats


@dataclass(frozen=True, eq=False)
class _Local:
    """Sensitivity of a minimizer on some active constraints, with the columns of R scaled to unit length.

    Parameters
    ----------
    basis : _Basis
        Basis of the range of the active constraints and of their null space.
    directions : ndarray, shape (n, k)
        Basis of the null space of the active constraints, its columns of orthonormal effect on the rows.
    particular : ndarray, shape (n, p)
        P: motion of the minimizer with the right side of each independent active constraint, as a row of unit length.
    deviation : float
        Root mean square of the residual.
    independent : ndarray of int, shape (p,)
        Places of these constraints among the active ones, equalities first.
    multiplier_errors : ndarray, shape (p,)
        Bounds on the errors of their multipliers.
    """

    basis: _Basis
    directions: Floats
    particular: Floats
    deviation: float
    independent: Ints
    multiplier_errors: Floats


class UndeterminedError(Exception):
    """The rows and the active constraints leave a direction open."""


class UnsettledError(Exception):
    """The inequalities that hold the minimizer could not be found."""


def minimizer(program: Assembled, near: Point, most_sets: int = 10) -> Minimizer:
    """Find the minimizer of a program, close to an answer.

    Parameters
    ----------
    program : Assembled
    near : Point
    most_sets : int, optional
        Largest number of active sets that are tried; a good guess needs one or two.

    Raises
    ------
    UndeterminedError
    UnsettledError
    """
    if not len(program.h):
        return _minimizer_on(program, near.x, np.zeros(0, dtype=bool))[0]
    active = program.held(near)
    for _ in range(most_sets):
        found, local = _minimizer_on(program, near.x, active)
        satisfied = _satisfied(program, found)
        following = np.where(active, found.point.w >= -_multiplier_errors(program, local, active), ~satisfied)
        if np.array_equal(following, active):
            # If some active inequalities follow from others, a contradicting inequality is violated.
            if np.all(satisfied):
                return _doubted(program, found, local, active)
            break
        active = following
    raise UnsettledError


def _multiplier_errors(program: Assembled, local: _Local, active: Bools) -> Floats:
    """Bound the error of each inequality's multiplier; zero for an inactive or dependent inequality."""
    among = np.zeros(len(program.b) + int(active.sum()))
    among[local.independent] = local.multiplier_errors
    errors = np.zeros(len(active))
    errors[active] = among[len(program.b) :] / program.inequality_lengths[active]
    return errors


def _doubted(program: Assembled, found: Minimizer, local: _Local, active: Bools) -> Minimizer:
    """Enlarge a minimizer's bounds if rounding prevents the decision whether an inequality is active.

    If an inequality is active but was assumed inactive, the minimizer moves by Z (Z'R'RZ)^-1 Z'a v / (a'Z ... Z'a),
    with v the violation that cannot be excluded; if one is inactive but was assumed active, by P t / |R P|^2, with -t
    the multiplier that cannot be excluded. Without this, 36 of 537 answers to programs with degenerate constraints and
    to the last step of an iteration are outside their bounds (`python -m tests.studies hard_programs 216 11`).
    """
    lengths, x = program.lengths, found.point.x
    errors, variances = found.errors * lengths, (found.deviations * lengths) ** 2
    G, absolute_G = program.G, program.absolute[1]
    doubt = G @ x - program.h + absolute_G @ found.errors + SUM_ROUNDING * (np.abs(program.h) + absolute_G @ np.abs(x))
    for i in np.flatnonzero(~active & (doubt > 0)):
        row = G[i] / lengths
        # An inequality that follows from the active ones changes nothing.
        if np.linalg.norm(local.basis.on_null_space(row[None])) > RANK_TOLERANCE * program.inequality_lengths[i]:
            gradient = local.directions.T @ row
            errors = errors + np.abs(local.directions @ gradient) * doubt[i] / float(gradient @ gradient)
    weights = found.point.w[active] * program.inequality_lengths[active]
    for column, place in enumerate(local.independent):
        if place < len(program.b):
            continue
        t = local.multiplier_errors[column] - weights[place - len(program.b)]
        if t > 0:
            motion = local.particular[:, column]
            curvature = float(np.sum((program.scaled_rows @ motion) ** 2))
            errors = errors + np.abs(motion) * (t / curvature if curvature > 0 else np.inf)
            variances = variances + motion**2 * (local.deviation**2 / curvature if curvature > 0 else 0.0)
    return Minimizer(found.point, errors / lengths, np.sqrt(variances) / lengths)


def _satisfied(program: Assembled, found: Minimizer) -> Bools:
    """Find the inequalities that hold at a minimizer within rounding."""
    x, absolute_G = found.point.x, program.absolute[1]
    rounding = found.errors + SUM_ROUNDING * (np.abs(x) + length(program.lengths * x) / program.lengths)
    return np.asarray(program.G @ x - program.h <= SUM_ROUNDING * np.abs(program.h) + absolute_G @ rounding)


def _minimizer_on(program: Assembled, x: Floats, active: Bools) -> tuple[Minimizer, _Local]:
    """Minimize with the active inequalities as equalities, by the null-space method, as corrections of x.

    LAPACK's xGGLSE does the same but does not return the null-space basis, which the error bound needs.
    """
    rows, sides = np.concatenate([program.A, program.G[active]]), np.concatenate([program.b, program.h[active]])
    lengths = program.row_lengths(rows)
    B = rows / program.lengths / lengths[:, None]
    keep = independent_rows(B)
    basis = _Basis(B[keep])
    scaled = program.scaled_rows
    factor = _Factor(basis.on_null_space(scaled))
    for _ in range(CORRECTIONS):
        across = basis.onto(((sides - rows @ x) / lengths)[keep])
        along = factor.solved((program.s - program.R @ x - scaled @ across)[:, None])
        correction = (across + basis.from_null_space(along)[:, 0]) / program.lengths
        x = x + correction
        if np.all(program.lengths * np.abs(correction) <= SUM_ROUNDING * np.abs(program.lengths * x)):
            break
    residual = program.s - program.R @ x
    multipliers = np.zeros(len(rows))
    if len(keep):
        multipliers[keep] = basis.multipliers(scaled.T @ residual)
    multipliers /= lengths
    w = np.zeros(len(program.h))
    w[active] = multipliers[len(program.b) :]

    r, n = program.R.shape
    directions = basis.from_null_space(factor.inverse)
    reach = np.sqrt(np.einsum("ij,ij->i", directions, directions))
    z = np.abs(program.lengths * x)
    terms = program.absolute_rows @ z + np.abs(program.s)
    f, g = _unit(n) * terms, _unit(r) * (program.absolute_rows.T @ np.abs(residual))
    errors = np.abs(directions @ (scaled @ directions).T) @ f + np.abs(directions @ directions.T) @ g
    particular, off = np.zeros((n, 0)), np.zeros(0)
    if len(basis.B):
        pseudoinverse = basis.onto(np.eye(len(basis.B)))
        particular = pseudoinverse - basis.from_null_space(factor.solved(scaled @ pseudoinverse))
        errors += np.abs(particular) @ (_unit(n) * (np.abs(basis.B) @ z + np.abs(sides / lengths)[keep]))
        off = np.abs(pseudoinverse).T @ (_unit(r) * (program.absolute_rows.T @ terms))
    deviation = length(residual) / math.sqrt(max(1, r - directions.shape[1]))
    local = _Local(basis, directions, particular, deviation, np.flatnonzero(keep), off)
    found = Minimizer(
        Point(x, multipliers[: len(program.b)], w),
        np.abs(correction) + errors / program.lengths,
        deviation * reach / program.lengths,
    )
    return found, local


def _unit(terms: int) -> float:
    """Bound the rounding of a sum of this number of terms, relative to the sum of their sizes."""
    return 4.0 * math.sqrt(max(terms, 1)) * EPSILON


class _Factor:
    """A QR factorization of rows of full column rank, for least squares.

    Parameters
    ----------
    rows : ndarray, shape (r, k)

    Raises
    ------
    UndeterminedError
        If the rows leave a direction undetermined.
    """

    def __init__(self, rows: Floats) -> None:
        r, self._k = rows.shape
        if r < self._k:
            raise UndeterminedError
        if not self._k:
            return
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        shortest = np.min(lengths, where=lengths > 0, initial=np.inf)
        graded = bool(np.max(lengths) > GRADED * shortest)
        if graded:
            self._order = np.argsort(-lengths, kind="stable")
            self._reflectors, pivots, self._tau, _, _ = lapack.dgeqp3(rows[self._order])
            self._pivots = pivots - 1
        else:
            self._order, self._pivots = np.arange(r), np.arange(self._k)
            self._reflectors, self._tau, _, _ = lapack.dgeqrf(rows, lwork=LAPACK_BLOCK * self._k)
        self._triangle = self._reflectors[: self._k]
        # In graded rows a small pivot may come from a light row. The error bound reveals a pivot that is only rounding.
        least = 0.0 if graded else RANK_TOLERANCE
        if np.any(np.diag(self._triangle) == 0.0) or not float(lapack.dtrcon(self._triangle)[0]) > least:
            raise UndeterminedError

    def solved(self, sides: Floats) -> Floats:
        """Minimize |rows u - side| for several right sides, shape (r, q); the minimizers u have shape (k, q)."""
        u = np.zeros((self._k, sides.shape[1]))
        if u.size:
            work = max(1, LAPACK_BLOCK * len(sides))
            rotated, _, _ = lapack.dormqr("L", "T", self._reflectors, self._tau, sides[self._order], work)
            u[self._pivots] = lapack.dtrtrs(self._triangle, rotated[: self._k])[0]
        return u

    @cached_property
    def inverse(self) -> Floats:
        """Columns that the rows make orthonormal, shape (k, k): the inverse of the triangle."""
        inverse = np.zeros((self._k, self._k))
        if self._k:
            inverse[self._pivots] = np.triu(lapack.dtrtri(self._triangle)[0])
        return inverse


class _Basis:
    """The range of B' and its complement, the null space of B, stored as the reflections of a QR factorization.

    Parameters
    ----------
    B : ndarray, shape (p, n)
        Independent rows.
    """

    def __init__(self, B: Floats) -> None:
        self.B = B
        self._p, self._n = B.shape
        if self._p:
            self._reflectors, self._tau, _, _ = lapack.dgeqrf(B.T, lwork=LAPACK_BLOCK * self._p)

    def _applied(self, side: str, trans: str, matrix: Floats) -> Floats:
        if not self._p or not matrix.size:
            return matrix
        work = max(1, LAPACK_BLOCK * max(matrix.shape))
        result, _, _ = lapack.dormqr(side, trans, self._reflectors, self._tau, matrix, work)
        return np.asarray(result)

    def on_null_space(self, matrix: Floats) -> Floats:
        """matrix @ Z."""
        return self._applied("R", "N", matrix)[:, self._p :]

    def from_null_space(self, coordinates: Floats) -> Floats:
        """Z @ coordinates."""
        return self._applied("L", "N", np.concatenate([np.zeros((self._p, coordinates.shape[1])), coordinates]))

    def onto(self, c: Floats) -> Floats:
        """Find the shortest vectors with B v = c, for one right side of shape (p,) or several of shape (p, q)."""
        if not self._p:
            return np.zeros((self._n, *c.shape[1:]))
        several = c.reshape(self._p, -1)
        padded = np.zeros((self._n, several.shape[1]))
        padded[: self._p] = lapack.dtrtrs(self._reflectors[: self._p], several, trans=1)[0]
        return self._applied("L", "N", padded).reshape((self._n, *c.shape[1:]))

    def multipliers(self, pull: Floats) -> Floats:
        """Combine B's rows, one at least, to come closest to a vector, and return their coefficients."""
        t = self._applied("L", "T", pull[:, None])[: self._p, 0]
        return np.asarray(lapack.dtrtrs(self._reflectors[: self._p], t)[0])
