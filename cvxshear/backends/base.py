"""What every backend is, and what is done around each of them: scaling, certificate, refusal."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod

import numpy as np

from cvxshear.backends import working_set
from cvxshear.backends.active_set import UndeterminedError, UnsettledError, minimizer
from cvxshear.backends.canonical import Answer, Canonical, canonical
from cvxshear.backends.certificate import Assembled, Certificate, Point, certify, largest_relative
from cvxshear.backends.solution import Solution
from cvxshear.errors import NoSolutionError
from cvxshear.programs import LeastSquares

ACCEPTED = 1e-6
"""Largest residual of a certificate with which a solution is let through."""

ACCURATE = 1e-6
"""Error of an unknown, relative to its size, above which the exact minimizer takes the answer's place."""


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

    def answer_all(self, problem: Canonical, start: Solution | None = None) -> Answer:
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
            Of an error bound of at most `ACCURATE`, or of what 64 bits allow: an answer that is farther off is
            replaced by the minimizer on the inequalities that hold it.

        Raises
        ------
        InfeasibleError
            Where equalities contradict each other.
        InputError
            Where `start` has another shape.
        UnsuitableError
            Where the backend cannot take such a program.
        NoSolutionError
            Where the solver failed, the certificate's worst residual exceeds `ACCEPTED`, or the inequalities that hold
            the answer cannot be told.
        """
        began = time.perf_counter()
        problem = canonical(program)
        if start is not None:
            problem.refuse_start(start)
        found = self.certified(Assembled(program), problem, start)
        return dataclasses.replace(found, seconds=time.perf_counter() - began)

    def certified(self, of: Assembled, problem: Canonical, start: Solution | None = None) -> Solution:
        """Solve a program that is scaled already; as `solve`, the time not taken.

        Parameters
        ----------
        of : Assembled
            The program as it was handed in, by which the answer is judged.
        problem : Canonical
            The same, scaled.
        start : Solution, optional
        """
        answer = self.answer_all(problem, start)
        point = Point(problem.to_x(answer.z), *problem.multipliers(answer.y, answer.w))
        certificate = certify(of, point)
        if not certificate.worst <= ACCEPTED:
            raise NoSolutionError(
                self.name,
                f"inaccurate solution (its own status: {answer.status}): primal residual "
                f"{certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
                f"{certificate.duality_gap:.1e}, accepted {ACCEPTED:.0e}",
            )
        try:
            point, certificate = accurate(of, point, certificate)
        except UnsettledError:
            raise NoSolutionError(
                self.name,
                f"inaccurate solution (its own status: {answer.status}): which inequalities hold it cannot be told, "
                "and so not how far off it is",
            ) from None
        return Solution(point.x, point.y, point.w, certificate, self.name, answer.status, answer.iterations)


def accurate(of: Assembled, point: Point, certificate: Certificate) -> tuple[Point, Certificate]:
    """The answer with a bound on its error, or the exact minimizer where that is too large.

    Parameters
    ----------
    of : Assembled
    point : Point
        Of residuals that are accepted.
    certificate : Certificate
        These residuals.

    Raises
    ------
    UnsettledError
    """
    try:
        exact = minimizer(of, point)
    except UndeterminedError:
        return point, certificate
    error, size = np.abs(exact.point.x - point.x) + exact.rounding, of.size(exact.point.x)
    if np.any(error > ACCURATE * size + 2.0 * exact.rounding):
        point, error, certificate = exact.point, exact.rounding, certify(of, exact.point)
        if not certificate.worst <= ACCEPTED:
            raise UnsettledError
    return point, dataclasses.replace(certificate, error_bound=largest_relative(error, size))
