"""The program of the story stiffnesses (Eqs. 20-24)."""

from __future__ import annotations

import numpy as np

from cvxshear.programs.least_squares import LeastSquares
from cvxshear.programs.mass import pair_products
from cvxshear.programs.normal import factored, keeps_rows, pair_adjoint, pair_normal
from cvxshear.util.typing import Floats


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
