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
from cvxshear.programs import LeastSquares
from cvxshear.util.errors import NoSolutionError

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

    @property
    def tolerance(self) -> float | None:
        """The loosest accuracy that the solver is told to reach; None where it takes none."""
        return None

    def with_tolerance(self, tolerance: float) -> Backend:
        """The same backend, told to reach this accuracy; itself where it takes none."""
        return self

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
            Where the solver failed, or its answer's certificate is not good enough (see `accurate`).
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
        try:
            point, certificate = accurate(of, point)
        except InaccurateError as error:
            raise NoSolutionError(
                self.name, f"inaccurate solution (its own status: {answer.status}): {error}"
            ) from None
        return Solution(point.x, point.y, point.w, certificate, self.name, answer.status, answer.iterations)


class InaccurateError(Exception):
    """An answer whose certificate is not good enough; the message says which figure is not."""


def accurate(of: Assembled, point: Point) -> tuple[Point, Certificate]:
    """An answer with its certificate, or the exact minimizer beside it where it is not accurate enough.

    The minimizer takes an answer's place that is wrong in ways that the data do not see, not one that is plainly wrong:
    its gradient and its gap must be good, and where it violates a constraint the rows must hardly tell the two apart.

    Parameters
    ----------
    of : Assembled
    point : Point

    Raises
    ------
    InaccurateError
    """
    certificate = certify(of, point)
    if not max(certificate.dual_residual, certificate.duality_gap) <= ACCEPTED:
        raise _inaccurate(certificate)
    kept = certificate.primal_residual <= ACCEPTED
    try:
        exact = minimizer(of, point)
    except UndeterminedError:
        if not kept:
            raise _inaccurate(certificate) from None
        return point, certificate
    except UnsettledError:
        raise InaccurateError("which inequalities hold it cannot be told, and so not how far off it is") from None
    error, size = np.abs(exact.point.x - point.x) + exact.rounding, of.size(exact.point.x)
    if not kept and not of.distance(point.x, exact.point.x) <= ACCEPTED:
        raise _inaccurate(certificate)
    if not kept or np.any(error > ACCURATE * size + 2.0 * exact.rounding):
        point, error, certificate = exact.point, exact.rounding, certify(of, exact.point)
        if not certificate.worst <= ACCEPTED:
            raise _inaccurate(certificate)
    return point, dataclasses.replace(certificate, error_bound=largest_relative(error, size))


def _inaccurate(certificate: Certificate) -> InaccurateError:
    return InaccurateError(
        f"primal residual {certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
        f"{certificate.duality_gap:.1e}, accepted {ACCEPTED:.0e}"
    )
