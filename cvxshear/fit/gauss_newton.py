"""Gauss-Newton: every step is one least-squares program, and every step lowers the misfit.

Along a direction that the data hardly determine, a plain step leads out of the range of the linearized model. If no
plain step lowers the misfit, it is damped (Levenberg 1944, Marquardt 1963): further rows hold each parameter back,
relative to its sensitivity. Their weight rises after a step that failed and falls after a step that gained as predicted
(Nielsen 1999).
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Generic

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain
from cvxshear.fit.optimality import (
    KEPT_TO,
    E,
    Optimality,
    Problem,
    Residuals,
    best_step,
    optimality,
    sensitivities,
)  # fmt: skip
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import REMAINDER_ROUNDING
from cvxshear.util import checks, errors
from cvxshear.util.typing import Floats

#: Rounding of a residual, relative to the sizes of its terms, |J| |theta|. In 64 bits a ratio that is declared to 1e-12
#: is known to 1e-3 of its standard deviation.
RESIDUAL_ROUNDING = 4.0 * float(np.finfo(float).eps)

#: Smallest decrease of chi-square that matters, for a mean chi-square of one per datum.
FLAT = 0.1

#: Mean square of the residuals of a fit far from the data: five standard deviations squared.
HOPELESS = 25.0

#: Weight of the damping rows of a plain step, relative to the sensitivity of the data to each parameter. They do not
#: move a stationary point; they determine the step along directions that the data leave open.
LEAST_DAMPING = 1e-7


@dataclass(frozen=True)
class Accuracy:
    """Options of Gauss-Newton.

    Parameters
    ----------
    step : float
        Largest change of a residual in the last step, in standard deviations, relative to the root mean square of the
        residuals if that is above one.
    most_steps : int, optional
        Largest number of step programs.
    least_gain : float, optional
        Smallest relative gain of a step while the mean square of the residuals is above `HOPELESS`.
    flat_steps : int, optional
        Number of consecutive steps with a smaller gain that end the fit.
    halvings : int, optional
        Number of times that a step is halved before it is damped.
    first_damping, negligible_damping, most_damping : float, optional
        Weight of the first damped step, the weight below it that is plain again, and the largest weight.
    no_gain : float, optional
        Relative decrease of the misfit that is rounding.
    most_refused : int, optional
        Number of step programs that the backend may leave unsolved. This many in a row damp a step to a thousandth,
        with a well-conditioned program; a backend that fails more often does not solve them.
    """

    step: float = 1e-6
    most_steps: int = 100
    least_gain: float = 0.0
    flat_steps: int = 3
    halvings: int = 2
    first_damping: float = 1e-2
    negligible_damping: float = 1e-4
    most_damping: float = 1e6
    no_gain: float = 1e-12
    most_refused: int = 6


FULL = Accuracy()
#: Accuracy of the search over sets of effects: a model far from the data needs no exact fit.
ROUGH = Accuracy(step=1e-2, most_steps=30, least_gain=0.02)


class Ending(StrEnum):
    """Why an iteration stopped; the value is the reason in words."""

    STATIONARY = "step below tolerance"
    NO_BETTER_STEP = "no step lowers the misfit"
    FLAT = "misfit flat along directions that the data hardly determine"
    CORRECTION = "correction below tolerance (Eq. 15)"
    SOLVED = "solved"
    STEP_LIMIT = "step limit"
    ITERATION_LIMIT = "iteration limit"

    @property
    def converged(self) -> bool:
        """Whether the iteration ended at its tolerance, and not at a limit."""
        return self not in (Ending.STEP_LIMIT, Ending.ITERATION_LIMIT)


@dataclass(frozen=True, eq=False)
class Fit(Generic[E]):
    """The final point of Gauss-Newton.

    Parameters
    ----------
    theta : ndarray, shape (P,)
    at : Residuals
        Residuals and derivatives there.
    reason : Ending
    steps : int
        Number of step programs handed to the backend.
    optimality : Optimality or None
        Certificate of the final point; None for a rough fit, and for one that did not converge.
    """

    theta: Floats
    at: E
    reason: Ending
    steps: int
    optimality: Optimality | None = None

    @property
    def converged(self) -> bool:
        """Whether the iteration ended at its tolerance, and not at a limit."""
        return self.reason.converged


class StepDamping:
    """The weight of the damping rows."""

    def __init__(self, accuracy: Accuracy) -> None:
        self.weight = LEAST_DAMPING
        self._accuracy = accuracy
        self._factor = 2.0

    @property
    def active(self) -> bool:
        """Whether the step is damped."""
        return self.weight > LEAST_DAMPING

    @property
    def exhausted(self) -> bool:
        """Whether more damping would leave no step."""
        return self.weight > self._accuracy.most_damping

    def heavier(self) -> None:
        """Raise the weight after a step that failed, faster with each failure."""
        self.weight = max(self._factor * self.weight, self._accuracy.first_damping)
        self._factor *= 2.0

    def lighter(self, kept: float) -> None:
        """Lower the weight after a step with this ratio of its gain to the predicted gain."""
        self.weight = max(LEAST_DAMPING, self.weight * max(1.0 / 3.0, 1.0 - (2.0 * kept - 1.0) ** 3))
        self._factor = 2.0
        if self.weight < self._accuracy.negligible_damping:
            self.weight = LEAST_DAMPING


def step_program(at: Residuals, theta: Floats, domain: Domain, damping: float = LEAST_DAMPING) -> LeastSquares:
    """Write the program of one step d: minimize |J d + r|^2 + |damping D d|^2, theta + d within its domain.

    D is the diagonal of the sensitivities (`fit.optimality.sensitivities`).
    """
    U, c = at.triangle
    step_weights = damping * sensitivities(U, domain)
    rows = [U, np.diag(step_weights), domain.held_rows(U)]
    sides = [-c, np.zeros(len(theta)), np.zeros(len(rows[2]))]
    return domain.around(LeastSquares(R=np.concatenate(rows), s=np.concatenate(sides)), theta)


def gauss_newton(
    problem: Problem[E],
    theta: Floats,
    domain: Domain,
    backend: Backend,
    accuracy: Accuracy = FULL,
    start: E | None = None,
) -> Fit[E]:
    """Minimize the sum of squared standardized residuals.

    A fit to full accuracy is certified at its final point, see `fit.optimality`.

    Parameters
    ----------
    problem : Problem
    theta : ndarray, shape (P,)
        Start.
    domain : Domain
    backend : Backend
    accuracy : Accuracy, optional
    start : Residuals, optional
        At theta, if they exist.

    Returns
    -------
    Fit
        Its misfit is at most the misfit of the start, once the start keeps the exact statements.

    Raises
    ------
    NoSolutionError
        If the backend leaves too many step programs unsolved, or the final point is not certified.
    UnsuitableError
        If the backend does not accept such a program.
    """
    fit, refused = _descended(problem, theta, domain, backend, accuracy, start)
    if refused is not None and fit.reason is Ending.NO_BETTER_STEP:
        # The unsolved step could have lowered the misfit.
        raise refused
    if accuracy.step <= FULL.step and fit.converged:
        fit = replace(fit, optimality=_certified(problem, fit, domain, backend.name))
    return fit


def _descended(
    problem: Problem[E], theta: Floats, domain: Domain, backend: Backend, accuracy: Accuracy, start: E | None
) -> tuple[Fit[E], errors.NoSolutionError | None]:
    """Follow the steps to their end; return the last failure of the backend on an undamped program, too."""
    feasible = made_feasible(theta, domain, backend)
    at = start if start is not None and feasible is theta else problem.evaluate(feasible)
    theta = feasible
    damping, flat, failures = StepDamping(accuracy), 0, 0
    refused: errors.NoSolutionError | None = None
    for step in range(1, accuracy.most_steps + 1):
        try:
            solution = backend.solve(step_program(at, theta, domain, damping.weight), bounded=False)
        except errors.NoSolutionError as error:
            # Damping improves the condition of the program.
            failures += 1
            if damping.exhausted or failures > accuracy.most_refused:
                raise
            refused = error
            damping.heavier()
            continue
        if not damping.active:
            refused = None
        d = solution.x
        rms = np.sqrt(float(at.r @ at.r) / max(len(at.r), 1))
        least = accuracy.step * max(1.0, rms) + RESIDUAL_ROUNDING * (np.abs(at.J) @ np.abs(theta))
        if not damping.active and np.all(np.abs(at.J @ d) < least):
            return Fit(theta, at, Ending.STATIONARY, step), refused
        taken = halved(problem, theta, d, at, domain, 0 if damping.active else accuracy.halvings)
        promised = float(at.r @ at.r) - float(np.sum((at.r + at.J @ d) ** 2))
        if taken is None:
            if damping.exhausted or (damping.active and promised < accuracy.no_gain * at.objective):
                return Fit(theta, at, Ending.NO_BETTER_STEP, step), refused
            damping.heavier()
            continue
        before = at
        theta, at = taken
        gain = before.objective - at.objective
        given_up = rms**2 > HOPELESS and gain < accuracy.least_gain * before.objective
        flat = flat + 1 if given_up or (damping.active and gain < FLAT * max(1.0, rms**2)) else 0
        if flat == accuracy.flat_steps:
            return Fit(theta, at, Ending.FLAT, step), refused
        if damping.active:
            damping.lighter(gain / promised if promised > 0 else 0.0)
    return Fit(theta, at, Ending.STEP_LIMIT, accuracy.most_steps), refused


def _certified(problem: Problem[E], fit: Fit[E], domain: Domain, name: str) -> Optimality:
    """Certify the final point.

    Raises
    ------
    NoSolutionError
        If the solution is not accurate enough.
    """
    found = optimality(problem, fit.theta, fit.at, domain, LEAST_DAMPING)
    rms = max(1.0, float(np.sqrt(fit.at.objective / max(len(fit.at.r), 1))))
    if found.violation > KEPT_TO:
        raise errors.NoSolutionError(name, f"the fit breaks an exact statement by {found.violation:.1e} of its size")
    if found.derivative_error > checks.DERIVATIVE_ERROR:
        raise errors.NoSolutionError(
            name,
            f"derivatives of the misfit are off their difference quotients by {100 * found.derivative_error:.1g} %",
        )
    if found.step > 10.0 * FULL.step * rms * np.sqrt(len(fit.at.r)):
        # The model is not linear along directions that the data hardly determine, so the step is tried.
        d, _ = best_step(fit.theta, fit.at, domain, LEAST_DAMPING)
        trial = halved(problem, fit.theta, d, fit.at, domain, FULL.halvings)
        if trial is not None and fit.at.objective - trial[1].objective > FLAT * rms**2:
            raise errors.NoSolutionError(name, "the fit ended where a step of another solver lowers the misfit further")
    return found


def halved(
    problem: Problem[E], theta: Floats, d: Floats, at: Residuals, domain: Domain, halvings: int
) -> tuple[Floats, E] | None:
    """Try theta + d, theta + d/2, ...: return the first point that lowers the misfit, or None."""
    for power in range(halvings + 1):
        trial = theta + 0.5**power * d
        if domain.farthest is not None and np.any(trial > domain.farthest):
            continue
        try:
            # With derivatives, since the first trial is nearly always accepted.
            found = problem.evaluate(trial)
        except errors.NoModesError:
            # The step is too long: a mass is not positive, or the frame buckles.
            continue
        if found.objective < at.objective:
            return trial, found
    return None


def made_feasible(theta: Floats, domain: Domain, backend: Backend) -> Floats:
    """Find the nearest point, in relative change, that keeps the exact statements."""
    nearest = LeastSquares(R=np.diag(1.0 / domain.scale), s=np.zeros(len(theta)))
    program = domain.around(nearest, theta)
    return theta if satisfied(program, domain.scale) else theta + backend.solve(program).x


def satisfied(program: LeastSquares, scale: Floats) -> bool:
    """Whether the constraints of a program hold for an unknown of zero, within rounding."""
    G, h = program.inequalities
    A, b = program.equalities
    return bool(
        np.all(h >= -REMAINDER_ROUNDING * np.linalg.norm(G * scale, axis=1))
        and np.all(np.abs(b) <= REMAINDER_ROUNDING * np.linalg.norm(A * scale, axis=1))
        and all(
            np.linalg.eigvalsh(each.constant)[0] >= -REMAINDER_ROUNDING * np.max(np.abs(each.constant))
            for each in program.lmi
        )
    )
