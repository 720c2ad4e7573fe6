"""What every backend is, and what is done around each of them: scaling, certificate, refusal."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from cvxshear.backends.canonical import Canonical, canonical
from cvxshear.backends.solution import Certificate, Solution
from cvxshear.errors import NoSolutionError
from cvxshear.programs import LeastSquares
from cvxshear.typing import Floats

ACCEPTED = 1e-6
"""Largest residual of a certificate with which a solution is let through."""

FAR = 1e3
"""An inequality whose slack at zero is greater than this, in scaled units, is moved in to it for the solve."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A solver's answer to a scaled program, before anybody has checked it.

    Parameters
    ----------
    z : ndarray, shape (n,)
    y : ndarray, shape (a,)
        Multipliers of E z = e.
    w : ndarray, shape (g,)
        Multipliers of F z <= f.
    status : str
    iterations : int or None
    """

    z: Floats
    y: Floats
    w: Floats
    status: str
    iterations: int | None


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

    def solve(self, program: LeastSquares) -> Solution:
        """Solve a program, and certify the solution.

        Parameters
        ----------
        program : LeastSquares

        Returns
        -------
        Solution

        Raises
        ------
        InfeasibleError
            Where equalities contradict each other.
        UnsuitableError
            Where the backend cannot take such a program.
        NoSolutionError
            Where the solver failed, or the certificate's worst residual exceeds `ACCEPTED`.
        """
        start = time.perf_counter()
        problem = canonical(program)
        answer = self._answer_near(problem)
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
            time.perf_counter() - start,
        )  # fmt: skip

    def _answer_near(self, problem: Canonical) -> Answer:
        """The answer, with inequalities that are far from active moved in so that they do not spoil the scaling."""
        limit = FAR
        while True:
            near = Canonical(**{**problem.__dict__, "f": np.minimum(problem.f, limit)})
            answer = self.answer(near)
            far = problem.f > limit
            if not np.any(far & (problem.F @ answer.z > 0.5 * limit)):
                # Far inequalities are inactive: their multipliers are zero, not the rounding that a solver returns.
                return dataclasses.replace(answer, w=np.where(far, 0.0, answer.w))
            limit *= FAR


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
