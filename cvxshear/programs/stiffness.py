"""The program of the story stiffnesses (Eqs. 20-24)."""

from __future__ import annotations

import numpy as np

from cvxshear.frame import transformation
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.programs.mass import pair_products
from cvxshear.typing import Floats


def story_stiffnesses(shapes: Floats, eigenvalues: Floats) -> LeastSquares:
    """Eqs. 20 to 24: the stiffnesses on which the modes are orthogonal, with the measured eigenvalues.

    Row (i, j): (x_i o x_j)' k = delta_ij lambda_i with x = T' phi, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode, mass-normalized.
    eigenvalues : ndarray, shape (m,)
        lambda = (2 pi f)^2, (rad/s)^2.
    """
    drifts = transformation(shapes.shape[0]).T @ shapes
    i, j = np.triu_indices(shapes.shape[1])
    return LeastSquares(
        R=pair_products(drifts),
        s=np.where(i == j, eigenvalues[i], 0.0),
        names=tuple(f"story_stiffness {place}" for place in range(1, shapes.shape[0] + 1)),
    )
