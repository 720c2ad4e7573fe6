"""The programs that orthogonality of the modes makes, Eqs. 5-14 and 20-24: floor masses, then story stiffnesses.

Modes are orthogonal with respect to the masses, and their story drifts with respect to the stiffnesses. Each pair of
modes is one row, linear in the unknowns.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cvxshear.programs.least_squares import LeastSquares, remaining
from cvxshear.programs.normal import factored, keeps_rows, pair_adjoint, pair_normal
from cvxshear.util.typing import Floats


def pair_products(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Rows p_i o p_j for the column pairs i <= j, or i < j without the diagonal.

    scipy.linalg.khatri_rao forms every pair twice, and these rows are most of the memory of a program.

    Parameters
    ----------
    columns : ndarray, shape (N, m)

    Returns
    -------
    ndarray, shape (m (m + 1) / 2, N) or (m (m - 1) / 2, N)
    """
    i, j = np.triu_indices(columns.shape[1], k=0 if diagonal else 1)
    return np.ascontiguousarray((columns[:, i] * columns[:, j]).T)


def normalized(shapes: Floats, M: Floats) -> Floats:
    """Scale the columns to phi_j' M phi_j = 1 (Eq. 3); M is a vector of masses or a full matrix."""
    weighted = M[:, None] * shapes if M.ndim == 1 else M @ shapes
    scaled: Floats = shapes / np.sqrt(np.sum(shapes * weighted, axis=0))
    return scaled


def mass_correction(
    shapes: Floats, floor_mass: Floats, total: float, *, rows: bool | None = None, diagonal: bool = True
) -> LeastSquares:
    """Eqs. 5 to 14: the correction dm that makes the modes orthonormal, the total kept.

    Row (i, j): (phi_i o phi_j)' dm = delta_ij - phi_i' M phi_j, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode, normalized by `floor_mass` (Eq. 3).
    floor_mass : ndarray, shape (N,)
        Masses of this iteration, with added mass, kg.
    total : float
        Their known sum, kg.
    rows : bool, optional
        Whether the program keeps a row a pair, or a factor of their normal matrix stands for them; by the number
        of stories where not given (`normal.ROWS_UP_TO`).
    diagonal : bool, optional
        Without the rows i = j: see `identify.fixed_point`.
    """
    if keeps_rows(rows, len(floor_mass)):
        R = pair_products(shapes, diagonal=diagonal)
        i, j = np.triu_indices(shapes.shape[1], k=0 if diagonal else 1)
        return LeastSquares(R, np.where(i == j, 1.0, 0.0) - R @ floor_mass, **_total(floor_mass, total))
    normal = pair_normal(shapes, diagonal=diagonal)
    side = (np.sum(shapes**2, axis=1) if diagonal else 0.0) - normal @ floor_mass
    if not diagonal:
        normal, side = _with_total(normal, side, total - floor_mass.sum())
    return LeastSquares(*factored(normal, side), **_total(floor_mass, total))


def _with_total(normal: Floats, side: Floats, missing: float) -> tuple[Floats, Floats]:
    """Add the total's row to the normal equations.

    Exact modes leave the direction of the masses themselves open where only pairs i < j are looked at; the total
    closes it, and changes nothing since it holds exactly.
    """
    weight = float(np.trace(normal)) / len(normal) ** 2
    return normal + weight, side + weight * missing


def _total(at: Floats, total: float) -> dict[str, Any]:
    """State that the masses add up to the total, for their change from `at`; and name them."""
    everywhere = np.ones((1, len(at)))
    return {
        "A": everywhere,
        "b": remaining(np.array([total]), everywhere, at),
        "names": tuple(f"floor_mass {place}" for place in range(1, len(at) + 1)),
    }


def one_shot_masses(
    shapes: Floats, total: float, *, rows: bool | None = None, at: Floats | None = None
) -> LeastSquares:
    """All masses at once: modes are orthogonal whatever their scale, and the total is known.

    Row (i, j): (phi_i o phi_j)' m = 0, for i < j, with sum m = total. For exact modes the masses are exact,
    without an iteration.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode, of any scale; each is scaled to unit length, so that no mode weighs more for the
        scale it was reported in.
    total : float
        Sum of the masses with added mass, kg.
    rows : bool, optional
        As for `mass_correction`.
    at : ndarray, shape (N,), optional
        Masses from which the unknown is a change; none where not given.
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
    return LeastSquares(*factored(*_with_total(normal, side, total - origin.sum())), **_total(origin, total))


def story_stiffnesses(
    shapes: Floats, eigenvalues: Floats, *, rows: bool | None = None, at: Floats | None = None
) -> LeastSquares:
    """Eqs. 20 to 24: the stiffnesses on which the modes are orthogonal, with the measured eigenvalues.

    Row (i, j): (x_i o x_j)' k = delta_ij lambda_i with the story drifts x = T' phi, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode, mass-normalized.
    eigenvalues : ndarray, shape (m,)
        lambda = (2 pi f)^2, (rad/s)^2.
    rows : bool, optional
        As for `mass_correction`.
    at : ndarray, shape (N,), optional
        Stiffnesses from which the unknown is a change; none where not given.
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
