"""Scale a program for the solvers, and convert its answer back.

Masses are of order 1e4 kg, stiffnesses of order 1e7 N/m and rows of order 1e-2, so that the tolerances of solvers
have no meaning for the program itself. The equalities vanish at every feasible point and may be stacked below the
rows. With a QR factorization of the stacked rows,

    [W R; sigma A] = Q U,        z = U x / tau,

the objective becomes |z - q|^2 with q = Q' [W s; sigma b] / tau. Its Hessian is the identity without squaring, and
first-order methods converge as fast as the constraints allow. Rows of the constraints are scaled to unit length. tau
makes q and the right sides of the constraints of order one.

If the stacked rows do not determine x (only inequalities do), U is singular, and only the columns are scaled:
C = [W R; sigma A] D, z = D^-1 x / tau, objective |C z - q|^2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from cvxshear.programs import LeastSquares
from cvxshear.programs.certificate import MatrixInequality, Point
from cvxshear.util.errors import InfeasibleError
from cvxshear.util.typing import Bools, Floats

#: Rounding of unit vectors, a few thousand machine precisions: a row whose part outside the span of other rows is
#: shorter follows from them, and rows with a smaller reciprocal condition number do not determine the unknowns.
RANK_TOLERANCE = 1e-12

#: Block size of LAPACK's factorizations, columns.
LAPACK_BLOCK = 64

#: Smallest violation of an inequality, relative to its right side, that solvers reach.
TOUCHED = 1e-9

#: Rounding of an inequality with a right side near zero, in scaled units.
ZERO_VIOLATION = 1e-13


@dataclass(frozen=True, eq=False)
class Answer:
    """An answer to a scaled program, not yet checked.

    Parameters
    ----------
    z : ndarray, shape (n,)
    y : ndarray, shape (a,)
        Multipliers of E z = e.
    w : ndarray, shape (g,)
        Multipliers of F z <= f.
    status : str
    iterations : int or None
    matrices : tuple of ndarray, optional
        Dual matrices of the matrix inequalities.
    """

    z: Floats
    y: Floats
    w: Floats
    status: str
    iterations: int | None
    matrices: tuple[Floats, ...] = ()


@dataclass(frozen=True, eq=False)
class Canonical:
    """minimize |C z - q|^2 / 2 subject to E z = e, F z <= f, and matrix inequalities.

    Parameters
    ----------
    C, q : ndarray, shapes (n, n) and (n,)
        C is the identity unless `singular`.
    E, e : ndarray, shapes (a, n) and (a,)
        Independent equalities, rows of unit length.
    F, f : ndarray, shapes (g, n) and (g,)
        Inequalities, bounds among them, rows of unit length.
    singular : bool
        Whether the rows and the equalities leave a direction free.
    lmi : tuple of MatrixInequality
        In z, the largest entry of each one's slopes scaled to 1.
    """

    C: Floats
    q: Floats
    E: Floats
    e: Floats
    F: Floats
    f: Floats
    singular: bool
    _inverse: Floats
    _tau: float
    _equality_scale: Floats
    _inequality_scale: Floats
    _independent: Bools
    lmi: tuple[MatrixInequality, ...] = ()
    _matrix_scale: Floats = field(default_factory=lambda: np.zeros(0))

    def stated(self, scale: float = 1.0) -> LeastSquares:
        """Write this as a program, with a factor on unknowns and right sides; its objective is not halved."""
        lmi = tuple(replace(each, constant=scale * each.constant) for each in self.lmi)
        return LeastSquares(self.C, scale * self.q, A=self.E, b=scale * self.e, G=self.F, h=scale * self.f, lmi=lmi)

    def nearest(self) -> tuple[Floats, Floats]:
        """Find the point nearest to q under the equalities alone, of a regular program, and its multipliers.

        With E' = B T, q - z = B T'^-1 (E q - e) = E' y.

        Returns
        -------
        z : ndarray, shape (n,)
        y : ndarray, shape (a,)
        """
        if not len(self.E):
            return self.q.copy(), np.zeros(0)
        B, T = np.linalg.qr(self.E.T)
        along, _ = lapack.dtrtrs(T, self.E @ self.q - self.e, trans=1)
        multipliers, _ = lapack.dtrtrs(T, along)
        return self.q - B @ along, multipliers

    def violated(self, z: Floats) -> Bools:
        """Find the inequalities that a point violates by more than rounding, shape (g,)."""
        return np.asarray(self.F @ z - self.f > np.clip(TOUCHED * np.abs(self.f), ZERO_VIOLATION, TOUCHED))

    def to_x(self, z: Floats) -> Floats:
        """Convert scaled unknowns to their own units."""
        return self._tau * (self._inverse @ z)

    def multipliers(self, y: Floats, w: Floats) -> tuple[Floats, Floats]:
        """Convert multipliers to the units of the original program, zero for equalities that follow from others."""
        full = np.zeros(len(self._independent))
        full[self._independent] = self._tau**2 * self._equality_scale * y
        return full, self._tau**2 * self._inequality_scale * w

    def point(self, answer: Answer) -> Point:
        """Convert an answer to the caller's units."""
        matrices = tuple(map(np.multiply, self._tau**2 * self._matrix_scale, answer.matrices))
        return Point(self.to_x(answer.z), *self.multipliers(answer.y, answer.w), matrices)

    def reach(self, distance: float) -> Floats:
        """Largest change of each unknown that keeps the equalities and moves z by at most this distance, shape (n,)."""
        free = self._inverse @ linalg.null_space(self.E) if len(self.E) else self._inverse
        return np.asarray(self._tau * distance * np.linalg.norm(free, axis=1))


def canonical(program: LeastSquares) -> Canonical:
    """Scale a program.

    Raises
    ------
    InfeasibleError
        If equalities contradict each other.
    """
    R, s = program.weighted
    A, b = program.equalities
    independent = _consistent_rows(A, b)
    A, b = A[independent], b[independent]
    inverse, C, q, singular = _whitening(R, s, A, b)
    E, e, equality_scale = _unit_rows(A @ inverse, b)
    F, f, inequality_scale = _unit_rows(*program.inequalities_in(inverse))
    tau = max(float(np.linalg.norm(q)), float(np.max(np.abs(e), initial=0.0)), float(np.max(-f, initial=0.0)))
    tau = tau if tau > 0 else 1.0
    lmi, matrix_scale = [], np.ones(len(program.lmi))
    for place, each in enumerate(program.lmi):
        slopes = np.tensordot(inverse.T, each.slopes, 1)
        matrix_scale[place] = scale = 1.0 / np.max(np.abs(slopes))
        lmi.append(replace(each, constant=scale * each.constant / tau, slopes=scale * slopes))
    return Canonical(
        C, q / tau, E, e / tau, F, f / tau, singular, inverse, tau,
        equality_scale / tau, inequality_scale / tau, independent, tuple(lmi), matrix_scale / tau,
    )  # fmt: skip


def _whitening(R: Floats, s: Floats, A: Floats, b: Floats) -> tuple[Floats, Floats, Floats, bool]:
    """Compute the scaling x = inverse @ z and the objective |C z - q|^2."""
    lengths = np.linalg.norm(R, axis=0)
    D = 1.0 / np.where(lengths > 0, lengths, 1.0)
    n = R.shape[1]
    # With the right side as a further column, the last column of the triangle is Q' [s; sigma b].
    side, more = s[:, None], np.column_stack(_unit_rows(A * D, b)[:2])
    # LAPACK's triangular solvers ignore the reflections below the diagonal.
    triangle = lapack.dgeqrf(np.vstack([np.hstack([R * D, side]), more]), lwork=LAPACK_BLOCK * (n + 1))[0][:n]
    U, q = triangle[:, :n], triangle[:, n]
    # LAPACK estimates the condition number of a triangle, in the 1-norm, at O(n^2) cost.
    if len(U) == n and float(lapack.dtrcon(U)[0]) > RANK_TOLERANCE:
        # From U'X' = I, so that X U is the identity to its last digits, row by row: x = X z is what is needed.
        inverse = lapack.dtrtrs(U, np.eye(n), trans=1)[0].T
        return D[:, None] * inverse, np.eye(n), q.copy(), False
    square = np.zeros((n, n))
    square[: len(U)] = np.triu(U)
    padded = np.zeros(n)
    padded[: len(U)] = q
    return np.diag(D), square, padded, True


def _unit_rows(rows: Floats, side: Floats) -> tuple[Floats, Floats, Floats]:
    """Scale the rows to unit length, in place, and the right side with them; return the scale of each, too."""
    lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    scale = 1.0 / np.where(lengths > 0, lengths, 1.0)
    rows *= scale[:, None]
    return rows, side * scale, scale


def _consistent_rows(A: Floats, b: Floats) -> Bools:
    """Select equalities that imply all others; raise an error if equalities contradict each other."""
    rows, side, _ = _unit_rows(A.astype(float), b)
    keep = independent_rows(rows)
    if np.all(keep):
        return keep
    point = np.linalg.lstsq(rows[keep], side[keep], rcond=None)[0]
    error = np.abs(rows @ point - side)
    if np.any(error > 1e-9 * max(1e-300, float(np.abs(side).max()))):
        raise InfeasibleError("the equalities contradict each other")
    return keep


def independent_rows(rows: Floats) -> Bools:
    """Select independent rows; the other rows are combinations of these.

    Parameters
    ----------
    rows : ndarray, shape (a, n)
        Of unit length, or of zeros.

    Returns
    -------
    ndarray of bool, shape (a,)
    """
    keep = np.ones(len(rows), dtype=bool)
    if not len(rows) or (len(rows) == 1 and np.any(rows)):
        return keep
    triangle, order = linalg.qr(rows.T, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    keep[order[int(np.sum(diagonal > RANK_TOLERANCE * max(diagonal[0], 1e-300))) :]] = False
    return keep
