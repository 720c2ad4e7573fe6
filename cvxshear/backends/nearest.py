"""The nearest point to q under equalities alone: where every backend's answer comes from or is compared to."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from cvxshear.backends.canonical import Canonical
from cvxshear.util.typing import Floats


def nearest(problem: Canonical) -> tuple[Floats, Floats]:
    """The nearest point to q on E z = e, and the multipliers: with E' = B T, q - z = B T'^-1 (E q - e) = E' y.

    Parameters
    ----------
    problem : Canonical
        Not singular: its C is the identity.

    Returns
    -------
    z : ndarray, shape (n,)
    y : ndarray, shape (a,)
    """
    if not len(problem.E):
        return problem.q.copy(), np.zeros(0)
    B, T = np.linalg.qr(problem.E.T)
    along, _ = lapack.dtrtrs(T, problem.E @ problem.q - problem.e, trans=1)
    multipliers, _ = lapack.dtrtrs(T, along)
    return problem.q - B @ along, multipliers
