"""The closed form: equality-constrained least squares, the solution of Eq. 14 without its normal matrix."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from cvxshear.backends.base import Answer, Backend
from cvxshear.backends.canonical import Canonical
from cvxshear.errors import NoSolutionError, UnsuitableError
from cvxshear.typing import Floats

TOUCHING = 1e-9
"""Violation of an inequality, in scaled units, that still counts as rounding."""


class Kkt(Backend):
    """minimize |C z - q|^2 subject to E z = e, in closed form.

    C is the identity once the rows are factorized, which leaves the nearest point to q on a plane: the generalized
    QR factorization of LAPACK's xGGLSE, its first half done in `canonical`.

    Inequalities are looked at afterwards: a solution that keeps them all is also the solution of the program
    with them, its multipliers zero. Where one is violated this backend refuses.
    """

    name = "kkt"

    def answer(self, problem: Canonical) -> Answer:
        if problem.singular:
            raise NoSolutionError(self.name, "the data and the equalities do not determine every unknown")
        z, y = _nearest(problem)
        excess = problem.F @ z - problem.f
        if np.any(excess > TOUCHING):
            raise UnsuitableError(
                "backend kkt: a bound or another inequality is active at the solution, and the closed form takes "
                "equalities only; choose another backend, clarabel for one"
            )
        return Answer(z, y, np.zeros(len(problem.f)), "closed form", 1)


def _nearest(problem: Canonical) -> tuple[Floats, Floats]:
    """The nearest point to q on E z = e, and the multipliers: with E' = B T, q - z = B T'^-1 (E q - e) = E' y."""
    if not len(problem.E):
        return problem.q.copy(), np.zeros(0)
    B, T = np.linalg.qr(problem.E.T)
    along = linalg.solve_triangular(T, problem.E @ problem.q - problem.e, trans="T")
    return problem.q - B @ along, linalg.solve_triangular(T, along)
