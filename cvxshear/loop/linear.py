"""The linearised model at a fit: what every effect that might be added would do to its evidence.

All that is looked for share a fit, and with it the factorization of its derivatives: at their null values the effects
leave each other alone, so one evaluation with all of them gives every column.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import special

from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.expectation import Expectation
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.evidence import log_interval
from cvxshear.util.typing import Floats

MOST_TAKEN = 40
"""Effects that are taken in one go at most."""

NORMAL = ((1.0, 1.0),)
STUDENT = ((0.8, 0.6), (1.6, 0.33), (4.0, 0.065), (12.0, 0.005))
"""A normal distribution, and Student's t with four degrees of freedom, as factors on the size with their weights: near
enough to rank what is worth a fit, which then has the prior itself."""

WIDE = 4.0
"""Factor on an effect's size under which its first prediction is made."""

LEAST_CURVATURE = 1e-9
"""Least curvature, relative to that of the fit, of a direction that only residuals without weight determine."""

LOG_SIZES = np.linspace(-4.0, 4.0, 33)
"""Common sizes that are tried, as logarithms of factors, in units of their width."""


class Linearised:
    """The derivatives at a fit by its own parameters and by those of effects that it lacks.

    Parameters
    ----------
    base : Estimate
    lacking : sequence of Placed
    expectation : Expectation
    """

    def __init__(self, base: Estimate, lacking: Sequence[Placed], expectation: Expectation) -> None:
        self.base = base
        self.lacking = list(lacking)
        self.expectation = expectation
        self._free = base.free_directions
        self._reached = base.fit.at.J @ self._free
        self._columns = self._sensitivities()
        self._own = self._columns - self._reached @ (self._reached.T @ self._columns)
        self._slope = self._own.T @ base.fit.at.r
        self._at = dict(slices(self.lacking, 0))

    def _sensitivities(self) -> Floats:
        """Derivatives of the residuals by the parameters that are lacking, at their null values, shape (d, p)."""
        base = self.base
        misfit = base.misfit
        nulls = np.array([item.null for placed in self.lacking for item in placed.effect.parameters])
        P = len(base.theta)
        whole = Misfit(base.experiment, (*base.effects, *self.lacking), misfit.leave_out, misfit.noise)
        found = whole.evaluate(np.concatenate([base.theta, nulls]), by=slice(P, None)).J
        columns = np.zeros((len(base.fit.at.r), found.shape[1]))
        columns[: base.fit.at.measured] = found[: base.fit.at.measured]
        for placed, own in slices(self.lacking, 0):
            if placed.effect.releases:
                columns[:, own] += base.fit.at.J[:, : 2 * base.experiment.stories] @ self._shift(placed)
        return columns

    def _shift(self, placed: Placed) -> Floats:
        """The least change of the frame, in typical units, that goes with the parameters of an effect's equalities."""
        scale = self.expectation.scale
        assert scale is not None
        n2 = 2 * self.base.experiment.stories
        unit = np.repeat([scale.floor_mass, scale.story_stiffness], n2 // 2)
        A = placed.effect.limits(self.base.experiment, placed.place).A
        assert A is not None
        shift: Floats = -unit[:, None] * (np.linalg.pinv(A[:, :n2] * unit) @ A[:, n2:])
        return shift

    def columns(self, placed: Placed) -> Floats:
        """Derivatives of the residuals by an effect's parameters, the frame following its equalities, shape (d, p)."""
        return self._columns[:, self._at[placed]]

    def gain(self, placed: Placed) -> float:
        """By how much the logarithm of the evidence grows with an effect, as the linearised model has it."""
        return self._gain(placed, self._own[:, self._at[placed]], self.base.fit.at.r)

    def _gain(self, placed: Placed, own: Floats, r: Floats) -> float:
        """The gain by columns that nothing else in the model can make, on what is left of the residual."""
        effect = placed.effect
        if effect.rescales:
            rows = self.base.misfit.rescaled_rows(self.base.fit.at, placed)
            return _gain_of_noise(self._reached[rows], r[rows], effect.size_width)
        b, h, stds = -(own.T @ r), own.T @ own, self.expectation.of(placed)
        if effect.common_size:
            return _gain_of_common_size(b, h, stds, effect.size_width)
        # Each parameter has a prior of its own: one may lie in its tail while another does not.
        parts = []
        for each in itertools.product(_parts(placed), repeat=len(stds)):
            factors, weights = np.array(each).T
            parts.append(np.log(np.prod(weights)) + self._gain_of_normal(placed, b, h, factors * stds))
        return float(np.logaddexp.reduce(parts))

    def _gain_of_normal(self, placed: Placed, b: Floats, h: Floats, stds: Floats) -> float:
        """The gain of parameters whose prior is normal, or even between bounds."""
        constants = _log_normal_constants(placed, stds)
        h = h + np.diag(1.0 / stds**2)
        (item, *more) = placed.effect.parameters
        if more:
            sign, log_det = np.linalg.slogdet(h)
            return constants + 0.5 * float(b @ np.linalg.solve(h, b) - log_det) if sign > 0 else -np.inf
        if h[0, 0] <= 0:
            # Nothing depends on it; what is even between its bounds stays so.
            return constants + float(np.log(item.upper - item.lower) - 0.5 * np.log(2 * np.pi))
        std = float(1.0 / np.sqrt(h[0, 0]))
        between = log_interval(item.lower - item.null, item.upper - item.null, -float(b[0]), std)
        return constants + between + float(np.log(std))

    def _likely_sizes(self, placed: Placed) -> Floats:
        """Standard deviations under which a first prediction of an effect's parameters is made, shape (p,).

        Those of Student's t are wide, so that a large effect is not held back; a common size is the best one.
        """
        stds = self.expectation.of(placed)
        if not placed.effect.common_size:
            return stds if np.isinf(placed.effect.tail) else WIDE * stds
        own = self._own[:, self._at[placed]]
        b, h = -(own.T @ self.base.fit.at.r), own.T @ own
        found: Floats = stds * np.exp(_best_log_size(b, h, stds, placed.effect.size_width))
        return found

    def forward(self, log_priors: Sequence[float]) -> list[Placed]:
        """Effects that the linearised model takes one after the other, the most promising first, while it gains.

        Parameters
        ----------
        log_priors : sequence of float
            Logarithm of the prior odds of each effect that is lacking.
        """
        taken: list[Placed] = []
        own, left, basis = self._own.copy(), self.base.fit.at.r.copy(), self._reached.copy()
        for _ in range(min(len(self.lacking), MOST_TAKEN)):
            gains = {
                placed: self._gain(placed, own[:, self._at[placed]], left) + log_prior
                for placed, log_prior in zip(self.lacking, log_priors, strict=True)
                if placed not in taken
            }
            best = max(gains, key=lambda each: gains[each])
            if not gains[best] > 0.0:
                break
            taken.append(best)
            if best.effect.rescales:
                # Residuals whose accuracy is left open weigh less in all that follows.
                rows = self.base.misfit.rescaled_rows(self.base.fit.at, best)
                weight = np.exp(-_best_log_noise(self._reached[rows], left[rows], best.effect.size_width))
                basis[rows] *= weight
                own[rows] *= weight
                left[rows] *= weight
                basis, _ = np.linalg.qr(basis)
            else:
                basis, _ = np.linalg.qr(np.column_stack([basis, own[:, self._at[best]]]))
            own, left = own - basis @ (basis.T @ own), left - basis @ (basis.T @ left)
        return taken

    def pair_gains(self) -> Floats:
        """The same for each pair of effects of one parameter, shape (n, n); -inf where a bound is not kept."""
        single = [each for each in self.lacking if len(each.effect.parameters) == 1 and not each.effect.common_size]
        at = [self._at[placed].start for placed in single]
        n = len(self.lacking)
        result = np.full((n, n), -np.inf)
        if len(single) < 2:
            return result
        own, b = self._own[:, at], -self._slope[at]
        gram = own.T @ own
        limits = [(p.effect.parameters[0].lower, p.effect.parameters[0].upper) for p in single]
        nulls = np.array([p.effect.parameters[0].null for p in single])
        lower, upper = np.array([low for low, _ in limits]) - nulls, np.array([high for _, high in limits]) - nulls
        precision, constants = self._normal_parts(single)
        value = np.full(gram.shape, -np.inf)
        for i, j in itertools.product(range(len(precision)), repeat=2):
            a, c = (np.diag(gram) + precision[i])[:, None], (np.diag(gram) + precision[j])[None, :]
            determinant = a * c - gram**2
            with np.errstate(divide="ignore", invalid="ignore"):
                first = (c * b[:, None] - gram * b[None, :]) / determinant
                second = (a * b[None, :] - gram * b[:, None]) / determinant
                part = 0.5 * (first * b[:, None] + second * b[None, :]) - 0.5 * np.log(determinant)
            inside = (first >= lower[:, None]) & (first <= upper[:, None]) & (second >= lower) & (second <= upper)
            part = np.where(inside & (determinant > 1e-9 * a * c), part, -np.inf)
            value = np.logaddexp(value, part + constants[i][:, None] + constants[j])
        np.fill_diagonal(value, -np.inf)
        places = [self.lacking.index(placed) for placed in single]
        result[np.ix_(places, places)] = value
        return result

    def _normal_parts(self, single: Sequence[Placed]) -> tuple[Floats, Floats]:
        """Precisions and logarithms of the weights, constants included, of the normal parts of each prior, (k, n)."""
        precision, constants = np.zeros((2, len(STUDENT), len(single)))
        constants -= np.inf
        for at, placed in enumerate(single):
            stds = self.expectation.of(placed)
            for part, (factor, weight) in enumerate(_parts(placed)):
                precision[part, at] = 1.0 / (factor * stds[0]) ** 2
                constants[part, at] = np.log(weight) + _log_normal_constants(placed, factor * stds)
        return precision, constants

    def predicted(self, placed: Sequence[Placed]) -> Floats:
        """Where the linearised model has its minimum with these effects, each kept within its bounds.

        Returns
        -------
        ndarray, shape (P + p,)
            The parameters of the fit, then the effects'.
        """
        placed = [each for each in placed if each.effect.parameters]
        if not placed:
            return self.base.theta
        columns = np.concatenate([np.arange(self._at[each].start, self._at[each].stop) for each in placed])
        items = [item for each in placed for item in each.effect.parameters]
        precision = np.concatenate([1.0 / self._likely_sizes(each) ** 2 for each in placed])
        null = np.array([item.null for item in items])
        h = self._own[:, columns].T @ self._own[:, columns] + np.diag(precision)
        change = -np.linalg.lstsq(h, self._slope[columns], rcond=None)[0]
        values = np.clip(null + change, [item.lower for item in items], [item.upper for item in items])
        g = self._columns[:, columns] @ (values - null)
        theta = self.base.theta - self._free @ (self._reached.T @ (self.base.fit.at.r + g))
        for each in placed:
            if each.effect.releases:
                own = slice(self._at[each].start, self._at[each].stop)
                at = [int(np.flatnonzero(columns == i)[0]) for i in range(own.start, own.stop)]
                theta[: 2 * self.base.experiment.stories] += self._shift(each) @ (values - null)[at]
        return np.concatenate([theta, values])

    def decrease(self, placed: Placed) -> float:
        """By how much chi-square falls with an effect kept within its bounds, nothing being expected of it."""
        own = self._at[placed]
        if own.start == own.stop:
            return 0.0
        h, slope = self._own[:, own].T @ self._own[:, own], self._slope[own]
        items = placed.effect.parameters
        lower, upper = np.array([[item.lower - item.null, item.upper - item.null] for item in items]).T
        change = np.clip(-np.linalg.lstsq(h, slope, rcond=None)[0], lower, upper)
        return float(-(2.0 * slope @ change + change @ h @ change))

    def confounders(self, placed: Placed, names: Sequence[str], share: float = 0.1) -> tuple[str, ...]:
        """The parameters of the fit whose change does what an effect does; largest part first."""
        g = self._columns[:, self._at[placed]].sum(axis=1)
        part = np.abs(self._free @ (self._reached.T @ g)) * np.linalg.norm(self.base.fit.at.J, axis=0)
        order = np.argsort(-part, kind="stable")
        return tuple(names[i] for i in order if part[i] > share * part[order[0]])

    def told(self, placed: Placed) -> float:
        """How much more surely its first parameter is known with the data than without, as a ratio of precisions."""
        own = self._at[placed]
        if own.start == own.stop:
            return np.inf
        first = self._own[:, own.start]
        std = self.expectation.of(placed)[0]
        item = placed.effect.parameters[0]
        usual = std if np.isfinite(std) else (item.upper - item.lower) / np.sqrt(12)
        return float(1.0 + (first @ first) * usual**2)


def _parts(placed: Placed) -> tuple[tuple[float, float], ...]:
    """The normal distributions that stand for the prior of an effect."""
    return NORMAL if np.isinf(placed.effect.tail) else STUDENT


def _log_normal_constants(placed: Placed, stds: Floats) -> float:
    """Logarithm of the constants of normal priors, truncated at bounds, times sqrt(2 pi) for each parameter."""
    value = 0.0
    for item, std in zip(placed.effect.parameters, stds, strict=True):
        if np.isinf(std):
            value += 0.5 * np.log(2 * np.pi) - np.log(item.upper - item.lower)
        else:
            below, above = (item.lower - item.null) / std, (item.upper - item.null) / std
            value -= np.log(std) + np.log(special.ndtr(above) - special.ndtr(below))
    return float(value)


def _log_evidence_by_size(b: Floats, h: Floats, stds: Floats, width: float) -> tuple[Floats, Floats]:
    """Logarithms of common sizes, and the log evidence gained with each, the parameters integrated out.

    In units of the sizes the information is V diag(l) V', the slope V c: with the factor e^u the gain is
    sum (c^2 e^2u / (1 + l e^2u) - log(1 + l e^2u)) / 2, and u is normal about zero.
    """
    values, vectors = np.linalg.eigh(stds[:, None] * h * stds)
    c = vectors.T @ (stds * b)
    u = width * LOG_SIZES
    square = np.exp(2.0 * u)[:, None]
    gained = 0.5 * np.sum(c**2 * square / (1.0 + np.maximum(values, 0.0) * square), axis=1)
    gained -= 0.5 * np.sum(np.log1p(np.maximum(values, 0.0) * square), axis=1)
    return u, gained - 0.5 * LOG_SIZES**2


def _gain_of_common_size(b: Floats, h: Floats, stds: Floats, width: float) -> float:
    """The log evidence gained by parameters of one common size, that size integrated out."""
    _, gained = _log_evidence_by_size(b, h, stds, width)
    return float(np.logaddexp.reduce(gained) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2))


def _best_log_size(b: Floats, h: Floats, stds: Floats, width: float) -> float:
    """The logarithm of the common size that the linearised model finds most probable."""
    u, gained = _log_evidence_by_size(b, h, stds, width)
    return float(u[np.argmax(gained)])


def _log_evidence_by_noise(reached: Floats, r: Floats, width: float) -> tuple[Floats, Floats]:
    """Logarithms u of factors on the deviation of some residuals, and the log evidence gained with each.

    e^u = sqrt(1 + s^2), s having a common size. The fit follows: with G = m'm and g = m'r of these rows m of the free
    directions and w = e^-2u, chi-square changes by (w - 1) r'r - (w - 1)^2 g' (1 + (w - 1) G)^-1 g.
    """
    values, vectors = np.linalg.eigh(reached.T @ reached)
    c = vectors.T @ (reached.T @ r)
    u = 0.5 * np.logaddexp(0.0, 2.0 * width * LOG_SIZES)
    change = np.expm1(-2.0 * u)[:, None]
    left = np.maximum(1.0 + change * values, LEAST_CURVATURE)
    chi2 = change[:, 0] * float(r @ r) - np.sum(change**2 * c**2 / left, axis=1)
    gained = -0.5 * chi2 - 0.5 * np.sum(np.log(left), axis=1) - np.count_nonzero(r) * u - 0.5 * LOG_SIZES**2
    return u, gained


def _gain_of_noise(reached: Floats, r: Floats, width: float) -> float:
    """The log evidence gained where the accuracy of some residuals is left open, its factor integrated out."""
    _, gained = _log_evidence_by_noise(reached, r, width)
    return float(np.logaddexp.reduce(gained) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2))


def _best_log_noise(reached: Floats, r: Floats, width: float) -> float:
    """The logarithm of the factor on the deviation of some residuals that is most probable."""
    u, gained = _log_evidence_by_noise(reached, r, width)
    return float(u[np.argmax(gained)])
