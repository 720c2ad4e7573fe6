"""What every backend is, and what is done around each of them: scaling, certificate, refusal."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

import numpy as np

from cvxshear.backends import working_set
from cvxshear.backends.canonical import Answer, Canonical, canonical
from cvxshear.backends.solution import Certificate, Solution
from cvxshear.errors import NoSolutionError
from cvxshear.programs import LeastSquares

ACCEPTED = 1e-6
"""Largest residual of a certificate with which a solution is let through."""


class Backend(ABC):
    """A solver of least-squares programs.

    A new one implements `answer` for the scaled program and is made known by `backends.register`.

    Attributes
    ----------
    name : str
    """

    name: str

    @abstractmethod
    def answer(self, problem: Canonical) -> Answer:
        """Solve the scaled program.

        Raises
        ------
        NoSolutionError
            With the solver's reason, where it did not solve it.
        """

    def whole_answer(self, problem: Canonical, start: Solution | None = None) -> Answer:
        """Solve the scaled program, `answer` seeing the inequalities that matter alone (`working_set`)."""
        return working_set.answered(self.answer, problem.starting_at(start))

    def solve(self, program: LeastSquares, start: Solution | None = None) -> Solution:
        """Solve a program, and certify the solution.

        Parameters
        ----------
        program : LeastSquares
        start : Solution, optional
            Of a program like this one, of the same shape. The inequalities that held it are handed to the solver at
            once, and a solver that can begin at a point begins at this one.

        Returns
        -------
        Solution

        Raises
        ------
        InfeasibleError
            Where equalities contradict each other.
        InputError
            Where `start` has another shape.
        UnsuitableError
            Where the backend cannot take such a program.
        NoSolutionError
            Where the solver failed, or the certificate's worst residual exceeds `ACCEPTED`.
        """
        began = time.perf_counter()
        problem = canonical(program)
        if start is not None:
            problem.refuse_start(start)
        answer = self.whole_answer(problem, start)
        certificate = certify(problem, answer)
        if not certificate.worst <= ACCEPTED:
            raise NoSolutionError(
                self.name,
                f"inaccurate solution (its own status: {answer.status}): primal residual "
                f"{certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
                f"{certificate.duality_gap:.1e}, accepted {ACCEPTED:.0e}",
            )
        y, w = problem.multipliers(answer.y, answer.w)
        return Solution(
            problem.to_x(answer.z), y, w, certificate, self.name, answer.status, answer.iterations,
            time.perf_counter() - began,
        )  # fmt: skip


def certify(problem: Canonical, answer: Answer) -> Certificate:
    """The residuals of the optimality conditions of a scaled program at an answer."""
    z, y, w = answer.z, answer.y, answer.w
    error = problem.C @ z - problem.q
    gradient = problem.C.T @ error + problem.E.T @ y + problem.F.T @ w
    equality = problem.E @ z - problem.e
    slack = problem.f - problem.F @ z
    # At a point where the Lagrangian's gradient vanishes the dual objective is the Lagrangian itself, so the
    # gap is what the constraints contribute to it.
    gap = abs(float(w @ slack) - float(y @ equality))
    return Certificate(
        primal_residual=float(max(np.max(np.abs(equality), initial=0.0), np.max(-slack, initial=0.0))),
        dual_residual=float(max(np.max(np.abs(gradient), initial=0.0), np.max(-w, initial=0.0))),
        duality_gap=gap,
    )
