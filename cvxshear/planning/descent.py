"""The least of a smooth function of shares, each between nothing and all: sequential quadratic programming."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, minimize

from cvxshear.util.typing import Floats


def descended(
    function: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    within: LinearConstraint,
    rounds: int,
    tolerance: float,
) -> Floats:
    """Where the function is least, or at least lower than at the start (scipy's SLSQP).

    Parameters
    ----------
    function : callable
        Value and gradient, shape (n,), at shares of shape (n,).
    start : ndarray, shape (n,)
    within : LinearConstraint
    rounds : int
        Steps at most.
    tolerance : float
        Of the value.

    Returns
    -------
    ndarray, shape (n,)
        Between 0 and 1.
    """
    found = minimize(
        function,
        start,
        jac=True,
        method="SLSQP",
        bounds=Bounds(0.0, 1.0),
        constraints=within,
        options={"maxiter": rounds, "ftol": tolerance},
    )
    result: Floats = np.clip(found.x, 0.0, 1.0)
    return result
