"""The base class of every backend: scaling, working set of inequalities, check of the answer, acceptance.

A frame of N stories has at least N bounds, few of them active. Scaling makes every bound a full row; all of them would
cost an interior-point method N^3 operations per iteration, and far bounds spoil the scaling of a first-order method. So
the solver gets the inequalities that the closed form without any violates. As long as its answer violates others, these
are added. The set only grows, so this ends, and an answer that satisfies all inequalities is the answer to the whole
program.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cvxshear.backends.canonical import Answer, Canonical, canonical
from cvxshear.backends.minimizer import Minimizer, UndeterminedError, UnsettledError, minimizer
from cvxshear.programs import Acceptance, Certificate, LeastSquares, Solution
from cvxshear.programs.certificate import Assembled, Point, certify, largest_relative
from cvxshear.util import checks
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError, UnsuitableError
from cvxshear.util.typing import Floats

#: Largest slack at zero, in scaled units, of an inequality that is solved as it is: far right sides cost digits.
FAR_SLACK = 1e3


@dataclass(frozen=True)
class Tolerances:
    """Largest residuals and errors of an accepted solution.

    Parameters
    ----------
    optimality : float
        Dual residual and duality gap. First-order methods reach it.
    violation : float
        Violation of a constraint, relative to the sizes of its terms: exact statements hold to nine digits.
    error : float
        Error of an unknown, relative to its size. Above it, the closed form takes the answer's place.
    error_in_deviations : float
        Error of an unknown that is tolerated all the same, in standard deviations from the residual of the rows.
    """

    optimality: float = 1e-6
    violation: float = 1e-9
    error: float = 1e-6
    error_in_deviations: float = 1e-3


TOLERANCES = Tolerances()


class InaccurateError(Exception):
    """An answer with a bad certificate; the message names the figure."""


class IllConditionedError(Exception):
    """A program whose minimizer cannot be determined in 64 bits; the message names the unknown and its error."""


@dataclass(frozen=True, eq=False)
class Accepted:
    """An answer that is accurate, or the closed form in its place.

    Parameters
    ----------
    point : Point
    certificate : Certificate
    acceptance : Acceptance
    reason : str
        Why the closed form took the answer's place; empty if it did not.
    """

    point: Point
    certificate: Certificate
    acceptance: Acceptance = Acceptance.AS_GIVEN
    reason: str = ""


def accurate(program: Assembled, point: Point, *, bounded: bool = True) -> Accepted:
    """Certify an answer, or the closed form on its active constraints if the answer is not accurate.

    An answer with a large gradient or gap is refused. One that violates a constraint is replaced only if the rows
    hardly distinguish it from the closed form.

    Parameters
    ----------
    program : Assembled
    point : Point
    bounded : bool, optional
        Whether an answer that meets every condition to nine digits needs a bound on the error of its unknowns, too.

    Raises
    ------
    InaccurateError
        If the answer is wrong.
    IllConditionedError
        If no answer in 64 bits can be right.
    """
    certificate = certify(program, point)
    if not max(certificate.dual_residual, certificate.duality_gap) <= TOLERANCES.optimality:
        raise _inaccurate(certificate)
    met = certificate.primal_residual <= TOLERANCES.violation
    if not bounded and certificate.worst <= TOLERANCES.violation:
        return Accepted(point, certificate)
    try:
        exact = minimizer(program, point)
    except UndeterminedError:
        if not certificate.primal_residual <= TOLERANCES.optimality:
            raise _inaccurate(certificate) from None
        raise IllConditionedError(
            "too ill-conditioned to tell: the data and the active constraints leave a direction open, along which the "
            "unknowns could lie anywhere; declare more of them, or measure more"
        ) from None
    except UnsettledError:
        raise InaccurateError("the active inequalities cannot be determined, so the error is not bounded") from None
    size = program.size(exact.point.x)
    _refuse_ill_conditioned(program, exact, size)
    errors = np.abs(exact.point.x - point.x) + exact.errors
    if not met and not program.distance(point.x, exact.point.x) <= TOLERANCES.optimality:
        raise _inaccurate(certificate)
    found = Accepted(point, certificate)
    # Relative to the unknown alone, so that small unknowns among large ones are accurate, too.
    if not met or np.any(errors > TOLERANCES.error * np.abs(exact.point.x) + 2.0 * exact.errors):
        nearer = certify(program, exact.point)
        if nearer.worst <= TOLERANCES.optimality and nearer.primal_residual <= TOLERANCES.violation:
            off = f"is off by up to {largest_relative(errors, size):.1e} of an unknown, accepted {TOLERANCES.error:.0e}"
            why = off if met else f"did not pass: {_inaccurate(certificate)}"
            reason = f"its answer {why}; the closed form on its active constraints took its place"
            found = Accepted(exact.point, nearer, Acceptance.POLISHED if met else Acceptance.REPLACED, reason)
            errors = exact.errors
        elif not met or np.any(errors > TOLERANCES.error * size + 2.0 * exact.errors):
            raise _inaccurate(nearer)
        # Else the answer is accurate for its size; the last digits of the closed form are rounding in heavy rows.
    bound = largest_relative(errors, size)
    return replace(found, certificate=replace(found.certificate, error_bound=bound, errors=errors))


def _refuse_ill_conditioned(program: Assembled, exact: Minimizer, size: Floats) -> None:
    """Raise if rounding alone can make an unknown useless."""
    tolerable = TOLERANCES.error * size + TOLERANCES.error_in_deviations * exact.deviations
    beyond = ~(exact.errors <= tolerable)
    if np.any(beyond):
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(beyond, exact.errors / size, 0.0)
        worst = int(np.argmax(np.where(np.isnan(relative), np.inf, relative)))
        raise IllConditionedError(
            f"too ill-conditioned to tell: in 64 bits {program.names[worst]} could be off by {relative[worst]:.1e} of "
            f"its size, accepted {TOLERANCES.error:.0e}"
        )


def _inaccurate(certificate: Certificate) -> InaccurateError:
    return InaccurateError(
        f"primal residual {certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
        f"{certificate.duality_gap:.1e}, accepted {TOLERANCES.violation:.0e}, {TOLERANCES.optimality:.0e} and "
        f"{TOLERANCES.optimality:.0e}"
    )


#: Solvers of semidefinite programs that cvxpy brings along.
CONIC = ("clarabel", "scs")


def onto_equalities(problem: Canonical, answer: Answer) -> Answer:
    """Move an answer to the nearest point on the equalities, and its multipliers to the nearest of the right sign."""
    z = answer.z - np.linalg.pinv(problem.E) @ (problem.E @ answer.z - problem.e)
    matrices = []
    for dual in answer.matrices:
        values, vectors = np.linalg.eigh(0.5 * (dual + dual.T))
        matrices.append((vectors * np.maximum(values, 0.0)) @ vectors.T)
    return replace(answer, z=z, w=np.maximum(answer.w, 0.0), matrices=tuple(matrices))


def distance(problem: Canonical, answer: Answer) -> float:
    r"""Bound the distance of an answer from the minimizer z* of a regular program, by strong convexity.

    The multipliers have the right signs. With g the gradient of the Lagrangian L at z and v the violations of the
    constraints times their multipliers,

    .. math:: |z - z^*|^2 / 2 \le f(z) - L(z) + v + |g| |z - z^*|.
    """
    z, slack = answer.z, problem.f - problem.F @ answer.z
    gradient = z - problem.q + problem.E.T @ answer.y + problem.F.T @ answer.w
    gap = float(answer.w @ np.maximum(slack, 0.0) - answer.y @ (problem.E @ z - problem.e))
    for each, dual in zip(problem.lmi, answer.matrices, strict=True):
        gradient = gradient - each.products(dual)
        value = each.at(z)
        lowest = float(np.linalg.eigvalsh(value)[0])
        gap += float(np.sum(dual * value)) + float(np.trace(dual)) * max(-lowest, 0.0)
    steep = float(np.linalg.norm(gradient))
    return steep + float(np.sqrt(steep**2 + 2.0 * max(gap, 0.0)))


class Backend(ABC):
    """A solver of least-squares programs.

    A new backend implements `answer` for the scaled program and is registered by `backends.register`.

    Attributes
    ----------
    name : str
    """

    name: str

    @property
    def tolerance(self) -> float | None:
        """Loosest requested accuracy of the solver; None if the solver has no such option."""
        return None

    def with_tolerance(self, tolerance: float) -> Backend:
        """Return the same backend with this accuracy, or itself if it takes none."""
        return self

    def with_options(self, options: Mapping[str, Any]) -> Backend:
        """Return the same backend with further options of its solver.

        Raises
        ------
        InputError
            If the backend takes no options.
        """
        if options:
            raise InputError(f"backend {self.name} takes no options; it was given {', '.join(options)}")
        return self

    @abstractmethod
    def answer(self, problem: Canonical) -> Answer:
        """Solve the scaled program.

        Raises
        ------
        NoSolutionError
            With the solver's reason, if it did not solve the program.
        """

    def solve(self, program: LeastSquares, *, bounded: bool = True) -> Solution:
        """Solve a program and certify the solution.

        Parameters
        ----------
        program : LeastSquares
        bounded : bool, optional
            Whether the error of each unknown is bounded. An iteration that certifies its last point needs no bounds on
            its steps.

        Returns
        -------
        Solution
            It satisfies every constraint. If `bounded`, each unknown is within `Certificate.errors` of the exact
            minimizer.

        Raises
        ------
        InfeasibleError
            If equalities contradict each other.
        InputError
            If the backend's answer has the wrong form.
        UnsuitableError
            If the backend cannot take such a program.
        NoSolutionError
            If the solver fails, its answer does not pass the certificate, or the program is too ill-conditioned for
            64 bits.
        """
        began = time.perf_counter()
        assembled, problem = Assembled(program), canonical(program)
        if program.lmi:
            found = self.semidefinite(assembled, problem)
        else:
            found = self.certified(assembled, problem, bounded=bounded)
        return replace(found, seconds=time.perf_counter() - began)

    def certified(self, program: Assembled, problem: Canonical, *, bounded: bool = True) -> Solution:
        """Solve a program that is already scaled, and certify the solution.

        Parameters
        ----------
        program : Assembled
            The program as stated; it judges the answer.
        problem : Canonical
            The same program, scaled.
        bounded : bool, optional
        """
        answer = self.answer_all(problem)
        point = problem.point(answer)
        try:
            accepted = accurate(program, point, bounded=bounded)
        except InaccurateError as error:
            status = f"its own status: {answer.status}"
            raise NoSolutionError(self.name, f"inaccurate solution ({status}): {error}") from None
        except IllConditionedError as error:
            raise NoSolutionError(self.name, str(error)) from None
        return Solution(
            program.program,
            accepted.point,
            accepted.certificate,
            requested=self.name,
            backend="kkt" if accepted.reason else self.name,
            replaced=f"{self.name}: {accepted.reason}" if accepted.reason else None,
            acceptance=accepted.acceptance,
            status=answer.status,
            iterations=answer.iterations,
        )

    def semidefinite(self, program: Assembled, problem: Canonical) -> Solution:
        """Solve a program with matrix inequalities: without them, and with them if one is violated.

        The first solution, if it violates none, is the solution of the whole program, and its dual matrices are zero.
        """
        if not problem.singular:
            plain = program.program.replace(lmi=())
            try:
                found = self.certified(Assembled(plain), replace(problem, lmi=()))
            except NoSolutionError:
                # Only the matrix inequalities hold some direction well enough.
                return self.conic(program, problem)
            certificate = certify(program, found.point)
            if certificate.primal_residual <= TOLERANCES.violation:
                bound = found.certificate.error_bound
                certificate = replace(certificate, error_bound=bound, errors=found.errors)
                return replace(found, program=program.program, certificate=certificate)
        return self.conic(program, problem)

    def conic(self, program: Assembled, problem: Canonical) -> Solution:
        """Solve a program whose matrix inequalities hold its solution, and certify the solution."""
        answer = onto_equalities(problem, self._checked(problem))
        point = problem.point(answer)
        certificate = certify(program, point)
        if not certificate.worst <= TOLERANCES.optimality:
            raise NoSolutionError(self.name, f"inaccurate solution: {_inaccurate(certificate)}")
        if not problem.singular:
            errors = problem.reach(distance(problem, answer))
            bound = largest_relative(errors, program.size(point.x))
            certificate = replace(certificate, error_bound=bound, errors=errors)
        return Solution(
            program.program, point, certificate, requested=self.name, backend=self.name, status=answer.status,
            iterations=answer.iterations,
        )  # fmt: skip

    def answer_conic(self, problem: Canonical) -> Answer:
        """Solve the scaled program with its matrix inequalities.

        Raises
        ------
        UnsuitableError
            If the solver takes none.
        """
        raise UnsuitableError(
            f"backend {self.name}: a matrix inequality holds the solution, and this solver takes none; "
            f"{' and '.join(CONIC)} do"
        )

    def answer_all(self, problem: Canonical) -> Answer:
        """Solve the scaled program, with a working set of its inequalities.

        Parameters
        ----------
        problem : Canonical

        Returns
        -------
        Answer
            Its multipliers are zero for inequalities outside the working set.
        """
        if problem.singular:
            return self._with_all(problem)
        within = problem.violated(problem.nearest()[0])
        iterations: int | None = 0
        while True:
            part = self._checked(replace(problem, F=problem.F[within], f=problem.f[within]))
            iterations = None if iterations is None or part.iterations is None else iterations + part.iterations
            missed = problem.violated(part.z) & ~within
            if not np.any(missed):
                w = np.zeros(len(within))
                w[within] = part.w
                return replace(part, w=w, iterations=iterations)
            within |= missed

    def _with_all(self, problem: Canonical) -> Answer:
        """Solve with every inequality, if only these determine some direction; far inequalities are moved closer."""
        limit = FAR_SLACK
        while True:
            answer = self._checked(replace(problem, f=np.minimum(problem.f, limit)))
            far = problem.f > limit
            if not np.any(far & (problem.F @ answer.z > 0.5 * limit)):
                # Far inequalities are inactive; the solver's multipliers of them are rounding.
                return replace(answer, w=np.where(far, 0.0, answer.w))
            limit *= FAR_SLACK

    def _checked(self, problem: Canonical) -> Answer:
        """Ask the backend, and refuse an answer of a wrong type, shape or value."""
        try:
            answer: object = self.answer_conic(problem) if problem.lmi else self.answer(problem)
        except CvxshearError:
            raise
        except Exception as error:
            # A solver, or a user's own backend, may raise anything.
            raise NoSolutionError(self.name, f"answer() raised {type(error).__name__}: {error}") from error
        if not isinstance(answer, Answer):
            raise InputError(
                f"backend {self.name}: answer() must return a cvxshear.backends.Answer, not {checks.shown(answer)}"
            )
        checked = {}
        for name, length in (("z", len(problem.q)), ("y", len(problem.e)), ("w", len(problem.f))):
            where = f"backend {self.name}: {name} of its answer"
            values = checked[name] = checks.real(getattr(answer, name), where)
            if values.shape != (length,):
                raise InputError(f"{where} must have the shape ({length},), not {values.shape}")
            if not np.all(np.isfinite(values)):
                first = values[~np.isfinite(values)][0]
                raise NoSolutionError(self.name, f"its answer holds {first} (its own status: {answer.status})")
        return replace(answer, z=checked["z"], y=checked["y"], w=checked["w"])


class SolvedProgram(NamedTuple):
    """A program and its solution."""

    program: LeastSquares
    solution: Solution


class Recorder(Backend):
    """A backend that keeps every program that another one solves, with its solution, in order.

    Parameters
    ----------
    backend : Backend

    Attributes
    ----------
    solved : list of SolvedProgram
    """

    def __init__(self, backend: Backend) -> None:
        self.name, self._backend = backend.name, backend
        self.solved: list[SolvedProgram] = []

    def answer(self, problem: Canonical) -> Answer:
        return self._backend.answer(problem)

    def solve(self, program: LeastSquares, *, bounded: bool = True) -> Solution:
        solution = self._backend.solve(program, bounded=bounded)
        self.solved.append(SolvedProgram(program, solution))
        return solution
