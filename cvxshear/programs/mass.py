"""The programs of the floor masses: the paper's correction (Eqs. 5-14) and the one without iteration."""

from __future__ import annotations

import numpy as np

from cvxshear.programs.least_squares import LeastSquares, remaining
from cvxshear.typing import Floats


def pair_products(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Rows p_i o p_j for the column pairs i <= j, or i < j without the diagonal.

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
    """The columns scaled to phi_j' M phi_j = 1 (Eq. 3); M is a vector of masses or a full matrix."""
    heavy = M[:, None] * shapes if M.ndim == 1 else M @ shapes
    scaled: Floats = shapes / np.sqrt(np.sum(shapes * heavy, axis=0))
    return scaled


def mass_correction(shapes: Floats, floor_mass: Floats, total: float) -> LeastSquares:
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
    """
    R = pair_products(shapes)
    i, j = np.triu_indices(shapes.shape[1])
    everywhere = np.ones((1, len(floor_mass)))
    return LeastSquares(
        R=R,
        s=np.where(i == j, 1.0, 0.0) - R @ floor_mass,
        A=everywhere,
        b=remaining(np.array([total]), everywhere, floor_mass),
        names=tuple(f"floor_mass {place}" for place in range(1, len(floor_mass) + 1)),
    )


def one_shot_masses(shapes: Floats, total: float) -> LeastSquares:
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
    """
    R = pair_products(shapes / np.linalg.norm(shapes, axis=0), diagonal=False)
    n = shapes.shape[0]
    return LeastSquares(
        R=R,
        s=np.zeros(len(R)),
        A=np.ones((1, n)),
        b=np.array([total]),
        names=tuple(f"floor_mass {place}" for place in range(1, n + 1)),
    )
