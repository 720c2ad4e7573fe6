"""Gauss-Newton: every step is one least-squares program, and no step makes the fit worse.

Where the data hardly determine some direction a plain step leads far along it, out of the range in which the model is
nearly linear. Where no plain step lowers the misfit it is damped (Levenberg 1944, Marquardt 1963): rows that hold each
parameter back, weighed against the sensitivity of the data to it, heavier after a step that failed and lighter after
one that did what the linearised model promised (Nielsen 1999).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic

import numpy as np

from cvxshear.backends import Backend, Solution
from cvxshear.fit.domain import Domain
from cvxshear.fit.optimality import (
    DERIVATIVE_ERROR,
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
from cvxshear.programs.statements import constrained
from cvxshear.util.errors import NoModesError, NoSolutionError
from cvxshear.util.typing import Floats

CONVERGED_STEP = 1e-6
"""Largest change of a residual, in standard deviations and relative to their root mean square where that is above
one, of a step that counts as none."""

RESIDUAL_ROUNDING = 4.0 * float(np.finfo(float).eps)
"""Rounding of a residual, relative to the sizes of its terms, |J| |theta|: in 64 bits a ratio declared to 1e-12 is
known to 1e-3 of its standard deviation, and a step that changes it by less is none."""

MOST_STEPS = 100
HALVINGS = 2
"""Times that a step is halved before it is damped."""

LEAST_DAMPING = 1e-7
"""Weight of the rows that hold a step back, relative to the sensitivity of the data to each parameter. They move no
stationary point; they keep a step along a direction that the data do not determine from being arbitrary."""

FIRST_DAMPING = 1e-2
NEGLIGIBLE_DAMPING = 1e-4
MOST_DAMPING = 1e6
"""Weights at which a step is damped for the first time, below which it is a plain one again, and beyond which there is
no step left to try."""

ROUNDING = 1e-13
"""Relative violation of a constraint that counts as none."""

NO_GAIN = 1e-12
"""Part of the misfit that is rounding: a damped step that promises less, and is no better, leads nowhere, and a step
program about such a point has a gradient of nothing but rounding, which no solver can be held to."""

FLAT = 0.1
FLAT_STEPS = 3
"""Decrease of chi-square, where its mean a datum is one, that this many damped steps in a row must bring to go on."""

HOPELESS = 25.0
"""Mean square of the residuals, five standard deviations squared, above which a fit may be given up, see `Accuracy`."""

MOST_REFUSED = 6
"""Step programs of one fit that the backend may leave unsolved: with as many in a row a step is damped to a thousandth,
where every program is well conditioned. A backend that fails more often does not solve them."""

STATIONARY_STEP = 1e-5
"""Length of the best step from a stationary point a residual, in standard deviations: ten times `CONVERGED_STEP`."""


@dataclass(frozen=True)
class Accuracy:
    """How far a fit is followed.

    Parameters
    ----------
    step : float
        Largest change of a residual, see `CONVERGED_STEP`, of a step that counts as none.
    most_steps : int, optional
        Step programs at most.
    least_gain : float, optional
        Share of the misfit that each step must bring while the mean square of the residuals is above `HOPELESS`: a fit
        ends after `FLAT_STEPS` in a row that bring less. With 0 it follows a curved valley to its end.
    """

    step: float
    most_steps: int = MOST_STEPS
    least_gain: float = 0.0


FULL = Accuracy(CONVERGED_STEP)
ROUGH = Accuracy(1e-2, 30, 0.02)
"""While sets of effects are looked for: a model so far from the data is out of the question wherever in a valley it
ends, and a hundred steps each made wrong files take a minute."""


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
        """Whether there was nothing left to gain, or hardly anything."""
        return self not in (Ending.STEP_LIMIT, Ending.ITERATION_LIMIT)


@dataclass(frozen=True, eq=False)
class Fit(Generic[E]):
    """The point at which Gauss-Newton stopped.

    Parameters
    ----------
    theta : ndarray, shape (P,)
    at : Residuals
        Residuals and derivatives there.
    reason : Ending
    steps : int
        Number of step programs handed to the backend.
    evaluations : int
        Number of points at which residuals and derivatives were computed.
    optimality : Optimality or None
        Certificate of the final point; None for a rough fit, and for one that did not converge.
    """

    theta: Floats
    at: E
    reason: Ending
    steps: int
    evaluations: int = 0
    optimality: Optimality | None = None

    @property
    def converged(self) -> bool:
        """Whether it stopped because there was nothing left to gain, or hardly anything."""
        return self.reason.converged


class _Damping:
    """The weight of the rows that hold a step back."""

    def __init__(self) -> None:
        self.weight = LEAST_DAMPING
        self._factor = 2.0

    @property
    def active(self) -> bool:
        """Whether it holds a step back by more than rounding."""
        return self.weight > LEAST_DAMPING

    @property
    def exhausted(self) -> bool:
        """Whether more would leave nothing of the step."""
        return self.weight > MOST_DAMPING

    def heavier(self) -> None:
        """After a step that failed: more, and faster with each that fails."""
        self.weight = max(self._factor * self.weight, FIRST_DAMPING)
        self._factor *= 2.0

    def lighter(self, kept: float) -> None:
        """After a step that kept this part of what the linearised model promised."""
        self.weight = max(LEAST_DAMPING, self.weight * max(1.0 / 3.0, 1.0 - (2.0 * kept - 1.0) ** 3))
        self._factor = 2.0
        if self.weight < NEGLIGIBLE_DAMPING:
            self.weight = LEAST_DAMPING


def step_program(at: Residuals, theta: Floats, domain: Domain, damping: float = LEAST_DAMPING) -> LeastSquares:
    """Write the program of one step d: minimize |J d + r|^2 + |damping D d|^2, theta + d within its domain.

    D is the diagonal of the sensitivities (`fit.optimality.sensitivities`).
    """
    U, c = at.triangle
    step_weights = damping * sensitivities(U, domain)
    program = LeastSquares(R=np.concatenate([U, np.diag(step_weights)]), s=np.concatenate([-c, np.zeros(len(theta))]))
    return constrained(program, domain.statements, theta)


def gauss_newton(
    problem: Problem[E],
    theta: Floats,
    domain: Domain,
    backend: Backend,
    accuracy: Accuracy = FULL,
    start: E | None = None,
) -> Fit[E]:
    """Minimize the sum of squared standardized residuals.

    A fit to full accuracy (a step of at most `CONVERGED_STEP`) is certified at its final point: see
    `fit.optimality`.

    Parameters
    ----------
    problem : Problem
    theta : ndarray, shape (P,)
        Start, at which the problem has residuals.
    domain : Domain
    backend : Backend
    accuracy : Accuracy, optional
    start : Residuals, optional
        At theta, where they were computed already.

    Returns
    -------
    Fit
        Of no larger misfit than the start, once the start keeps the exact statements.

    Raises
    ------
    NoSolutionError
        Where the backend leaves more than `MOST_REFUSED` step programs unsolved, or the final point is not certified.
    UnsuitableError
        Where the backend cannot take such a program.
    """
    fit, refused = _descended(problem, theta, domain, backend, accuracy, start)
    if refused is not None and fit.reason is Ending.NO_BETTER_STEP:
        # A step that nobody solved is no reason to believe that none is better.
        raise refused
    if accuracy.step <= CONVERGED_STEP and fit.converged:
        fit = dataclasses.replace(fit, optimality=_certified(problem, fit, domain, backend.name))
    return fit


def _descended(
    problem: Problem[E], theta: Floats, domain: Domain, backend: Backend, accuracy: Accuracy, start: E | None
) -> tuple[Fit[E], NoSolutionError | None]:
    """Where the steps end, and the failure of the backend since it last solved an undamped program."""
    feasible = _made_feasible(theta, domain, backend)
    at = start if start is not None and feasible is theta else problem.evaluate(feasible)
    theta, evaluations = feasible, 1
    damping, flat, failures = _Damping(), 0, 0
    refused: NoSolutionError | None = None
    solution: Solution | None = None
    for step in range(1, accuracy.most_steps + 1):
        try:
            solution = backend.solve(step_program(at, theta, domain, damping.weight), solution)
        except NoSolutionError as error:
            # A program so badly conditioned that the solver gives up is better conditioned with more damping.
            failures += 1
            if damping.exhausted or failures > MOST_REFUSED:
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
            return Fit(theta, at, Ending.STATIONARY, step, evaluations), refused
        taken, trials = _halved(problem, theta, d, at, domain, 0 if damping.active else HALVINGS)
        evaluations += trials
        promised = float(at.r @ at.r) - float(np.sum((at.r + at.J @ d) ** 2))
        if taken is None:
            if damping.exhausted or (damping.active and promised < NO_GAIN * at.objective):
                return Fit(theta, at, Ending.NO_BETTER_STEP, step, evaluations), refused
            damping.heavier()
            continue
        gain, before = at.objective - taken[1].objective, at
        theta, at = taken
        given_up = rms**2 > HOPELESS and gain < accuracy.least_gain * before.objective
        flat = flat + 1 if given_up or (damping.active and gain < FLAT * max(1.0, rms**2)) else 0
        if flat == FLAT_STEPS:
            return Fit(theta, at, Ending.FLAT, step, evaluations), refused
        if damping.active:
            damping.lighter(gain / promised if promised > 0 else 0.0)
    return Fit(theta, at, Ending.STEP_LIMIT, accuracy.most_steps, evaluations), refused


def _certified(problem: Problem[E], fit: Fit[E], domain: Domain, name: str) -> Optimality:
    """Certify the final point.

    Raises
    ------
    NoSolutionError
        Where it is not good enough.
    """
    found = optimality(problem, fit.theta, fit.at, domain, LEAST_DAMPING)
    rms = max(1.0, float(np.sqrt(fit.at.objective / max(len(fit.at.r), 1))))
    if found.violation > KEPT_TO:
        raise NoSolutionError(name, f"the fit breaks an exact statement by {found.violation:.1e} of its size")
    if found.derivative_error > DERIVATIVE_ERROR:
        raise NoSolutionError(
            name,
            f"derivatives of the misfit are off their difference quotients by {100 * found.derivative_error:.1g} %",
        )
    if found.step > STATIONARY_STEP * rms * np.sqrt(len(fit.at.r)):
        # It may promise more than there is: along what the data hardly determine the model is not linear.
        d, _ = best_step(fit.theta, fit.at, domain, LEAST_DAMPING)
        trial, _ = _halved(problem, fit.theta, d, fit.at, domain, HALVINGS)
        if trial is not None and fit.at.objective - trial[1].objective > FLAT * rms**2:
            raise NoSolutionError(name, "the fit ended where a step of another solver lowers the misfit further")
    return found


def _halved(
    problem: Problem[E], theta: Floats, d: Floats, at: Residuals, domain: Domain, halvings: int
) -> tuple[tuple[Floats, E] | None, int]:
    """theta + d, or + d/2, ...: the first within reach that lowers the misfit, or None; and the points evaluated."""
    evaluations = 0
    for power in range(halvings + 1):
        trial = theta + 0.5**power * d
        if domain.farthest is not None and np.any(trial > domain.farthest):
            continue
        evaluations += 1
        try:
            # With derivatives at once: nearly always the first trial is taken, and they are needed then.
            found = problem.evaluate(trial)
        except NoModesError:
            # Outside the model's domain (a mass not positive, a frame that buckles): too long a step.
            continue
        if found.objective < at.objective:
            return (trial, found), evaluations
    return None, evaluations


def _made_feasible(theta: Floats, domain: Domain, backend: Backend) -> Floats:
    """Find the nearest point, in relative change, that keeps the exact statements."""
    nearest = LeastSquares(R=np.diag(1.0 / domain.scale), s=np.zeros(len(theta)))
    program = constrained(nearest, domain.statements, theta)
    return theta if _kept(program, domain.scale) else theta + backend.solve(program).x


def _kept(program: LeastSquares, scale: Floats) -> bool:
    """Whether the constraints of a program hold for an unknown of zero, within rounding."""
    G, h = program.inequalities
    A, b = program.equalities
    return bool(
        np.all(h >= -ROUNDING * np.linalg.norm(G * scale, axis=1))
        and np.all(np.abs(b) <= ROUNDING * np.linalg.norm(A * scale, axis=1))
    )
