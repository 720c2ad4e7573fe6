"""Gauss-Newton: every step is one least-squares program, and no step makes the fit worse.

Where the data hardly determine some direction a plain step leads far along it, out of the range in which the model is
nearly linear. Where no plain step lowers the misfit it is damped (Levenberg 1944, Marquardt 1963): rows that hold each
parameter back, weighed against the sensitivity of the data to it, heavier after a step that failed and lighter after
one that did what the linearised model promised (Nielsen 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend, Solution
from cvxshear.fit.ending import Ending
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares
from cvxshear.programs.statements import NamedConstraints, constrained
from cvxshear.util.errors import NoModesError, NoSolutionError
from cvxshear.util.typing import Floats, Ints

CONVERGED_STEP = 1e-6
"""Largest change of a residual, in standard deviations and relative to their root mean square where that is above
one, of a step that counts as none."""

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

FLAT = 0.1
FLAT_STEPS = 3
"""Decrease of chi-square, where its mean a datum is one, that this many damped steps in a row must bring to go on."""


FARTHEST = 1e5
"""Times its start that a mass or a stiffness becomes at most: what the data leave so open is as good as infinite, and
further on rounding would lose what is declared of the others."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Where Gauss-Newton stopped.

    Parameters
    ----------
    theta : ndarray, shape (P,)
    at : Evaluation
        Residuals and derivatives there.
    reason : Ending
    steps : int
        Number of step programs solved.
    """

    theta: Floats
    at: Evaluation
    reason: Ending
    steps: int

    @property
    def converged(self) -> bool:
        """Whether it stopped because there was nothing left to gain, or hardly anything."""
        return self.reason.converged


@dataclass(frozen=True, eq=False)
class Domain:
    """Where the parameters may lie.

    Parameters
    ----------
    statements : sequence of NamedConstraints
        Exact statements about theta.
    scale : ndarray, shape (P,)
        Size of each parameter at the start, to which a change is compared.
    interval_std : ndarray, shape (P,)
        Standard deviation that a parameter's interval of physical values stands for; infinite where it has none.
    """

    statements: Sequence[NamedConstraints]
    scale: Floats
    interval_std: Floats


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


def step_program(at: Evaluation, theta: Floats, domain: Domain, damping: float = LEAST_DAMPING) -> LeastSquares:
    """The program of one step d: minimize |J d + r|^2 + |damping D d|^2, theta + d within its domain.

    D is the diagonal of the lengths of J's columns.
    """
    U, c = at.triangle
    sensitivity = np.linalg.norm(U, axis=0)
    held = damping * np.where(sensitivity > 0, sensitivity, 1.0)
    program = LeastSquares(R=np.concatenate([U, np.diag(held)]), s=np.concatenate([-c, np.zeros(len(theta))]))
    return constrained(program, domain.statements, theta)


def gauss_newton(
    misfit: Misfit,
    theta: Floats,
    domain: Domain,
    backend: Backend,
    tolerance: float = CONVERGED_STEP,
    start: Evaluation | None = None,
) -> Fit:
    """Minimize the sum of squared standardized residuals.

    Parameters
    ----------
    misfit : Misfit
    theta : ndarray, shape (P,)
        Start, at which the model has modes.
    domain : Domain
    backend : Backend
    tolerance : float, optional
        Largest change of a residual, see `CONVERGED_STEP`, of a step that counts as none.
    start : Evaluation, optional
        At theta, where it was made already.

    Returns
    -------
    Fit
        Of no larger misfit than the start, once the start keeps the exact statements.

    Raises
    ------
    NoSolutionError, UnsuitableError
        From the backend, where it cannot solve a step.
    """
    feasible = _made_feasible(theta, domain, backend)
    at = start if start is not None and feasible is theta else misfit.evaluate(feasible)
    theta = feasible
    frame = np.arange(len(theta)) < 2 * misfit.experiment.stories
    farthest = np.where(frame, FARTHEST * domain.scale, np.inf)
    damping, flat = _Damping(), 0
    solution: Solution | None = None
    for step in range(1, MOST_STEPS + 1):
        try:
            solution = backend.solve(step_program(at, theta, domain, damping.weight), solution)
        except NoSolutionError:
            # A program so badly conditioned that the solver gives up is better conditioned with more damping.
            if damping.exhausted:
                raise
            damping.heavier()
            continue
        d = solution.x
        rms = np.sqrt(at.objective / max(len(at.r), 1))
        if not damping.active and np.max(np.abs(at.J @ d), initial=0.0) < tolerance * max(1.0, rms):
            return Fit(theta, at, Ending.STATIONARY, step)
        taken = _halved(misfit, theta, d, at, farthest, 0 if damping.active else HALVINGS)
        if taken is None:
            if damping.exhausted:
                return Fit(theta, at, Ending.NO_BETTER_STEP, step)
            damping.heavier()
            continue
        gain, before = at.objective - taken[1].objective, at
        theta, at = taken
        if not damping.active:
            flat = 0
        else:
            flat = flat + 1 if gain < FLAT * max(1.0, rms**2) else 0
            if flat == FLAT_STEPS:
                return Fit(theta, at, Ending.FLAT, step)
            promised = before.objective - float(np.sum((before.r + before.J @ d) ** 2))
            damping.lighter(gain / promised if promised > 0 else 0.0)
    return Fit(theta, at, Ending.STEP_LIMIT, MOST_STEPS)


def _halved(
    misfit: Misfit, theta: Floats, d: Floats, at: Evaluation, farthest: Floats, halvings: int
) -> tuple[Floats, Evaluation] | None:
    """theta + d, or + d/2, d/4, ...: the first within reach that lowers the misfit, evaluated; None where none does."""
    for power in range(halvings + 1):
        trial = theta + 0.5**power * d
        if np.any(trial > farthest):
            continue
        try:
            # With derivatives at once: nearly always the first trial is taken, and they are needed then.
            found = misfit.evaluate(trial)
        except NoModesError:
            # Outside the model's domain (a mass not positive, a frame that buckles): too long a step.
            continue
        if found.objective < at.objective:
            return trial, found
    return None


def _made_feasible(theta: Floats, domain: Domain, backend: Backend) -> Floats:
    """The nearest point, in relative change, that keeps the exact statements."""
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


def embedded(said: Constraints, at: slice | Ints, size: int) -> Constraints:
    """Statements about some of the parameters as statements about all of them."""

    def wide(rows: Floats | None) -> Floats | None:
        if rows is None:
            return None
        full = np.zeros((len(rows), size))
        full[:, at] = rows
        return full

    def padded(bound: Floats | None, fill: float) -> Floats | None:
        if bound is None:
            return None
        full = np.full(size, fill)
        full[at] = bound
        return full

    return Constraints(
        padded(said.lower, -np.inf), padded(said.upper, np.inf), wide(said.G), said.h, wide(said.A), said.b
    )
