"""What a backend returns: the unknowns, the multipliers, and a certificate that does not come from the backend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.typing import Floats, Json


@dataclass(frozen=True)
class Certificate:
    """How well a solution meets the optimality conditions, computed here from the program and the solution.

    Parameters
    ----------
    primal_residual : float
        Largest violation of a constraint.
    dual_residual : float
        Largest entry of the Lagrangian's gradient, and largest multiplier of the wrong sign.
    duality_gap : float
        Primal less dual objective.

    Notes
    -----
    All three are of the scaled program of `canonical`, in which the unknowns, the rows and the objective are
    of order one: they read as relative errors.
    """

    primal_residual: float
    dual_residual: float
    duality_gap: float

    @property
    def worst(self) -> float:
        """The largest of the three; nan where one is nan."""
        return float(np.max([self.primal_residual, self.dual_residual, self.duality_gap]))

    def to_dict(self) -> Json:
        return {
            "primal_residual": self.primal_residual,
            "dual_residual": self.dual_residual,
            "duality_gap": self.duality_gap,
        }


@dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a program, with its certificate.

    Parameters
    ----------
    x : ndarray, shape (n,)
    equality_multipliers : ndarray, shape (a,)
        y of the Lagrangian |W (R x - s)|^2 / 2 + y' (A x - b) + w' (G x - h).
    inequality_multipliers : ndarray
        w >= 0, one for each row of `LeastSquares.inequalities`.
    certificate : Certificate
    backend : str
    status : str
        The backend's own word for how it ended.
    iterations : int or None
        None where the backend does not tell.
    seconds : float
        Wall time, the scaling and the certificate included.
    """

    x: Floats
    equality_multipliers: Floats
    inequality_multipliers: Floats
    certificate: Certificate
    backend: str
    status: str
    iterations: int | None
    seconds: float
