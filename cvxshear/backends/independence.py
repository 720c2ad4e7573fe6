"""Which of some rows follow from the others."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from cvxshear.util.typing import Bools, Floats

DEPENDENT = 1e-12
"""Part of a row of unit length that is left beside the span of the others where it counts as following from them."""


def independent_rows(rows: Floats) -> Bools:
    """Which rows to keep, the others being combinations of them.

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
    keep[order[int(np.sum(diagonal > DEPENDENT * max(diagonal[0], 1e-300))) :]] = False
    return keep
