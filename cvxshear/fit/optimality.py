"""The optimality certificate of a fit, computed at its final point from the problem alone, for every backend.

At a minimum of the sum of squares |r|^2 over theta with A theta = b and G theta <= h no step lowers the linearized

    |J d + r|^2 + |w D d|^2,        A d = 0,  G_a d <= 0,

G_a the active inequalities, D the sensitivities to the parameters and w a small weight for directions that change no
residual. With the triangular factor R'R = J'J + w^2 D^2 and the gradient R'c the best
step has the length |R d| of the smallest

    |c + R'^-1 (A' y + G_a' v)|        over y and v >= 0,

a nonnegative least-squares problem with one unknown per constraint (the dual of the program). The length is in standard
deviations of the residuals; its square is the predicted decrease of the sum of squares.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy import linalg, optimize

from cvxshear.fit.domain import ON_BOUND, Domain
from cvxshear.programs import LeastSquares
from cvxshear.programs.certificate import Point
from cvxshear.util import checks, decorators
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Floats

#: Largest violation of an exact statement, relative to the sizes of its terms. Steps are solved to 1e-6 of their
#: length, and the last steps are short, so that correct steps leave far less.
KEPT_TO = 1e-9

#: Relative changes of the parameters for central difference quotients, tried in turn until one agrees: the best one
#: depends on the curvature and on the rounding of the eigenvalue problem.
CHANGES = (1e-5, 1e-6, 1e-4, 1e-3)

#: Largest sensitivity that damps a parameter: standard deviations for a change by its own size. A soft ratio, declared
#: to 1e-12, does not concern the common size of its two parameters; its weight must not keep that from moving.
MOST_SENSITIVE = 1e7

#: Change of all residuals, in standard deviations, for the first comparison of derivatives.
AWAY = 0.1


class Residuals(Protocol):
    """Standardized residuals and their derivatives at one point, as Gauss-Newton needs them."""

    @property
    def r(self) -> Floats:
        """Residuals, shape (d,)."""

    @property
    def J(self) -> Floats:  # noqa: N802 - the Jacobian's name in the equations
        """Derivatives of the residuals, shape (d, P)."""

    @property
    def objective(self) -> float:
        """Sum of squares of the residuals."""

    @property
    def triangle(self) -> tuple[Floats, Floats]:
        """U and c with |J x + r|^2 = |U x + c|^2 + constant for every x, at most P rows."""


E = TypeVar("E", bound=Residuals)
E_co = TypeVar("E_co", bound=Residuals, covariant=True)


class Problem(Protocol[E_co]):
    """A sum of squares to minimize: `fit.misfit.Misfit`, or another object with residuals and derivatives."""

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> E_co:
        """Residuals at theta, shape (P,), with their derivatives unless these are not asked for.

        Raises
        ------
        NoModesError
            If the problem has no residuals there.
        """


@dataclass(frozen=True, eq=False)
class PlainResiduals:
    """Plain residuals for Gauss-Newton.

    Parameters
    ----------
    r : ndarray, shape (d,)
    J : ndarray, shape (d, P)
    """

    r: Floats
    J: Floats

    @property
    def objective(self) -> float:
        """Sum of squares of the residuals."""
        return float(self.r @ self.r)

    @decorators.cached_property
    def triangle(self) -> tuple[Floats, Floats]:
        """U and c with |J x + r|^2 = |U x + c|^2 + constant for every x: J = Q U, c = Q' r, at most P rows.

        A step and its uncertainty need no more of J; there are many more data than parameters.
        """
        whole = np.asarray(np.linalg.qr(np.column_stack([self.J, self.r]), mode="r"))
        P = self.J.shape[1]
        return whole[:P, :P], whole[:P, P]


@dataclass(frozen=True)
class Optimality:
    """How well a point meets the conditions of a constrained minimum, computed from the problem alone.

    Parameters
    ----------
    violation : float
        Largest violation of an exact statement, relative to the sizes of its terms.
    step : float
        Length of the best linearised step from here that keeps the active constraints, in standard deviations of the
        residuals.
    derivative_error : float
        Largest relative difference of the derivatives along two random directions from their difference quotients; zero
        where the problem has no residuals beside this point.
    """

    violation: float
    step: float
    derivative_error: float


def sensitivities(U: Floats, domain: Domain) -> Floats:
    """Find the sensitivity of the residuals to each parameter: the length of its column, at most `MOST_SENSITIVE`."""
    lengths = np.linalg.norm(U, axis=0)
    return np.asarray(np.minimum(np.where(lengths > 0, lengths, 1.0), MOST_SENSITIVE / domain.scale))


def optimality(problem: Problem[Residuals], theta: Floats, at: Residuals, domain: Domain, weight: float) -> Optimality:
    """Compute the optimality certificate of a point.

    Parameters
    ----------
    problem : Problem
    theta : ndarray, shape (P,)
    at : Residuals
        At theta.
    domain : Domain
    weight : float
        w above, relative to the sensitivity of the residuals to each parameter.

    Returns
    -------
    Optimality
    """
    return Optimality(
        violation(theta, at, domain),
        float(np.linalg.norm(best_step(theta, at, domain, weight)[1])),
        derivative_error(problem, theta, at, domain),
    )


def violation(theta: Floats, at: Residuals, domain: Domain) -> float:
    """Largest violation of an exact statement, relative to the sizes of its terms.

    The size of a parameter is its absolute value and the change of it that changes the residuals by one.
    """
    here = domain.tangent(LeastSquares(np.zeros((0, len(theta))), np.zeros(0)), theta)
    size = np.abs(theta) + _units(theta, at, domain)
    worst = 0.0
    for rows, off in ((here.equalities[0], np.abs(here.equalities[1])), (here.inequalities[0], -here.inequalities[1])):
        reach = np.abs(rows) @ size
        worst = max(worst, float(np.max(np.maximum(off, 0.0) / np.where(reach > 0, reach, 1.0), initial=0.0)))
    return worst


@dataclass(frozen=True, eq=False)
class LocalConditions:
    """The linearized program at a point, whitened by R, with the multipliers that come closest to its gradient.

    Parameters
    ----------
    program : LeastSquares
        Program in the change d from the point, with the constraints at the point.
    R : ndarray, shape (P, P)
    left : ndarray, shape (P,)
        The part of the whitened gradient that no multipliers cancel: minus the best step, whitened.
    point : Point
        d = 0, with the multipliers.
    """

    program: LeastSquares
    R: Floats
    left: Floats
    point: Point


def local_conditions(theta: Floats, at: Residuals, domain: Domain, weight: float) -> LocalConditions:
    """Solve the nonnegative least-squares problem of the multipliers at a point, with w and R as above."""
    U, c = at.triangle
    damping = np.diag(weight * sensitivities(U, domain))
    # The right side as a further column: Q'[c; 0] is the last column of the triangle.
    stacked = np.column_stack([np.concatenate([U, damping]), np.concatenate([c, np.zeros(len(theta))])])
    whole = np.asarray(np.linalg.qr(stacked, mode="r"))
    R, gradient = whole[: len(theta), : len(theta)], whole[: len(theta), -1]
    here = domain.tangent(LeastSquares(U, -c), theta)
    A, _ = here.equalities
    G, slack = here.inequalities
    whitened = linalg.solve_triangular(R, np.concatenate([A, G]).T, trans="T", check_finite=False).T
    equalities, inequalities = whitened[: len(A)], whitened[len(A) :]
    active = slack <= ON_BOUND * np.linalg.norm(inequalities, axis=1)
    left, y, v = _multipliers(gradient, equalities, inequalities[active])
    w = np.zeros(len(slack))
    w[active] = v
    return LocalConditions(here, R, left, Point(np.zeros(len(theta)), y, w))


def best_step(theta: Floats, at: Residuals, domain: Domain, weight: float) -> tuple[Floats, Floats]:
    """Find the best linearized step d that keeps the active constraints, and R d, each of shape (P,)."""
    found = local_conditions(theta, at, domain, weight)
    step = -found.left
    return np.asarray(linalg.solve_triangular(found.R, step, check_finite=False)), step


def _multipliers(gradient: Floats, equalities: Floats, active: Floats) -> tuple[Floats, Floats, Floats]:
    """Find the multipliers y and v >= 0 that cancel the gradient best.

    Returns
    -------
    left : ndarray, shape (P,)
        gradient + equalities' y + active' v.
    y, v : ndarray
    """
    left, free, v = gradient, active, np.zeros(len(active))
    if len(equalities):
        # Equalities that follow from others leave the rank below the number of rows.
        _, values, basis = np.linalg.svd(_unit(equalities), full_matrices=False)
        basis = basis[values > 1e-12 * values[0]]
        left = left - basis.T @ (basis @ left)
        free = active - (active @ basis.T) @ basis
    if len(free):
        unit = _unit(free)
        scaled, _ = optimize.nnls(unit.T, -left)
        left = left + unit.T @ scaled
        lengths = np.linalg.norm(free, axis=1)
        v = scaled / np.where(lengths > 0, lengths, 1.0)
    y = np.linalg.lstsq(equalities.T, -(gradient + active.T @ v), rcond=1e-12)[0] if len(equalities) else np.zeros(0)
    return np.asarray(left), np.asarray(y), v


def _unit(rows: Floats) -> Floats:
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(lengths > 0, lengths, 1.0))


def _sizes(theta: Floats, domain: Domain) -> Floats:
    """Size of each parameter: its value or, where it is near zero, a thousandth of what it can be expected to be."""
    return np.asarray(np.maximum(np.abs(theta), 1e-3 * domain.scale))


def _units(theta: Floats, at: Residuals, domain: Domain) -> Floats:
    """Return the change of each parameter that changes the residuals by one, at most its size."""
    lengths = np.linalg.norm(at.triangle[0], axis=0)
    return np.asarray(1.0 / np.maximum(lengths, 1.0 / _sizes(theta, domain)))


def derivative_error(problem: Problem[Residuals], theta: Floats, at: Residuals, domain: Domain) -> float:
    """Largest relative difference of the gradient along two random directions from difference quotients.

    The gradient vanishes at a minimum, so that wrong derivatives could pass. The comparison is made beside theta, where
    the gradient contains the curvature: over a step, the quotient of |r|^2 is the mean of the slopes at both ends up to
    terms of third order. It concerns |r|^2 and not r, since J leaves out a part orthogonal to r if the scale of a shape
    is eliminated (Kaufman 1975).
    """
    # A fixed seed, so that a fit is always certified alike.
    rng = np.random.default_rng(20)
    units, sizes = _units(theta, at, domain), _sizes(theta, domain)
    # Of large residuals a change by a tenth would be lost in rounding; no parameter changes by more than a hundredth.
    change = max(AWAY, AWAY * 1e-2 * float(np.linalg.norm(at.r)))
    worst = 0.0
    for direction in units * rng.standard_normal((2, len(theta))):
        seen, relative = float(np.linalg.norm(at.J @ direction)), float(np.max(np.abs(direction) / sizes))
        d = direction * min(change / seen if seen > 0 else np.inf, 1e-2 / relative)
        for sign in (1.0, -1.0):
            try:
                worst = max(worst, _slope_error(problem, theta, at, sign * d, sizes))
                break
            except NoModesError:
                continue
    return worst


def _slope_error(problem: Problem[Residuals], theta: Floats, at: Residuals, d: Floats, sizes: Floats) -> float:
    """Relative difference of the slope of |r|^2 along d from difference quotients, of the best of some."""
    there = problem.evaluate(theta + d)
    seen = there.J @ d
    here, slope = 2.0 * float(at.r @ (at.J @ d)), 2.0 * float(there.r @ seen)
    size = max(abs(slope), 2.0 * float(seen @ seen)) or 1.0
    whole = abs(there.objective - at.objective - 0.5 * (here + slope)) / size
    if whole <= checks.DERIVATIVE_ERROR:
        return whole
    relative = float(np.max(np.abs(d) / sizes))
    off: list[float] = []
    for change in CHANGES:
        h = change / relative
        ends = [problem.evaluate(theta + (1 + step) * d, derivatives=False).objective for step in (h, -h)]
        off.append((ends[0] - ends[1]) / (2.0 * h) - slope)
        if abs(off[-1]) <= checks.DERIVATIVE_ERROR * size:
            return abs(off[-1]) / size
    # Quotients that differ from each other are rounding, and no test of the derivative.
    settled = np.abs(np.diff(off)) < 0.1 * np.abs(off[1:])
    return float(np.min(np.abs(off)) / size) if settled.any() else 0.0
