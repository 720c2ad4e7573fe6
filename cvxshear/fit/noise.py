"""Undeclared standard deviations: a factor on each default, estimated with the rest.

Each kind of noise has one, and so has the common size of the parameters of an effect with many parameters. The prior of
the logarithm u of a factor is normal about 0: instruments and methods differ by factors of two or four, not of a
hundred. For given u the parameters are integrated out of the linearized model (MacKay 1992), so that data which the
parameters can fit do not pass for exact data:

    log p(data, u) = -chi2(u) / 2 - sum n_g u_g - log det H(u) / 2 - sum u_g^2 / 2 w_g^2 + constant,

with the width w_g of the prior, the number n_g of residuals with this factor, H(u) = sum exp(-2 u_g) J_g' J_g, and the
minimum chi2(u) of the linearized residual with the priors of the parameters.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg, optimize, special

from cvxshear.data import NoiseFactors, noise_kinds
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.util.typing import Floats, Json

NODES = {1: 7, 2: 7, 3: 5, 4: 3}
"""Number of quadrature points in each u, by the number of factors: the marginal is skew if few data determine the
noise. With more factors, one point (Laplace's approximation)."""

LARGEST_LOG_CHANGE = 20.0
"""Largest change of a log factor, so that no exponential overflows."""


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Factors on the default standard deviations of undeclared noise.

    Parameters
    ----------
    kinds : tuple of str
        Names of noises, then labels of effects whose common size is unknown.
    log_factors : ndarray, shape (g,)
    covariance : ndarray, shape (g, g)
        Covariance of the logarithms.
    gain : float
        log p(data, u) of the linearized fit, u integrated out, without -objective / 2 - log det H / 2 of that fit.
    settled : bool
        Whether the fit was made with these factors.
    """

    kinds: tuple[str, ...] = ()
    log_factors: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    gain: float = 0.0
    settled: bool = True

    @property
    def noise(self) -> NoiseFactors:
        """The factors."""
        return NoiseFactors(tuple(zip(self.kinds, np.exp(self.log_factors).tolist(), strict=True)))

    def to_dict(self) -> Json:
        """Return for each kind its factor and the factor's standard deviation; null if declared."""
        return {kind: self.of(kind) for kind in noise_kinds()}

    def of(self, key: str) -> Json | None:
        """Return the factor of a noise or of an effect's size, and its standard deviation; None if declared."""
        if key not in self.kinds:
            return None
        at = self.kinds.index(key)
        factor = float(np.exp(self.log_factors[at]))
        return {"factor": factor, "std": factor * float(np.sqrt(self.covariance[at, at]))}


def estimated_noise(misfit: Misfit, at: Evaluation, free: Floats, *, here: bool = False) -> NoiseEstimate:
    """Estimate the undeclared noise from a fit.

    Parameters
    ----------
    misfit : Misfit
        Misfit with the noise of the fit.
    at : Evaluation
        At its optimum.
    free : ndarray, shape (P, f)
        Free directions of the parameters, each of unit effect on the residuals.
    here : bool, optional
        Keep the factors of the fit, as an estimate that did not converge.

    Returns
    -------
    NoiseEstimate
    """
    if not misfit.unknown:
        return NoiseEstimate()
    marginal = NoiseMarginal(misfit, at, free)
    best = marginal.start if here else optimize.minimize(marginal.negative, marginal.start, jac=True, method="BFGS").x
    # A marginal without maximum makes the search diverge.
    v: Floats = np.clip(best, -LARGEST_LOG_CHANGE, LARGEST_LOG_CHANGE)
    covariance: Floats = np.asarray(np.linalg.inv(marginal_curvature(marginal, v)), dtype=np.float64)
    kinds = tuple(item.key for item in misfit.unknown)
    u, slope = marginal.log_factors(v)
    spread = slope[:, None] * covariance * slope
    if here:
        local = -marginal.negative(v)[0] + 0.5 * float(np.linalg.slogdet(covariance)[1])
        local -= float(np.sum(np.log(marginal.widths)))
        return NoiseEstimate(kinds, u, spread, local, settled=False)
    return NoiseEstimate(kinds, u, spread, _log_integral(marginal, v, covariance))


def _log_integral(marginal: NoiseMarginal, u: Floats, covariance: Floats) -> float:
    """Compute the log of the integral of the marginal over u, by Gauss-Hermite quadrature about its maximum."""
    root = np.sqrt(2.0) * np.linalg.cholesky(covariance)
    nodes, weights = np.polynomial.hermite.hermgauss(NODES.get(len(u), 1))
    points = np.array(list(itertools.product(nodes, repeat=len(u))))
    logs = np.array([sum(each) for each in itertools.product(np.log(weights) + nodes**2, repeat=len(u))])
    values = marginal.values(u + points @ root.T) + logs
    log_det = float(np.linalg.slogdet(root)[1])
    return float(special.logsumexp(values)) + log_det - float(np.sum(np.log(marginal.widths * np.sqrt(2 * np.pi))))


class NoiseMarginal:
    """log p(data, u) of the linearised model, without the terms -objective / 2 and -log det H / 2 of the fit."""

    def __init__(self, misfit: Misfit, at: Evaluation, free: Floats) -> None:
        factors = [misfit.noise.of(item.key) for item in misfit.unknown]
        self._unknown = misfit.unknown
        self.here: Floats = np.log(np.array(factors))
        self.start = np.array([item.coordinate(factor) for item, factor in zip(misfit.unknown, factors, strict=True)])
        self.widths = np.array([item.width for item in misfit.unknown])
        self._counts = np.array([item.count for item in misfit.unknown], dtype=float)
        rows = [at.unknown == place for place in range(len(misfit.unknown))]
        moved = [at.J[own] @ free for own in rows]
        # The remaining slope is zero if the fit converged. It keeps the minimum of the linearized residual from being
        # negative. The gain of a further step at the fit's own factors does not count, since the step was not made.
        self._left = free.T @ (at.J.T @ at.r)
        self._information = np.array([part.T @ part for part in moved])
        self._gradient = np.array([part.T @ at.r[own] for part, own in zip(moved, rows, strict=True)])
        self._chi2 = np.array([float(at.r[own] @ at.r[own]) for own in rows])

    def log_factors(self, v: Floats) -> tuple[Floats, Floats]:
        """Return u and its derivatives at a value of the normal variables, both of shape (g,)."""
        found = [item.log_factor(float(value)) for item, value in zip(self._unknown, v, strict=True)]
        u, slope = np.array(found).T
        return u, slope

    def negative(self, v: Floats) -> tuple[float, Floats]:
        """Compute minus log p(data, u(v)), without these terms, and its derivative by v."""
        u, slope = self.log_factors(v)
        weight = np.exp(-2.0 * np.clip(u - self.here, -LARGEST_LOG_CHANGE, LARGEST_LOG_CHANGE))
        change = weight - 1.0
        H = np.eye(self._information.shape[1]) + np.tensordot(change, self._information, 1)
        try:
            factor = linalg.cho_factor(H, check_finite=False)
        except linalg.LinAlgError:
            return np.inf, np.zeros(len(v))
        gradient = self._left + change @ self._gradient
        step = -linalg.cho_solve(factor, gradient, check_finite=False)
        log_det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        prior = float(np.sum((v / self.widths) ** 2))
        value = -0.5 * (change @ self._chi2 + gradient @ step + self._left @ self._left + log_det + prior)
        value -= self._counts @ u
        left = self._chi2 + 2.0 * self._gradient @ step + np.einsum("i,gij,j->g", step, self._information, step)
        inverse = linalg.cho_solve(factor, np.eye(len(H)), check_finite=False)
        known = np.einsum("ij,gji->g", inverse, self._information)
        return -float(value), -(slope * (weight * (left + known) - self._counts) - v / self.widths**2)

    def values(self, points: Floats) -> Floats:
        """log p(data, u(v)), without those terms, at points v, shape (n, g): all at once, as one at a time is slow."""
        u = np.array([self.log_factors(v)[0] for v in points])
        change = np.exp(-2.0 * np.clip(u - self.here, -LARGEST_LOG_CHANGE, LARGEST_LOG_CHANGE)) - 1.0
        H = np.eye(self._information.shape[1]) + np.tensordot(change, self._information, 1)
        try:
            root = np.linalg.cholesky(H)
        except np.linalg.LinAlgError:
            return np.array([-self.negative(v)[0] for v in points])
        gradient = self._left + change @ self._gradient
        scaled = np.linalg.solve(root, gradient[..., None])[..., 0]
        log_det = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        prior = np.sum((points / self.widths) ** 2, axis=1)
        gained = np.sum(scaled**2, axis=1) - self._left @ self._left
        return np.asarray(0.5 * (gained - change @ self._chi2 - log_det - prior) - u @ self._counts)


def marginal_curvature(marginal: NoiseMarginal, u: Floats) -> Floats:
    """Compute minus the second derivatives of log p(data, u), by differences of the first, shape (g, g).

    Each eigenvalue is at least a tenth of the prior's and 1e-12 of the largest, so that the inverse exists.
    """
    change = 1e-3
    steps = change * np.eye(len(u))
    rows = [(marginal.negative(u + step)[1] - marginal.negative(u - step)[1]) / (2 * change) for step in steps]
    values, vectors = np.linalg.eigh(0.5 * (np.array(rows) + np.array(rows).T))
    least = max(0.1 / float(np.max(marginal.widths)) ** 2, 1e-12 * float(values[-1]))
    return np.asarray((vectors * np.maximum(values, least)) @ vectors.T)
