"""What every backend is, and what is done around each of them: scaling, checks of its answer, certificate, refusal.

Inequalities are handed to a solver as they turn out to matter. A frame of N stories has at least N bounds, of which a
few are active. Scaling makes every bound a full row: all of them would cost an interior-point method N^3 operations
an iteration, and those that are far from active would spoil the scaling of a first-order method. So the solver gets
the inequalities that the closed form without any violates, or that an earlier solution was on; then, with its answer,
those that this one violates, until there are none. The set only grows, so that it ends; an answer to fewer
inequalities that meets all of them is the answer to all.
"""

from __future__ import annotations

import contextvars
import dataclasses
import threading
import time
import weakref
from abc import ABC, abstractmethod

import numpy as np

from cvxshear.backends.canonical import Answer, Canonical, canonical
from cvxshear.backends.certificate import Assembled, Certificate, Point, Solution, certify, largest_relative
from cvxshear.backends.minimizer import Minimizer, UndeterminedError, UnsettledError, minimizer
from cvxshear.programs import LeastSquares
from cvxshear.util import checks
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError
from cvxshear.util.typing import Floats

ACCEPTED = 1e-6
"""Largest dual residual and duality gap of a solution that is accepted: first-order methods reach it, and what is left
of an error is measured and mended by `cvxshear.backends.minimizer`."""

NEARLY = 1e-5
"""Largest dual residual and duality gap of an answer in whose place the exact minimizer may stand: ten times what is
accepted, as a program that is scaled badly leaves a sound solver there; the minimizer itself must be accepted."""

MET = 1e-9
"""Largest accepted violation of a constraint, relative to the sizes of its terms: exact statements hold to 9 digits."""

ACCURATE = 1e-6
"""Error of an unknown, relative to its size, above which the exact minimizer takes the answer's place, and above which
no answer is accepted unless the data's own residual leaves the unknown far more uncertain."""

IMMATERIAL = 1e-3
"""Error of an unknown that matters to nobody, in standard deviations that the rows' residual gives it."""

TIME_LIMIT = 60.0
"""Seconds after which a solver is given up: programs of this size that take longer do not end (HiGHS has cycled)."""

FAR_SLACK = 1e3
"""Slack at zero, in scaled units, above which an inequality is moved in for a solve: far right sides cost digits."""


class Backend(ABC):
    """A solver of least-squares programs.

    A new one implements `answer` for the scaled program and is made known by `backends.register`.

    Attributes
    ----------
    name : str
    time_limit : float or None
        Seconds after which a call of `answer` is given up; None for a backend that limits itself.
    """

    name: str
    time_limit: float | None = TIME_LIMIT

    @property
    def tolerance(self) -> float | None:
        """The loosest accuracy that the solver is asked for; None where it takes none."""
        return None

    def with_tolerance(self, tolerance: float) -> Backend:
        """Return the same backend asked for this accuracy, itself where it takes none."""
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
        """Solve the scaled program, `answer` seeing the inequalities that matter alone.

        Parameters
        ----------
        problem : Canonical
        start : Solution, optional

        Returns
        -------
        Answer
            Its multipliers zero for inequalities that did not matter.
        """
        problem = problem.starting_at(start)
        if not len(problem.F):
            return self._checked(problem)
        if problem.singular:
            return self._with_all(problem)
        within = problem.violated(problem.nearest()[0])
        if problem.start is not None:
            within |= problem.start.w > 0
        iterations: int | None = 0
        while True:
            part = self._checked(problem.keeping(within))
            iterations = None if iterations is None or part.iterations is None else iterations + part.iterations
            missed = problem.violated(part.z) & ~within
            if not np.any(missed):
                w = np.zeros(len(within))
                w[within] = part.w
                return dataclasses.replace(part, w=w, iterations=iterations)
            within |= missed

    def _with_all(self, problem: Canonical) -> Answer:
        """Solve with every inequality, where only they determine some direction; far ones are moved in."""
        limit = FAR_SLACK
        while True:
            answer = self._checked(dataclasses.replace(problem, f=np.minimum(problem.f, limit)))
            far = problem.f > limit
            if not np.any(far & (problem.F @ answer.z > 0.5 * limit)):
                # Far inequalities are inactive: their multipliers are zero, not the rounding that a solver returns.
                return dataclasses.replace(answer, w=np.where(far, 0.0, answer.w))
            limit *= FAR_SLACK

    def _checked(self, problem: Canonical) -> Answer:
        """Ask the backend within the time limit, and refuse an answer of a wrong type, wrong lengths or no numbers."""
        answer = self.answer(problem) if self.time_limit is None else _limited(self, problem, self.time_limit)
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
        return dataclasses.replace(answer, z=checked["z"], y=checked["y"], w=checked["w"])

    def solve(self, program: LeastSquares, start: Solution | None = None) -> Solution:
        """Solve a program, and certify the solution.

        Parameters
        ----------
        program : LeastSquares
        start : Solution, optional
            Of a program like this one, of the same shape. The inequalities that it is on are handed to the solver at
            once, and a solver that can begin at a point begins at this one.

        Returns
        -------
        Solution
            Every constraint met to `MET`, every unknown within `Solution.errors` of the exact minimizer: an answer
            that is farther off than `ACCURATE` is replaced by the minimizer on the inequalities that are active.

        Raises
        ------
        InfeasibleError
            Where equalities contradict each other.
        InputError
            Where `start` has another shape, or a backend's answer is no answer.
        UnsuitableError
            Where the backend cannot take such a program.
        NoSolutionError
            Where the solver failed, its answer's certificate is not good enough (see `accurate`), or the program is
            too ill-conditioned for any answer in 64 bits.
        """
        began = time.perf_counter()
        problem = canonical(program)
        if start is not None:
            problem.refuse_start(start)
        found = self.certified(Assembled(program), problem, start)
        return dataclasses.replace(found, seconds=time.perf_counter() - began)

    def certified(self, program: Assembled, problem: Canonical, start: Solution | None = None) -> Solution:
        """Solve a program that is scaled already; as `solve`, the time not taken.

        Parameters
        ----------
        program : Assembled
            The program as it was handed in, by which the answer is judged.
        problem : Canonical
            The same, scaled.
        start : Solution, optional
        """
        answer = self.answer_all(problem, start)
        point = Point(problem.to_x(answer.z), *problem.multipliers(answer.y, answer.w))
        try:
            point, certificate, errors = accurate(program, point)
        except InaccurateError as error:
            raise NoSolutionError(
                self.name, f"inaccurate solution (its own status: {answer.status}): {error}"
            ) from None
        except IllConditionedError as error:
            raise NoSolutionError(self.name, str(error)) from None
        return Solution(point.x, point.y, point.w, errors, certificate, self.name, answer.status, answer.iterations)


class InaccurateError(Exception):
    """An answer whose certificate is not good enough; the message says which figure is not."""


class IllConditionedError(Exception):
    """A program whose minimizer nobody can tell in 64 bits; the message says which unknown, and how far off it is."""


def accurate(program: Assembled, point: Point) -> tuple[Point, Certificate, Floats]:
    """Certify an answer, or the exact minimizer beside it where the answer is not accurate enough.

    The minimizer takes an answer's place that is wrong in ways that the data do not see, not one that is plainly wrong:
    its gradient and its gap must be good, and where it violates a constraint the rows must hardly tell the two apart.

    Parameters
    ----------
    program : Assembled
    point : Point

    Returns
    -------
    point : Point
    certificate : Certificate
    errors : ndarray, shape (n,)
        Bound on the error of each unknown.

    Raises
    ------
    InaccurateError
        Where the answer is wrong.
    IllConditionedError
        Where nobody can say whether an answer is right.
    """
    certificate = certify(program, point)
    if not max(certificate.dual_residual, certificate.duality_gap) <= NEARLY:
        raise _inaccurate(certificate)
    good = max(certificate.dual_residual, certificate.duality_gap) <= ACCEPTED
    met = good and certificate.primal_residual <= MET
    try:
        exact = minimizer(program, point)
    except UndeterminedError:
        if not certificate.primal_residual <= ACCEPTED:
            raise _inaccurate(certificate) from None
        raise IllConditionedError(
            "too ill-conditioned to tell: the data and the active constraints leave a direction open, along which the "
            "unknowns could lie anywhere; declare more of them, or measure more"
        ) from None
    except UnsettledError:
        raise InaccurateError(
            "which inequalities are active cannot be told, and so not how far off the answer is"
        ) from None
    size = program.size(exact.point.x)
    _refuse_ill_conditioned(program, exact, size)
    errors = np.abs(exact.point.x - point.x) + exact.errors
    if not met and not program.distance(point.x, exact.point.x) <= ACCEPTED:
        raise _inaccurate(certificate)
    # Relative to the unknown alone, so that small ones among large ones are as accurate as 64 bits allow.
    if not met or np.any(errors > ACCURATE * np.abs(exact.point.x) + 2.0 * exact.errors):
        nearer = certify(program, exact.point)
        if nearer.worst <= ACCEPTED and nearer.primal_residual <= MET:
            point, errors, certificate = exact.point, exact.errors, nearer
        elif not met or np.any(errors > ACCURATE * size + 2.0 * exact.errors):
            raise _inaccurate(nearer)
        # Else the answer is good for its size, and the minimizer's last digits are rounding that heavy rows magnify.
    return point, dataclasses.replace(certificate, error_bound=largest_relative(errors, size)), errors


def _refuse_ill_conditioned(program: Assembled, exact: Minimizer, size: Floats) -> None:
    """Raise where rounding alone leaves an unknown's error too large to be of use."""
    tolerable = ACCURATE * size + IMMATERIAL * exact.deviations
    beyond = ~(exact.errors <= tolerable)
    if np.any(beyond):
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(beyond, exact.errors / size, 0.0)
        worst = int(np.argmax(np.where(np.isnan(relative), np.inf, relative)))
        raise IllConditionedError(
            f"too ill-conditioned to tell: in 64 bits {program.names[worst]} could be off by {relative[worst]:.1e} of "
            f"its size, accepted {ACCURATE:.0e}"
        )


def _inaccurate(certificate: Certificate) -> InaccurateError:
    return InaccurateError(
        f"primal residual {certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
        f"{certificate.duality_gap:.1e}, accepted {MET:.0e}, {ACCEPTED:.0e} and {ACCEPTED:.0e}"
    )


_given_up: weakref.WeakSet[Backend] = weakref.WeakSet()
"""Backends that have not answered in time once: they are not asked again, each time for another minute."""


def _limited(backend: Backend, problem: Canonical, seconds: float) -> object:
    """Ask a backend in a thread of its own, for so many seconds; a thread that does not end is left behind.

    Raises
    ------
    NoSolutionError
        Where it did not come back, or raised what is none of this library's errors.
    """
    if backend in _given_up:
        raise NoSolutionError(backend.name, f"did not answer within {seconds:g} s before, and is not asked again")
    outcome: list[object] = []
    context = contextvars.copy_context()

    def answered() -> None:
        try:
            outcome.append(context.run(backend.answer, problem))
        except BaseException as error:
            outcome.append(error)

    thread = threading.Thread(target=answered, daemon=True)
    thread.start()
    thread.join(seconds)
    if not outcome:
        _given_up.add(backend)
        raise NoSolutionError(backend.name, f"did not answer within {seconds:g} s")
    if isinstance(outcome[0], Exception) and not isinstance(outcome[0], CvxshearError):
        error = outcome[0]
        raise NoSolutionError(backend.name, f"answer() raised {type(error).__name__}: {error}") from error
    if isinstance(outcome[0], BaseException):
        raise outcome[0]
    return outcome[0]
