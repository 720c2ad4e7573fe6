"""The closed form: equality-constrained least squares, the solution of Eq. 14 without its normal matrix."""

from __future__ import annotations

import numpy as np

from cvxshear.backends.base import Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.nearest import nearest
from cvxshear.backends.solution import Solution
from cvxshear.util.errors import NoSolutionError, UnsuitableError


class Kkt(Backend):
    """minimize |C z - q|^2 subject to E z = e, in closed form.

    C is the identity once the rows are factorized, which leaves the nearest point to q on a plane: the generalized
    QR factorization of LAPACK's xGGLSE, its first half done in `canonical`.

    Inequalities are looked at afterwards: a solution that keeps them all is also the solution of the program
    with them, its multipliers zero. Where one is violated this backend refuses.
    """

    name = "kkt"

    def answer_all(self, problem: Canonical, start: Solution | None = None) -> Answer:
        return self.answer(problem)

    def answer(self, problem: Canonical) -> Answer:
        if problem.singular:
            raise NoSolutionError(self.name, "the data and the equalities do not determine every unknown")
        z, y = nearest(problem)
        if np.any(problem.violated(z)):
            raise UnsuitableError(
                "backend kkt: a bound or another inequality is active at the solution, and the closed form takes "
                "equalities only; choose another backend, clarabel for one"
            )
        return Answer(z, y, np.zeros(len(problem.f)), "closed form", 1)
