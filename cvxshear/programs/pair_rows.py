"""The rows of the paper's programs, Eqs. 5 to 14 and 20 to 24, from arrays of mode shapes.

Modes are orthogonal with respect to the masses, and their story drifts with respect to the stiffnesses. Each pair of
modes is one row p_i o p_j, linear in the unknowns. With P the columns p_j, G = P P' and Q = P o P,

    A'A = (G o G + Q Q') / 2                      over the pairs i <= j,
    A'A = (G o G - Q Q') / 2                      over the pairs i < j,
    A'e = diag(P E P' + P diag(E) P') / 2         over the pairs i <= j, E symmetric with the entries e,

so that N stories cost O(N^3) operations and O(N^2) memory. A Cholesky factor of A'A is a program of N rows with the
same minimizer. It squares the condition number c of the columns scaled to unit length: the answer has an error of c^2
times the rounding. A second program, centered at the first answer, has the right side A'(B - A x), computed from the
residual matrix. This step reduces the error to the level of a QR factorization of the rows (the corrected seminormal
equations, Björck 1987).
"""

from typing import Any

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from cvxshear.programs.constraints import remaining
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.util.typing import Floats

ROWS_UP_TO = 30
"""Largest number of stories for a program with one row for each pair of modes, unless the caller chooses."""

ROUNDED_EIGENVALUE = 1e-14
"""Smallest eigenvalue of a scaled normal matrix, relative to the largest, that is not rounding."""


def keeps_rows(rows: bool | None, stories: int) -> bool:
    """Return whether a program keeps its rows: the caller's choice, else by the number of stories."""
    return stories <= ROWS_UP_TO if rows is None else rows


def pair_products(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Compute the rows p_i o p_j for the column pairs i <= j, or i < j without the diagonal.

    scipy.linalg.khatri_rao forms every pair twice, and these rows take most of the memory of a program.

    Parameters
    ----------
    columns : ndarray, shape (N, m)

    Returns
    -------
    ndarray, shape (m (m + 1) / 2, N) or (m (m - 1) / 2, N)
    """
    i, j = np.triu_indices(columns.shape[1], k=0 if diagonal else 1)
    return np.ascontiguousarray((columns[:, i] * columns[:, j]).T)


def pair_normal(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Compute A'A of the rows p_i o p_j, i <= j, or i < j without the diagonal.

    Parameters
    ----------
    columns : ndarray, shape (..., N, m)
        Leading axes are a batch.
    diagonal : bool, optional

    Returns
    -------
    ndarray, shape (..., N, N)
    """
    G = columns @ np.swapaxes(columns, -1, -2)
    Q = columns**2
    squares = Q @ np.swapaxes(Q, -1, -2)
    G *= G
    G += squares if diagonal else -squares
    G *= 0.5
    return G


def pair_adjoint(columns: Floats, E: Floats, *, diagonal: bool = True) -> Floats:
    """Compute A'e for a symmetric matrix E with one number for each pair of modes.

    Parameters
    ----------
    columns : ndarray, shape (N, m)
    E : ndarray, shape (m, m)
    diagonal : bool, optional
        Whether the pairs i = i are among the rows.

    Returns
    -------
    ndarray, shape (N,)
    """
    both = np.sum(columns * (columns @ E), axis=1)
    own = columns**2 @ np.diag(E)
    return np.asarray(0.5 * (both + own if diagonal else both - own))


def factored(normal: Floats, side: Floats) -> tuple[Floats, Floats]:
    """Factor normal equations: R'R = normal and R's = side.

    Parameters
    ----------
    normal : ndarray, shape (n, n)
        Symmetric, positive semidefinite up to rounding.
    side : ndarray, shape (n,)

    Returns
    -------
    R : ndarray, shape (n, n)
        Upper triangular if `normal` is definite.
    s : ndarray, shape (n,)
    """
    lengths = np.sqrt(np.maximum(np.diag(normal), 0.0))
    D = np.where(lengths > 0, lengths, 1.0)
    scaled = normal / D[:, None] / D
    scaled_side = side / D
    try:
        U = linalg.cholesky(scaled, check_finite=False)
    except linalg.LinAlgError:
        values, vectors = linalg.eigh(scaled)
        known = values > ROUNDED_EIGENVALUE * len(values) * values[-1]
        root = np.sqrt(values[known])
        R = np.zeros_like(normal)
        s = np.zeros_like(side)
        R[: len(root)] = root[:, None] * vectors[:, known].T * D
        s[: len(root)] = (vectors[:, known].T @ scaled_side) / root
        return R, s
    return U * D, linalg.solve_triangular(U, scaled_side, trans="T", check_finite=False)


def digits_lost(R: Floats) -> float:
    """Compute the decimal digits that a factored program loses by the square of its condition number.

    The condition number is LAPACK's estimate in the 1-norm, for columns scaled to unit length.

    Parameters
    ----------
    R : ndarray, shape (n, n)
        From `factored`.
    """
    lengths = np.linalg.norm(R, axis=0)
    scaled = R / np.where(lengths > 0, lengths, 1.0)
    if np.any(np.tril(scaled, -1)):
        values = np.linalg.svd(scaled, compute_uv=False)
        reciprocal = float(values[-1] / values[0])
    else:
        reciprocal = float(lapack.dtrcon(scaled)[0])
    return float("inf") if reciprocal == 0 else -2.0 * float(np.log10(reciprocal))


def normalized(shapes: Floats, M: Floats) -> Floats:
    """Scale the columns to phi_j' M phi_j = 1 (Eq. 3); M is a vector of masses or a full matrix."""
    weighted = M[:, None] * shapes if M.ndim == 1 else M @ shapes
    return np.asarray(shapes / np.sqrt(np.sum(shapes * weighted, axis=0)))


def mass_rows(shapes: Floats, floor_mass: Floats, total: float, *, rows: bool | None = None) -> LeastSquares:
    """Write Eqs. 5 to 14: the correction dm that makes the modes orthonormal and keeps the total.

    Row (i, j): (phi_i o phi_j)' dm = delta_ij - phi_i' M phi_j, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, normalized by `floor_mass` (Eq. 3).
    floor_mass : ndarray, shape (N,)
        Masses of this iteration with added mass, kg.
    total : float
        Their known sum, kg.
    rows : bool, optional
        Whether the program has one row for each pair of modes, or a factor of their normal matrix. Default: rows for
        up to `ROWS_UP_TO` stories.
    """
    if keeps_rows(rows, len(floor_mass)):
        R = pair_products(shapes)
        i, j = np.triu_indices(shapes.shape[1])
        return LeastSquares(R, np.where(i == j, 1.0, 0.0) - R @ floor_mass, **_total(floor_mass, total))
    normal = pair_normal(shapes)
    side = np.sum(shapes**2, axis=1) - normal @ floor_mass
    return LeastSquares(*factored(normal, side), **_total(floor_mass, total))


def _total(at: Floats, total: float) -> dict[str, Any]:
    """State that the masses add up to the total, for their change from `at`, and name them."""
    ones = np.ones((1, len(at)))
    return {
        "A": ones,
        "b": remaining(np.array([total]), ones, at),
        "names": tuple(f"floor_mass {place}" for place in range(1, len(at) + 1)),
    }


def one_shot_rows(shapes: Floats, total: float, *, rows: bool | None = None, at: Floats | None = None) -> LeastSquares:
    """Write the orthogonality of the modes, linear in the masses for any scale of the modes, with the known total.

    Row (i, j): (phi_i o phi_j)' m = 0, for i < j, with sum m = total. For exact modes the masses are exact, without
    iteration.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, of any scale. Each is scaled to unit length, so that its scale has no influence.
    total : float
        Sum of the masses with added mass, kg.
    rows : bool, optional
        As for `mass_rows`.
    at : ndarray, shape (N,), optional
        The unknown is the change from these masses, kg. Default: zero.
    """
    unit = shapes / np.linalg.norm(shapes, axis=0)
    origin = np.zeros(len(unit)) if at is None else at
    if keeps_rows(rows, len(unit)):
        R = pair_products(unit, diagonal=False)
        return LeastSquares(R, -(R @ origin), **_total(origin, total))
    normal = pair_normal(unit, diagonal=False)
    side = np.zeros(len(unit))
    if at is not None:
        side = -pair_adjoint(unit, unit.T @ (at[:, None] * unit), diagonal=False)
    # With exact modes, the rows vanish at any multiple of the true masses. The exact row of the total mass fixes the
    # multiple.
    weight = float(np.trace(normal)) / len(normal) ** 2
    normal, side = normal + weight, side + weight * (total - origin.sum())
    return LeastSquares(*factored(normal, side), **_total(origin, total))


def stiffness_rows(
    shapes: Floats, eigenvalues: Floats, *, rows: bool | None = None, at: Floats | None = None
) -> LeastSquares:
    """Write Eqs. 20 to 24: the stiffnesses that make the modes orthogonal, with the measured eigenvalues.

    Row (i, j): (x_i o x_j)' k = delta_ij lambda_i with the story drifts x = T' phi, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, mass-normalized.
    eigenvalues : ndarray, shape (m,)
        lambda = (2 pi f)^2, (rad/s)^2.
    rows : bool, optional
        As for `mass_rows`.
    at : ndarray, shape (N,), optional
        The unknown is the change from these stiffnesses, N/m. Default: zero.
    """
    drifts = np.diff(shapes, axis=0, prepend=0.0)
    names = tuple(f"story_stiffness {place}" for place in range(1, len(drifts) + 1))
    if keeps_rows(rows, len(drifts)):
        R = pair_products(drifts)
        i, j = np.triu_indices(drifts.shape[1])
        s = np.where(i == j, eigenvalues[i], 0.0)
        return LeastSquares(R, s if at is None else s - R @ at, names=names)
    if at is None:
        side = drifts**2 @ eigenvalues
    else:
        side = pair_adjoint(drifts, np.diag(eigenvalues) - drifts.T @ (at[:, None] * drifts))
    return LeastSquares(*factored(pair_normal(drifts), side), names=names)
