"""Linear-Gaussian algebra: unknown sizes, Student's tails, intervals, and the distance between two models.

**Unknown sizes.** An undeclared standard deviation is a factor on a default, and so is the common size of the
parameters of an effect with many parameters. The prior of the logarithm u of a factor is normal about 0: instruments
and methods differ by factors of two or four, not of a hundred. For given u the parameters are integrated out of the
linearized model (MacKay 1992), so that data which the parameters can fit do not pass for exact data:

    log p(data, u) = -chi2(u) / 2 - sum n_g u_g - log det H(u) / 2 - sum u_g^2 / 2 w_g^2 + constant,

with the width w_g of the prior, the number n_g of residuals with this factor, H(u) = sum exp(-2 u_g) J_g' J_g, and the
minimum chi2(u) of the linearized residual with the priors of the parameters.

**Distance.** The predictions of two models differ by d, in standard deviations of a test's noise. The uncertainty of
each model moves its own prediction along columns S, one standard deviation per column. So d has the covariance
1 + S S', and the distance between the models, in standard deviations, is sqrt(d' (1 + S S')^-1 d). The same formula
holds for effects before any fit: d is then the change of the data by each effect, and S the possible change by the
frame's masses and stiffnesses.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import integrate, linalg, special

from cvxshear.util.typing import Floats

#: Smallest start of the square of an additional error, relative to the declared one.
LEAST_SQUARE = 1e-2

#: Number of quadrature points in each u, by the number of factors: the marginal is skew if few data determine the
#: noise. With more factors, one point (Laplace's approximation).
NODES = {1: 7, 2: 7, 3: 5, 4: 3}

#: Largest change of a log factor, so that no exponential overflows.
LARGEST_LOG_CHANGE = 20.0

#: Points of the integral over one log size, in units of its width (one for Student's t).
LOG_SIZES = np.linspace(-4.0, 4.0, 33)

#: Reach of the integral over a parameter, as the inverse hyperbolic sine of standard deviations: the tails of Student's
#: t need a longer one than a Gaussian.
INTEGRAL_REACH = 12.0

#: Largest log probability above the optimum. A higher point shows that the optimum is only a lower second mode, which
#: lies between a large effect and its null value if the data are weak.
SECOND_MODE = 5.0


@dataclass(frozen=True)
class UnknownSize:
    """An undeclared standard deviation: the logarithm of a factor on it is estimated with the rest.

    Parameters
    ----------
    key : str
        Kind of noise, or label of the effect with this common size or this noise.
    count : float
        Number of data, or of parameters, that have it.
    width : float
        Prior standard deviation of the logarithm of the factor.
    above_one : bool
        Whether the factor is sqrt(1 + s^2) with log s normal: an error in addition to a declared one. Otherwise the
        factor itself has a normal logarithm.
    """

    key: str
    count: float
    width: float
    above_one: bool = False

    def log_factor(self, v: float) -> tuple[float, float]:
        """Return the logarithm of the factor and its derivative at a value v of the normal variable."""
        if not self.above_one:
            return v, 1.0
        return 0.5 * float(np.logaddexp(0.0, 2.0 * v)), float(special.expit(2.0 * v))

    def coordinate(self, factor: float) -> float:
        """Return the value v of a factor."""
        if not self.above_one:
            return float(np.log(factor))
        return 0.5 * float(np.log(max(np.expm1(2.0 * np.log(factor)), LEAST_SQUARE)))


class SizeMarginal:
    """log p(data, u) of a linear model, without the terms -objective / 2 and -log det H / 2 at its own factors.

    Parameters
    ----------
    sizes : sequence of UnknownSize
    factors : sequence of float
        Factors of the model.
    moved : sequence of ndarray, shape (n_g, f)
        Changes of the residuals with each factor, along the free directions of the parameters. All residuals together
        change by one along each of these directions.
    residuals : sequence of ndarray, shape (n_g,)
        Residuals with each factor.
    left : ndarray, shape (f,), optional
        Slope of all residuals along the free directions. Default: zero, as at a minimum.
    """

    def __init__(
        self,
        sizes: Sequence[UnknownSize],
        factors: Sequence[float],
        moved: Sequence[Floats],
        residuals: Sequence[Floats],
        left: Floats | None = None,
    ) -> None:
        self._sizes = sizes
        self.here: Floats = np.log(np.array(factors))
        self.start = np.array([item.coordinate(factor) for item, factor in zip(sizes, factors, strict=True)])
        self.widths = np.array([item.width for item in sizes])
        self._counts = np.array([item.count for item in sizes], dtype=float)
        # The slope keeps the minimum of the linearized residual from being negative. The gain of a further step at the
        # model's own factors does not count, since the step was not made.
        self._left = np.zeros(moved[0].shape[1]) if left is None else left
        self._information = np.array([part.T @ part for part in moved])
        self._gradient = np.array([part.T @ r for part, r in zip(moved, residuals, strict=True)])
        self._chi2 = np.array([float(r @ r) for r in residuals])

    def log_factors(self, v: Floats) -> tuple[Floats, Floats]:
        """Return u and its derivatives at a value of the normal variables, both of shape (g,)."""
        found = [item.log_factor(float(value)) for item, value in zip(self._sizes, v, strict=True)]
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

    def curvature(self, v: Floats) -> Floats:
        """Compute minus the second derivatives of log p(data, u), by differences of the first, shape (g, g).

        Each eigenvalue is at least a tenth of the prior's and 1e-12 of the largest, so that the inverse exists.
        """
        change = 1e-3
        steps = change * np.eye(len(v))
        rows = [(self.negative(v + step)[1] - self.negative(v - step)[1]) / (2 * change) for step in steps]
        values, vectors = np.linalg.eigh(0.5 * (np.array(rows) + np.array(rows).T))
        least = max(0.1 / float(np.max(self.widths)) ** 2, 1e-12 * float(values[-1]))
        return np.asarray((vectors * np.maximum(values, least)) @ vectors.T)

    def log_integral(self, v: Floats, covariance: Floats) -> float:
        """Compute the log of the integral over v, by Gauss-Hermite quadrature about a maximum of this covariance."""
        root = np.sqrt(2.0) * np.linalg.cholesky(covariance)
        nodes, weights = np.polynomial.hermite.hermgauss(NODES.get(len(v), 1))
        points = np.array(list(itertools.product(nodes, repeat=len(v))))
        logs = np.array([sum(each) for each in itertools.product(np.log(weights) + nodes**2, repeat=len(v))])
        values = self.values(v + points @ root.T) + logs
        log_det = float(np.linalg.slogdet(root)[1])
        return float(special.logsumexp(values)) + log_det - float(np.sum(np.log(self.widths * np.sqrt(2 * np.pi))))

    def over_grid(self) -> tuple[float, float]:
        """Return, for a single size, the log of its integral over a grid and the log of its most probable factor."""
        points = self.widths[0] * LOG_SIZES
        values = self.values(points[:, None])
        integral = float(np.logaddexp.reduce(values) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2))
        return integral, self._sizes[0].log_factor(float(points[np.argmax(values)]))[0]


def gains_by_size(slope: Floats, curvature: Floats, log_sizes: Floats) -> Floats:
    """Return the gain in log evidence by parameters x of each common size, integrated out, shape (sizes,).

    The log likelihood is slope'x - x'curvature x / 2, x in units of its default sizes. With curvature = V diag(l) V',
    slope = V c and the factor e^u on the sizes, the gain is sum (c^2 e^2u / (1 + l e^2u) - log(1 + l e^2u)) / 2.
    """
    values, vectors = np.linalg.eigh(curvature)
    c = vectors.T @ slope
    square = np.exp(2.0 * log_sizes)[:, None]
    wider = 1.0 + np.maximum(values, 0.0) * square
    return np.asarray(0.5 * np.sum(c**2 * square / wider - np.log(wider), axis=1))


def student_weights(tail: float) -> Floats:
    """Write Student's t as a mixture of normal distributions with the log sizes `LOG_SIZES`: the logs of their weights.

    The inverse variance of a component has a gamma distribution. A normal distribution (infinite tail) has the size 1
    alone.
    """
    if np.isinf(tail):
        return np.where(LOG_SIZES == 0.0, 0.0, -np.inf)
    logs = -tail * LOG_SIZES - 0.5 * tail * np.exp(-2.0 * LOG_SIZES)
    return np.asarray(logs - np.logaddexp.reduce(logs))


def tailed(z: Floats, tail: float) -> tuple[Floats, Floats]:
    """Compute residuals with the squares -2 log of Student's t over its largest value, and their derivatives.

    A normal distribution with an uncertain variance is Student's t; large sizes, which occur now and then, stay
    possible. With v degrees of freedom r = sign(z) sqrt((v + 1) log(1 + z^2 / v)).

    Parameters
    ----------
    z : ndarray
        Deviations in standard sizes.
    tail : float
        v; infinite for a normal distribution, with the residual z.

    Returns
    -------
    r, slope : ndarray
    """
    if np.isinf(tail):
        return z, np.ones_like(z)
    r = np.sign(z) * np.sqrt((tail + 1.0) * np.log1p(z**2 / tail))
    # Near zero r is proportional to z to rounding.
    near = np.abs(z) < 1e-6
    slope = (tail + 1.0) * z / (tail + z**2) / np.where(near, 1.0, r)
    return r, np.where(near, np.sqrt((tail + 1.0) / tail), slope)


def log_normal_between(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return log(Phi(b) - Phi(a)), without loss in either tail; -inf if the interval is empty."""
    a, b = np.asarray(a), np.asarray(b)
    high, low = special.log_ndtr(np.where(a > 0, -a, b)), special.log_ndtr(np.where(a > 0, -b, a))
    with np.errstate(divide="ignore"):
        found: Floats = high + np.log(-np.expm1(np.minimum(low - high, 0.0)))
    return found


def log_interval(lower: ArrayLike, upper: ArrayLike, slope: ArrayLike, std: ArrayLike) -> Floats:
    """Return log of the integral of exp(-slope t - t^2 / 2 std^2) / (sqrt(2 pi) std) from lower to upper."""
    slope, std = np.asarray(slope), np.asarray(std)
    shift = slope * std
    found: Floats = 0.5 * shift**2 + log_normal_between(lower / std + shift, upper / std + shift)
    return found


def log_tailed_interval(
    lower: float, upper: float, slope: float, std: float, deviation: float, size: float, tail: float, points: int = 401
) -> float:
    """Return the log integral of a parameter with Student's prior, which replaces Laplace's Gaussian integral.

    Laplace takes exp(-slope t - t^2 / 2 std^2) about the optimum, 1 / std^2 = a + w^2 with w the slope of the prior's
    residual there. Only the likelihood, of curvature a, stays normal; the prior is exact:

        integral of exp(-(r(t)^2 - r(0)^2) / 2 - (slope - r(0) w) t - a t^2 / 2) dt / (sqrt(2 pi) std).

    Parameters
    ----------
    lower, upper : float
        Limits of t.
    slope, std : float
        As in `log_interval`.
    deviation : float
        Deviation of the optimum from the null value.
    size, tail : float
        Size and degrees of freedom of the prior.
    points : int, optional
        Number of points of the integral.
    """
    reach = np.arcsinh(np.clip(np.array([lower, upper]) / std, -np.sinh(INTEGRAL_REACH), np.sinh(INTEGRAL_REACH)))
    y = np.linspace(reach[0], reach[1], points)
    t = std * np.sinh(y)
    r, _ = tailed((deviation + t) / size, tail)
    here, unit_slope = tailed(np.array([deviation / size]), tail)
    w = float(unit_slope[0]) / size
    curvature = max(1.0 / std**2 - w**2, 0.0)
    logs = -0.5 * (r**2 - here[0] ** 2) - (slope - here[0] * w) * t - 0.5 * curvature * t**2
    if float(np.max(logs)) > SECOND_MODE:
        # The fit is not at the posterior's maximum along this line, so Laplace's Gaussian is the only usable form.
        return float(log_interval(lower, upper, slope, std))
    logs += np.log(np.cosh(y)) - 0.5 * np.log(2 * np.pi)
    highest = float(np.max(logs))
    return highest + float(np.log(integrate.trapezoid(np.exp(logs - highest), y)))


def separation(differences: Floats, uncertain: Floats) -> Floats:
    """Compute squared distances of models, d' (1 + S S')^-1 d; entries off the diagonal are their scalar products.

    Parameters
    ----------
    differences : ndarray, shape (k, e)
        d, a column a model, in standard deviations of the noise.
    uncertain : ndarray, shape (k, q)
        S.

    Returns
    -------
    ndarray, shape (e, e)
    """
    k, q = uncertain.shape
    if k <= q:
        # The left singular vectors of S span all k dimensions, and no large variance is inverted.
        left, values, _ = np.linalg.svd(uncertain, full_matrices=False)
        along = (left.T @ differences) / np.hypot(1.0, values)[:, None]
        return np.asarray(along.T @ along, dtype=np.float64)
    # The same as the residual of d after a regularized fit by the columns of S.
    basis = np.linalg.qr(np.concatenate([uncertain, np.eye(q)]))[0]
    left = np.concatenate([differences, np.zeros((q, differences.shape[1]))])
    left = left - basis @ (basis.T @ left)
    return np.asarray(left.T @ left, dtype=np.float64)
