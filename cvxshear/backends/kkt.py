"""The closed form: LAPACK's equality-constrained least squares, the solution of Eq. 14 without its normal matrix."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from cvxshear.backends.base import Answer, Backend
from cvxshear.backends.canonical import Canonical
from cvxshear.errors import NoSolutionError, UnsuitableError
from cvxshear.typing import Floats

TOUCHING = 1e-9
"""Violation of an inequality, in scaled units, that still counts as rounding."""


class Kkt(Backend):
    """minimize |C z - q|^2 subject to E z = e, by the generalized QR factorization (xGGLSE).

    Inequalities are looked at afterwards: a solution that keeps them all is also the solution of the program
    with them, its multipliers zero. Where one is violated this backend refuses.
    """

    name = "kkt"

    def answer(self, problem: Canonical) -> Answer:
        if problem.singular:
            raise NoSolutionError(self.name, "the data and the equalities do not determine every unknown")
        z = problem.q.copy() if not len(problem.E) else _equality_constrained(problem)
        excess = problem.F @ z - problem.f
        if np.any(excess > TOUCHING):
            raise UnsuitableError(
                "backend kkt: a bound or another inequality is active at the solution, and the closed form takes "
                "equalities only; choose another backend, clarabel for one"
            )
        gradient = problem.C.T @ (problem.C @ z - problem.q)
        y = np.asarray(np.linalg.lstsq(problem.E.T, -gradient, rcond=None)[0]) if len(problem.E) else np.zeros(0)
        return Answer(z, y, np.zeros(len(problem.f)), "closed form", 1)


def _equality_constrained(problem: Canonical) -> Floats:
    *_, z, info = lapack.dgglse(problem.C, problem.E, problem.q, problem.e)
    if info != 0:
        raise NoSolutionError("kkt", f"LAPACK dgglse ended with info = {info}: the constraints are not independent")
    result: Floats = z
    return result
