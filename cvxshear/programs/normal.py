"""Normal matrices of the pair programs, without the N (N + 1) / 2 rows that they are the squares of.

Every program of the paper has one row p_i o p_j for each pair of modes. With P the columns p_j, G = P P' and
Q = P o P,

    A'A = (G o G + Q Q') / 2                      over the pairs i <= j,
    A'A = (G o G - Q Q') / 2                      over the pairs i < j,
    A'e = diag(P E P' + P diag(E) P') / 2         over the pairs i <= j, E symmetric with the entries e,

so that N stories cost O(N^3) operations and O(N^2) memory. A Cholesky factor of A'A is then a program of N rows
with the same minimizer. Its condition number is that of the rows, but it was got from their square: where the
rows' columns, scaled to unit length, have the condition number c, the factor carries an error of c^2 times the
rounding. A second program centred at the first answer, whose right side A'(B - A x) is computed from the residual
matrix and not from A'A, takes that error down to that of a factorization of the rows (the corrected seminormal
equations, Björck 1987).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from cvxshear.util.typing import Floats

ROWS_UP_TO = 30
"""Stories up to which a program keeps its rows where the caller names no form: they are cheap there."""

LOST = 4.0
"""Decimal digits lost to the squared condition number from which on a second, centred program is solved."""

ROUNDED_EIGENVALUE = 1e-14
"""Eigenvalue of a scaled normal matrix, relative to the largest, that is rounding."""


def keeps_rows(rows: bool | None, stories: int) -> bool:
    """Whether a program keeps its rows: what the caller said, else by the number of stories."""
    return stories <= ROWS_UP_TO if rows is None else rows


def pair_normal(columns: Floats, *, diagonal: bool = True) -> Floats:
    """A'A of the rows p_i o p_j, i <= j, or i < j without the diagonal.

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
    """A'e of a symmetric matrix E that holds one number a pair of modes.

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
    result: Floats = 0.5 * (both + own if diagonal else both - own)
    return result


def factored(normal: Floats, side: Floats) -> tuple[Floats, Floats]:
    """Factor normal equations: R'R = normal and R's = side.

    Parameters
    ----------
    normal : ndarray, shape (n, n)
        Symmetric, positive semidefinite but for rounding.
    side : ndarray, shape (n,)

    Returns
    -------
    R : ndarray, shape (n, n)
        Upper triangular where `normal` is definite.
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
    """Decimal digits that the square of the condition number takes from the answer of a factored program.

    The condition number is LAPACK's estimate in the 1-norm, of the columns scaled to unit length.

    Parameters
    ----------
    R : ndarray, shape (n, n)
        Of `factored`.
    """
    lengths = np.linalg.norm(R, axis=0)
    scaled = R / np.where(lengths > 0, lengths, 1.0)
    if np.any(np.tril(scaled, -1)):
        values = np.linalg.svd(scaled, compute_uv=False)
        reciprocal = float(values[-1] / values[0])
    else:
        reciprocal = float(lapack.dtrcon(scaled)[0])
    return float("inf") if reciprocal == 0 else -2.0 * float(np.log10(reciprocal))
