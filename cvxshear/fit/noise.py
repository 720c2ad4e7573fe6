"""Noise that nobody declared: a factor on the default standard deviations of each kind, estimated with the rest.

The logarithm u of a factor is normal about 0 before anything is measured: instruments and methods differ by factors
of two or four, not of a hundred. Given u the parameters are integrated out of the linearised model
(MacKay 1992), so that data which the parameters can follow do not pass for exact ones:

    log p(data, u) = -chi2(u) / 2 - sum n_g u_g - log det H(u) / 2 - sum u_g^2 / 2 w^2 + constant,

w that width, n_g the number of data of a kind, H(u) = sum exp(-2 u_g) J_g' J_g, chi2(u) the least of the linearised
residual.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg, optimize, special

from cvxshear.data import NOISES, Noise
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.util.typing import Floats, Json

WIDTH = 0.7
"""Standard deviation of the logarithm of a factor: two thirds of what is tested lie within half and twice the default,
nineteen in twenty within a quarter and four times."""

LARGEST_NOISE = {"frequency": 15.0, "mode_shape": 15.0, "displacement": 15.0}
"""Factors beyond which no instrument is as bad: frequencies uncertain to 3 %, shapes and displacements to 15 %."""

SHARPEST = 1e-12
"""Least ratio of the curvatures of two directions."""

STEP = 1e-3
"""Of the differences that give the curvature in u."""

NODES = 7
"""Points of the quadrature in each u: the marginal is skew where few data are left to tell the noise."""

LARGEST = 20.0
"""Change of a log factor beyond which an exponential is not worth its overflow."""


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Factors on the default standard deviations of what was left undeclared.

    Parameters
    ----------
    kinds : tuple of str
        Of `NOISES`.
    log_factors : ndarray, shape (g,)
    covariance : ndarray, shape (g, g)
        Of the logarithms.
    gain : float
        log p(data, u) here, u integrated out, less what -objective / 2 - log det H / 2 is here.
    """

    kinds: tuple[str, ...] = ()
    log_factors: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    gain: float = 0.0

    @property
    def noise(self) -> Noise:
        """The factors."""
        return Noise(tuple(zip(self.kinds, np.exp(self.log_factors).tolist(), strict=True)))

    def to_dict(self) -> Json:
        """For each kind its factor and the standard deviation of that; null where it was declared."""
        result: Json = dict.fromkeys(NOISES)
        for at, (kind, factor) in enumerate(self.noise.factors):
            result[kind] = {"factor": factor, "std": factor * float(np.sqrt(self.covariance[at, at]))}
        return result


def estimated_noise(misfit: Misfit, at: Evaluation, free: Floats) -> NoiseEstimate:
    """The noise that a fit speaks for.

    Parameters
    ----------
    misfit : Misfit
        With the noise of the fit.
    at : Evaluation
        At its optimum.
    free : ndarray, shape (P, f)
        Directions that the parameters are free to go, each of unit effect on the residuals.

    Returns
    -------
    NoiseEstimate
    """
    kinds = tuple(misfit.open_noises)
    if not kinds:
        return NoiseEstimate()
    marginal = _Marginal(misfit, at, free, kinds)
    best = optimize.fmin_bfgs(marginal.loss, marginal.here, fprime=marginal.slope, disp=False)
    # Where the marginal has no maximum the search runs off.
    u: Floats = np.clip(best, -LARGEST, LARGEST)
    covariance: Floats = np.asarray(np.linalg.inv(_curvature(marginal, u)), dtype=np.float64)
    return NoiseEstimate(kinds, u, covariance, _log_integral(marginal, u, covariance))


def _log_integral(of: _Marginal, u: Floats, covariance: Floats) -> float:
    """log of the integral of the marginal over u and its prior's constant, by Gauss and Hermite about its largest."""
    root = np.sqrt(2.0) * np.linalg.cholesky(covariance)
    nodes, weights = np.polynomial.hermite.hermgauss(NODES)
    points = np.array(list(itertools.product(nodes, repeat=len(u))))
    logs = np.array([sum(each) for each in itertools.product(np.log(weights) + nodes**2, repeat=len(u))])
    values = np.array([of.value(u + root @ point) for point in points]) + logs
    log_det = float(np.linalg.slogdet(root)[1])
    return float(special.logsumexp(values)) + log_det - len(u) * float(np.log(WIDTH * np.sqrt(2 * np.pi)))


class _Marginal:
    """log p(data, u) in the linearised model, relative to what it is without its terms in u at the fit's own noise."""

    def __init__(self, misfit: Misfit, at: Evaluation, free: Floats, kinds: tuple[str, ...]) -> None:
        self.here: Floats = np.log(np.array([misfit.noise.of(kind) for kind in kinds]))
        self._counts = np.array([misfit.open_noises[kind] for kind in kinds], dtype=float)
        rows = [at.noises == NOISES.index(kind) for kind in kinds]
        moved = [at.J[own] @ free for own in rows]
        self._information = np.array([part.T @ part for part in moved])
        self._gradient = np.array([part.T @ at.r[own] for part, own in zip(moved, rows, strict=True)])
        self._chi2 = np.array([float(at.r[own] @ at.r[own]) for own in rows])

    def negative(self, u: Floats) -> tuple[float, Floats]:
        """Minus it, but for the objective and log det H / 2 at the fit, and its derivative by u."""
        weight = np.exp(-2.0 * np.clip(u - self.here, -LARGEST, LARGEST))
        change = weight - 1.0
        H = np.eye(self._information.shape[1]) + np.tensordot(change, self._information, 1)
        try:
            factor = linalg.cho_factor(H, check_finite=False)
        except linalg.LinAlgError:
            return np.inf, np.zeros(len(u))
        gradient = change @ self._gradient
        step = -linalg.cho_solve(factor, gradient, check_finite=False)
        log_det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        value = -0.5 * (change @ self._chi2 + gradient @ step + log_det + u @ u / WIDTH**2) - self._counts @ u
        left = self._chi2 + 2.0 * self._gradient @ step + np.einsum("i,gij,j->g", step, self._information, step)
        known = np.array([np.trace(linalg.cho_solve(factor, part, check_finite=False)) for part in self._information])
        return -float(value), -(weight * (left + known) - self._counts - u / WIDTH**2)

    def loss(self, u: Floats) -> float:
        """Minus it."""
        return self.negative(u)[0]

    def slope(self, u: Floats) -> Floats:
        """Minus its derivative."""
        return self.negative(u)[1]

    def value(self, u: Floats) -> float:
        """It, but for the objective and log det H / 2 at the fit."""
        return -self.negative(u)[0]


def _curvature(of: _Marginal, u: Floats) -> Floats:
    """Minus the second derivatives, by differences of the first, at least those of the prior alone times a tenth.

    Nor is one direction known so much better than another that the inverse would lose its sign in rounding.
    """
    rows = [(of.negative(u + step)[1] - of.negative(u - step)[1]) / (2 * STEP) for step in STEP * np.eye(len(u))]
    values, vectors = np.linalg.eigh(0.5 * (np.array(rows) + np.array(rows).T))
    least = max(0.1 / WIDTH**2, SHARPEST * float(values[-1]))
    return np.asarray((vectors * np.maximum(values, least)) @ vectors.T)
