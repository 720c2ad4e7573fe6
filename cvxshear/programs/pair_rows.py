"""The rows of the paper's programs, Eqs. 5 to 14 and 20 to 24, from arrays of mode shapes.

Modes are orthogonal with respect to the masses, and their story drifts with respect to the stiffnesses. Each pair of
modes is one row p_i o p_j, linear in the unknowns. With P the columns p_j, G = P P' and Q = P o P,

    A'A = (G o G + Q Q') / 2                      over the pairs i <= j,
    A'A = (G o G - Q Q') / 2                      over the pairs i < j.

In a tall frame the Cholesky factor of A'A replaces the rows: N stories then cost O(N^3) operations and O(N^2) memory.
"""

from typing import Any

import numpy as np
from scipy import linalg

from cvxshear.programs.constraints import remaining
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.util.typing import Floats

#: Largest number of stories for a program with one row for each pair of modes: from there on a factor is faster.
ROWS_UP_TO = 30


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
    return np.asarray(0.5 * (G * G + squares if diagonal else G * G - squares))


def _of_pairs(columns: Floats, pair_sides: Floats, *, diagonal: bool = True, **more: Any) -> LeastSquares:
    """Write the program with one row for each pair of columns, or with a factor of their normal matrix.

    Parameters
    ----------
    columns : ndarray, shape (N, m)
    pair_sides : ndarray, shape (m, m)
        Symmetric: the right side of each pair.
    diagonal : bool, optional
        Whether the pairs i = i are among the rows.
    **more
        Equalities and names of the program.
    """
    if len(columns) > ROWS_UP_TO:
        normal, squares = pair_normal(columns, diagonal=diagonal), columns**2 @ np.diag(pair_sides)
        side = 0.5 * (np.sum(columns * (columns @ pair_sides), axis=1) + (squares if diagonal else -squares))
        if "A" in more:
            # With exact modes the rows vanish at any multiple of the true masses. The exact total fixes the multiple.
            weight = float(np.trace(normal)) / len(normal) ** 2
            normal, side = normal + weight * more["A"].T @ more["A"], side + weight * more["A"].T @ more["b"]
        lengths = np.sqrt(np.diag(normal))
        try:
            U = linalg.cholesky(normal / lengths[:, None] / lengths)
        except (linalg.LinAlgError, ValueError):
            # Some modes are alike to rounding.
            pass
        else:
            return LeastSquares(U * lengths, linalg.solve_triangular(U, side / lengths, trans="T"), **more)
    i, j = np.triu_indices(columns.shape[1], k=0 if diagonal else 1)
    return LeastSquares(pair_products(columns, diagonal=diagonal), pair_sides[i, j], **more)


def normalized(shapes: Floats, M: Floats) -> Floats:
    """Scale the columns to phi_j' M phi_j = 1 (Eq. 3); M is a vector of masses or a full matrix."""
    weighted = M[:, None] * shapes if M.ndim == 1 else M @ shapes
    return np.asarray(shapes / np.sqrt(np.sum(shapes * weighted, axis=0)))


def mass_rows(shapes: Floats, floor_mass: Floats, total: float) -> LeastSquares:
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
    """
    missing = np.eye(shapes.shape[1]) - shapes.T @ (floor_mass[:, None] * shapes)
    return _of_pairs(shapes, missing, **_total(floor_mass, total))


def _total(at: Floats, total: float) -> dict[str, Any]:
    """State that the masses add up to the total, for their change from `at`, and name them."""
    ones = np.ones((1, len(at)))
    return {
        "A": ones,
        "b": remaining(np.array([total]), ones, at),
        "names": tuple(f"floor_mass {place}" for place in range(1, len(at) + 1)),
    }


def one_shot_rows(shapes: Floats, total: float, *, at: Floats | None = None) -> LeastSquares:
    """Write the orthogonality of the modes, linear in the masses for any scale of the modes, with the known total.

    Row (i, j): (phi_i o phi_j)' m = 0, for i < j, with sum m = total. For exact modes the masses are exact, without
    iteration.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, of any scale. Each is scaled to unit length, so that its scale has no influence.
    total : float
        Sum of the masses with added mass, kg.
    at : ndarray, shape (N,), optional
        The unknown is the change from these masses, kg. Default: zero.
    """
    unit = shapes / np.linalg.norm(shapes, axis=0)
    origin = np.zeros(len(unit)) if at is None else at
    return _of_pairs(unit, -unit.T @ (origin[:, None] * unit), diagonal=False, **_total(origin, total))


def stiffness_rows(shapes: Floats, eigenvalues: Floats) -> LeastSquares:
    """Write Eqs. 20 to 24: the stiffnesses that make the modes orthogonal, with the measured eigenvalues.

    Row (i, j): (x_i o x_j)' k = delta_ij lambda_i with the story drifts x = T' phi, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, mass-normalized.
    eigenvalues : ndarray, shape (m,)
        lambda = (2 pi f)^2, (rad/s)^2.
    """
    drifts = np.diff(shapes, axis=0, prepend=0.0)
    names = tuple(f"story_stiffness {place}" for place in range(1, len(drifts) + 1))
    return _of_pairs(drifts, np.diag(eigenvalues), names=names)
