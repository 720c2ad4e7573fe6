"""Rayleigh damping: C = a M + b K."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.model.shear import Modes
from cvxshear.programs import LeastSquares
from cvxshear.response.dashpots import LEAST_RATIO
from cvxshear.response.ratios import Ratios
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats


def rayleigh(of: Modes, ratios: Ratios, backend: Backend) -> Floats:
    """a and b of C = a M + b K, both at least zero, by zeta_i = a / (2 omega_i) + b omega_i / 2, weighted.

    Parameters
    ----------
    of : Modes
    ratios : Ratios
    backend : Backend

    Returns
    -------
    ndarray, shape (2,)
        a in 1/s, b in s.

    Raises
    ------
    UnsuitableError
        Where fewer than two modes have a measured ratio.
    """
    seen = np.flatnonzero(ratios.measured)
    if len(seen) < 2:
        raise UnsuitableError(
            "Rayleigh damping has two factors, and one mode's damping ratio was measured; use modal damping"
        )
    omega, zeta = np.sqrt(of.eigenvalues[seen]), ratios.values[seen]
    std = ratios.std[seen] * np.maximum(zeta, LEAST_RATIO)
    rows = np.column_stack([0.5 / omega, 0.5 * omega]) / std[:, None]
    program = LeastSquares(rows, zeta / std, lower=np.zeros(2), names=("a", "b"))
    return np.maximum(backend.solve(program).x, 0.0)
