"""What a backend returns: the unknowns, the multipliers, and a certificate that does not come from the backend."""

from __future__ import annotations

from dataclasses import dataclass

from cvxshear.backends.certificate import Certificate
from cvxshear.util.typing import Floats


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
    seconds: float = 0.0
