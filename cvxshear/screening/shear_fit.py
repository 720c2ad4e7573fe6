"""How far a reading is from the nearest shear frame of plausible proportions.

Floor masses and story stiffnesses are those that minimize

    sum (log f_model - log f)^2 / s_f^2 + sum |(1 - u u') W phi|^2 + sum (log m_i)^2 / s_m^2
        + sum (log k_i - mean log k)^2 / s_k^2,      u = W phi_model / |W phi_model|,

the scale of each shape eliminated. What was declared of masses plays no part: one configuration fixes them only up to
a common factor, and a declaration can be wrong as well. The last two sums say that floors are of the order of each
other, and so are stories; they decide where the measurement does not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from cvxshear.measurement.reading import Reading
from cvxshear.model.shear import Modes, mass_matrix, mode_derivatives, modes, shear_system, stiffness_matrix
from cvxshear.util.typing import Floats

MASS_SPREAD = 0.6
"""Standard deviation of the logarithm of a floor's mass."""

STIFFNESS_SPREAD = 0.8
"""Standard deviation of the logarithm of a story's stiffness about the mean."""

WIDEST = 3.0
"""Logarithm: masses and stiffnesses start no farther than this from their mean, and go no farther from there."""

EVALUATIONS = 60
"""At most, in one fit."""

CONVERGED = 1e-4
"""Relative change of the cost."""

OUTLIER = 2.0
"""Standard deviations from which on a robust fit pays less and less heed to an entry."""

ABOUT = 0.1
"""Standard deviation of the logarithm of a frequency under a frame of about the right proportions."""

ROUNDS = 4
"""Of weighting anew, in a robust fit."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A shear frame near a reading.

    Parameters
    ----------
    theta : ndarray, shape (2N,)
        Logarithms of masses and stiffnesses, the unit of mass free.
    cost : float
        The sum above.
    """

    theta: Floats
    cost: float

    @property
    def modes(self) -> Modes:
        """The frame's modes."""
        return modes_at(self.theta)


def modes_at(theta: Floats) -> Modes:
    """Modes of the frame whose masses and stiffnesses have these logarithms."""
    mass, stiffness = np.split(np.exp(theta), 2)
    return modes(mass_matrix(mass), stiffness_matrix(stiffness))


def starts(stories: int) -> list[Floats]:
    """Frames of equal floors whose stories are equal, or weaker with height."""
    return [np.log(np.concatenate([np.ones(stories), np.linspace(1.0, top, stories)])) for top in (1.0, 0.4)]


def _tuned(reading: Reading, theta: Floats) -> Floats:
    """The frame with its stiffnesses scaled to the right mean frequency, and nothing far from the mean."""
    by_quantity = theta.reshape(2, -1)
    mean = by_quantity.mean(axis=1, keepdims=True)
    theta = (mean + np.clip(by_quantity - mean, -WIDEST, WIDEST)).ravel()
    off = np.mean(reading.log_frequencies - np.log(modes_at(theta).frequencies[reading.modes]))
    tuned: Floats = theta + np.repeat([0.0, 2 * off], reading.stories)
    return tuned


def fit(
    reading: Reading, at: Iterable[Floats], *, weights: Floats | None = None, evaluations: int = EVALUATIONS
) -> Fit:
    """The best of the fits that begin at these frames.

    Parameters
    ----------
    reading : Reading
    at : iterable of ndarray, shape (2N,)
    weights : ndarray, shape (m, n), optional
        In place of the reading's own.
    evaluations : int, optional
        At most, in each.
    """
    found = (_fitted(reading, _tuned(reading, theta), weights, evaluations) for theta in at)
    return min(found, key=lambda item: item.cost)


def distance(reading: Reading, at: Iterable[Floats]) -> Fit:
    """The best fit with either tolerance, its cost that of the likelihood: a wide tolerance must pay for itself.

    Minus twice the logarithm of the likelihood, but for a constant that is the same for every change of the reading.
    """
    wide = fit(reading, at)
    near = fit(reading.closer, [wide.theta])
    wide = Fit(wide.theta, wide.cost + reading.certainty_lost())
    return min(wide, near, key=lambda item: item.cost)


def robust_fit(reading: Reading, at: Floats) -> Fit:
    """A fit that heeds an entry the less the farther it is off (Cauchy's weights, refitted a few times)."""
    weights = reading.weights
    found = fit(reading, [at], weights=weights)
    for _ in range(ROUNDS):
        off = shape_residual(reading, found.modes, reading.weights)
        found = fit(reading, [found.theta], weights=weights / np.sqrt(1 + (off / OUTLIER) ** 2))
    return found


def shape_residual(reading: Reading, of: Modes, weights: Floats) -> Floats:
    """Shapes of a frame less those read, each scaled to it by least squares, in standard deviations, shape (m, n)."""
    psi = weights * of.shapes[np.ix_(reading.modes, reading.floors)]
    read = weights * reading.scaled
    residual: Floats = _share(psi, read) * psi - read
    return residual


def _share(psi: Floats, read: Floats) -> Floats:
    """The factor on each row of psi that brings it nearest to the row read, shape (m, 1)."""
    length = np.sum(psi**2, axis=1, keepdims=True)
    share: Floats = np.sum(psi * read, axis=1, keepdims=True) / np.where(length > 0, length, 1.0)
    return share


def misfit(reading: Reading, of: Modes) -> float:
    """The first two sums above for a frame that is only of about the right proportions, its scale free."""
    off = np.log(of.frequencies[reading.modes]) - reading.log_frequencies
    shapes = shape_residual(reading, of, reading.weights)
    return float(np.sum(((off - off.mean()) / ABOUT) ** 2) + np.sum(shapes**2))


def farthest(reading: Reading, of: Modes) -> float:
    """The largest difference of a frequency or an entry from a frame with these modes, in standard deviations."""
    frequency = (np.log(of.frequencies[reading.modes]) - reading.log_frequencies) / reading.frequency_std
    shapes = shape_residual(reading, of, reading.weights)
    return float(max(np.max(np.abs(frequency)), np.max(np.abs(shapes))))


def _fitted(reading: Reading, start: Floats, weights: Floats | None, evaluations: int) -> Fit:
    problem = _Problem(reading, start, reading.weights if weights is None else weights)
    found = least_squares(
        problem.residual, np.zeros(len(start)), jac=problem.jacobian, method="lm", max_nfev=evaluations,
        ftol=CONVERGED, xtol=CONVERGED, gtol=CONVERGED,
    )  # fmt: skip
    return Fit(problem.theta(found.x), 2 * float(found.cost))


class _Problem:
    """Residuals and their derivatives by the change of theta from a start."""

    def __init__(self, reading: Reading, start: Floats, weights: Floats) -> None:
        self.reading, self.start, self.weights = reading, start, weights
        self.read = weights * reading.scaled
        self.frequency_std = reading.frequency_std
        N = reading.stories
        centred = np.eye(N) - np.full((N, N), 1 / N)
        self.prior = np.zeros((2 * N, 2 * N))
        self.prior[:N, :N] = np.eye(N) / MASS_SPREAD
        self.prior[N:, N:] = centred / STIFFNESS_SPREAD
        self.last: tuple[Floats, Floats, Floats] | None = None

    def theta(self, x: Floats) -> Floats:
        return self.start + np.clip(x, -WIDEST, WIDEST)

    def residual(self, x: Floats) -> Floats:
        return self._at(x)[0]

    def jacobian(self, x: Floats) -> Floats:
        return self._at(x)[1]

    def _at(self, x: Floats) -> tuple[Floats, Floats]:
        if self.last is None or not np.array_equal(self.last[0], x):
            self.last = (x.copy(), *self._evaluate(x))
        return self.last[1:]

    def _evaluate(self, x: Floats) -> tuple[Floats, Floats]:
        reading, theta = self.reading, self.theta(x)
        value = np.exp(theta)
        mass, stiffness = np.split(value, 2)
        system = shear_system(mass, stiffness)
        found = modes(system.M, system.K)
        dlam, dphi = mode_derivatives(found, system, reading.modes)
        off = 0.5 * np.log(found.eigenvalues[reading.modes]) - np.log(2 * np.pi) - reading.log_frequencies
        frequency = off / self.frequency_std
        d_frequency = 0.5 * dlam / found.eigenvalues[reading.modes] / self.frequency_std
        psi = self.weights * found.shapes[np.ix_(reading.modes, reading.floors)]
        share = _share(psi, self.read)
        d_shape = share * self.weights * dphi[:, :, reading.floors]
        length = np.linalg.norm(psi, axis=1, keepdims=True)
        unit = psi / np.where(length > 0, length, 1.0)
        d_shape -= unit * np.sum(unit * d_shape, axis=2, keepdims=True)
        measured = np.concatenate([d_frequency, d_shape.reshape(len(value), -1)], axis=1) * value[:, None]
        r = np.concatenate([frequency, (share * psi - self.read).ravel(), self.prior @ theta])
        return r, np.concatenate([measured.T, self.prior])
