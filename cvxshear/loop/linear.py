"""Linearised model at a fit: the change of the evidence with every further effect.

All hypotheses share one fit and the factorization of its derivatives. At their null values the effects do not influence
each other, so one evaluation with all of them gives every column.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import special

from cvxshear.effects import LocatedEffect
from cvxshear.effects.composition import slices
from cvxshear.fit.domain import domain_of
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.expectation import EffectPrior
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.evidence import log_interval
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats

MOST_TAKEN = 12
"""Largest number of effects added in one sequence. More are not credible, and fits of sets of twenty or more reach
their limit of steps without convergence."""

NORMAL = ((1.0, 1.0),)
STUDENT = ((0.8, 0.6), (1.6, 0.33), (4.0, 0.065), (12.0, 0.005))
"""Scale mixture of normal distributions in place of Student's t with four degrees of freedom: factors on the size, with
their weights. The mixture is accurate enough to rank the effects; the fit then uses the prior itself."""

WIDE = 4.0
"""Factor on an effect's size for its first prediction."""

LEAST_CURVATURE = 1e-9
"""Least curvature, relative to the fit's, of a direction that only residuals without weight determine."""

LOG_SIZES = np.linspace(-4.0, 4.0, 33)
"""Trial common sizes, as logarithms of factors, in units of their width."""


class Linearised:
    """Derivatives at a fit by its own parameters and by the parameters of effects that it lacks.

    Parameters
    ----------
    base : Estimate
    lacking : sequence of LocatedEffect
    expectation : EffectPrior
    """

    def __init__(self, base: Estimate, lacking: Sequence[LocatedEffect], expectation: EffectPrior) -> None:
        self.base = base
        self.lacking = list(lacking)
        self.expectation = expectation
        self._free = base.free_directions
        self._reached = base.fit.at.J @ self._free
        self._columns = self._sensitivities()
        self._own = self._columns - self._reached @ (self._reached.T @ self._columns)
        self._slope = self._own.T @ base.fit.at.r
        self._at = dict(slices(self.lacking, 0))
        self._singles = _Singles(self.lacking, expectation)

    def _sensitivities(self) -> Floats:
        """Compute the derivatives by the parameters of the lacking effects, at their null values, shape (d, p)."""
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

    def _shift(self, placed: LocatedEffect) -> Floats:
        """Find the least change of the frame, in typical units, that keeps all equalities with the effect."""
        scale, base = self.expectation.scale, self.base
        assert scale is not None
        n2 = 2 * base.experiment.stories
        unit = np.repeat([scale.floor_mass, scale.story_stiffness], n2 // 2)
        theta = np.concatenate([base.theta, placed.start])
        said = [each.constraints.A for each in domain_of(base.experiment, (*base.effects, placed), theta).statements]
        A = np.concatenate([np.zeros((0, len(theta))), *(rows for rows in said if rows is not None)])
        shift: Floats = -unit[:, None] * (np.linalg.pinv(A[:, :n2] * unit) @ A[:, len(base.theta) :])
        return shift

    def columns(self, placed: LocatedEffect) -> Floats:
        """Return the derivatives of the residuals by an effect's parameters and the frame's change, shape (d, p)."""
        return self._columns[:, self._at[placed]]

    def gain(self, placed: LocatedEffect) -> float:
        """Return the gain in log evidence with an effect, from the linearised model."""
        return float(self.gains[self.lacking.index(placed)])

    @cached_property
    def gains(self) -> Floats:
        """Gain in log evidence of each lacking effect, shape (n,)."""
        return self._gains(self._own, self.base.fit.at.r)

    def _gains(self, own: Floats, r: Floats) -> Floats:
        """Find the gains from columns orthogonal to the model's own, on the remaining residual."""
        found = np.empty(len(self.lacking))
        single = self._singles
        columns = own[:, single.columns]
        found[single.at] = single.gains(-(columns.T @ r), np.sum(columns**2, axis=0))
        for at in single.others:
            found[at] = self._gain_of_several(self.lacking[at], own[:, self._at[self.lacking[at]]], r)
        return found

    def _gain_of_several(self, placed: LocatedEffect, own: Floats, r: Floats) -> float:
        """Find the gain of an effect with several parameters, with one common size, or on the accuracy of data."""
        effect = placed.effect
        if effect.rescales:
            rows = self.base.misfit.rescaled_rows(self.base.fit.at, placed)
            return _gain_of_noise(self._reached[rows], r[rows], effect.size_width)
        b, h, stds = -(own.T @ r), own.T @ own, self.expectation.of(placed)
        if effect.common_size:
            return _gain_of_common_size(b, h, stds, effect.size_width)
        # Each parameter has its own prior: one may lie in its tail while another does not.
        factors, weights = np.moveaxis(np.array(list(itertools.product(_parts(placed), repeat=len(stds)))), -1, 0)
        each = factors * stds
        h = h + np.eye(len(stds)) / each[:, None, :] ** 2
        sign, log_det = np.linalg.slogdet(h)
        quadratic = np.linalg.solve(h, np.broadcast_to(b[:, None], (len(h), len(b), 1)))[:, :, 0] @ b
        constants = np.sum(_log_normal_constants(*_limits([placed]), each) + np.log(weights), axis=1)
        parts = np.where(sign > 0, constants + 0.5 * (quadratic - log_det), -np.inf)
        return float(np.logaddexp.reduce(parts))

    def _likely_sizes(self, placed: LocatedEffect) -> Floats:
        """Choose the standard deviations for a first prediction of an effect's parameters, shape (p,).

        Student's prior is widened by `WIDE`, so that the prediction does not shrink a large effect. A common size gets
        its most probable value.
        """
        stds = self.expectation.of(placed)
        if not placed.effect.common_size:
            return stds if np.isinf(placed.effect.tail) else WIDE * stds
        own = self._own[:, self._at[placed]]
        b, h = -(own.T @ self.base.fit.at.r), own.T @ own
        found: Floats = stds * np.exp(_best_log_size(b, h, stds, placed.effect.size_width))
        return found

    def forward(self, log_priors: Floats) -> list[LocatedEffect]:
        """List the effects that the linearised model adds in sequence, the most promising first, while it gains.

        Parameters
        ----------
        log_priors : ndarray, shape (n,)
            Logarithm of the prior odds of each lacking effect.
        """
        taken: list[LocatedEffect] = []
        open_to = np.array(log_priors)
        own, left, basis = self._own.copy(), self.base.fit.at.r.copy(), self._reached.copy()
        for _ in range(min(len(self.lacking), MOST_TAKEN)):
            gains = self._gains(own, left) + open_to
            at = ranking.first_largest(gains)
            if not gains[at] > 0.0:
                break
            best = self.lacking[at]
            taken.append(best)
            open_to[at] = -np.inf
            if best.effect.rescales:
                # Residuals with open accuracy have less weight in all further steps.
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

    def predicted(self, placed: Sequence[LocatedEffect]) -> Floats:
        """Find the minimum of the linearised model with these effects, each within its bounds.

        Returns
        -------
        ndarray, shape (P + p,)
            Parameters of the fit, then of the effects.
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

    def decrease(self, placed: LocatedEffect) -> float:
        """Return the decrease of chi-square with an effect within its bounds, without a prior on the effect."""
        own = self._at[placed]
        if own.start == own.stop:
            return 0.0
        h, slope = self._own[:, own].T @ self._own[:, own], self._slope[own]
        items = placed.effect.parameters
        lower, upper = np.array([[item.lower - item.null, item.upper - item.null] for item in items]).T
        change = np.clip(-np.linalg.lstsq(h, slope, rcond=None)[0], lower, upper)
        return float(-(2.0 * slope @ change + change @ h @ change))

    def confounders(self, placed: LocatedEffect, names: Sequence[str], share: float = 0.1) -> tuple[str, ...]:
        """List the parameters of the fit whose change imitates an effect; largest part first."""
        g = self._columns[:, self._at[placed]].sum(axis=1)
        part = np.abs(self._free @ (self._reached.T @ g)) * np.linalg.norm(self.base.fit.at.J, axis=0)
        order = ranking.order(part)
        return tuple(names[i] for i in order if part[i] > share * part[order[0]])

    def precision_gained(self, placed: LocatedEffect) -> float:
        """Return the ratio of the precisions of an effect's first parameter with the data and without."""
        own = self._at[placed]
        if own.start == own.stop:
            return np.inf
        first = self._own[:, own.start]
        std = self.expectation.of(placed)[0]
        item = placed.effect.parameters[0]
        usual = std if np.isfinite(std) else (item.upper - item.lower) / np.sqrt(12)
        return float(1.0 + (first @ first) * usual**2)


class _Singles:
    """One-parameter effects with their own priors; their gains are found together.

    Attributes
    ----------
    at, others : ndarray of int
        Places of these effects, and of the others, among the lacking effects.
    columns : ndarray of int
        Places of the parameters.
    lower, upper : ndarray, shape (n,)
        Bounds of the parameters, as distances from null.
    precision, constants : ndarray, shape (k, n)
        Precisions of the normal parts of each prior, and the logarithms of their weights with the priors' constants.
    """

    def __init__(self, lacking: Sequence[LocatedEffect], expectation: EffectPrior) -> None:
        alone = np.array(
            [len(p.effect.parameters) == 1 and not (p.effect.common_size or p.effect.rescales) for p in lacking],
            dtype=bool,
        )
        self.at, self.others = np.flatnonzero(alone), np.flatnonzero(~alone)
        self.columns = np.array([own.start for _, own in slices(lacking, 0)], dtype=np.int64)[alone]
        single = [placed for placed, of_one in zip(lacking, alone, strict=True) if of_one]
        self.lower, self.upper = _limits(single)
        stds = np.array([expectation.of(placed)[0] for placed in single])
        factors, weights = np.ones((2, len(STUDENT), len(single)))
        weights[1:] = 0.0
        tailed = [np.isfinite(placed.effect.tail) for placed in single]
        factors[:, tailed], weights[:, tailed] = np.array(STUDENT).T[:, :, None]
        self.precision = 1.0 / (factors * stds) ** 2
        with np.errstate(divide="ignore"):
            self.constants = np.log(weights) + _log_normal_constants(self.lower, self.upper, factors * stds)

    def gains(self, b: Floats, h: Floats) -> Floats:
        """Find the gain of each effect, shape (n,), from its slope b and its curvature h, which narrows the prior."""
        precision = h + self.precision
        untouched = precision <= 0.0
        std = 1.0 / np.sqrt(np.where(untouched, 1.0, precision))
        parts = self.constants + log_interval(self.lower, self.upper, -b, std) + np.log(std)
        # The data do not depend on the parameter; a uniform prior between its bounds stays uniform.
        even = self.constants + np.log(np.where(untouched, self.upper - self.lower, 1.0)) - 0.5 * np.log(2 * np.pi)
        found: Floats = np.logaddexp.reduce(np.where(untouched, even, parts), axis=0)
        return found


def _parts(placed: LocatedEffect) -> tuple[tuple[float, float], ...]:
    """Return the normal distributions that approximate the prior of an effect."""
    return NORMAL if np.isinf(placed.effect.tail) else STUDENT


def _limits(effects: Sequence[LocatedEffect]) -> tuple[Floats, Floats]:
    """Return the bounds of all parameters of the effects, as distances from null, each of shape (p,)."""
    items = [item for placed in effects for item in placed.effect.parameters]
    lower, upper = np.array([(item.lower - item.null, item.upper - item.null) for item in items]).reshape(-1, 2).T
    return lower, upper


def _log_normal_constants(lower: Floats, upper: Floats, stds: Floats) -> Floats:
    """Return the log constants of normal priors truncated at bounds, times sqrt(2 pi); uniform if a std is infinite."""
    flat = np.isinf(stds)
    with np.errstate(divide="ignore", invalid="ignore"):
        even = 0.5 * np.log(2 * np.pi) - np.log(upper - lower)
        normal = -np.log(stds) - np.log(special.ndtr(upper / stds) - special.ndtr(lower / stds))
    return np.where(flat, even, normal)


def _log_evidence_by_size(b: Floats, h: Floats, stds: Floats, width: float) -> tuple[Floats, Floats]:
    """Return the logarithms of common sizes and the gain in log evidence with each, parameters integrated out.

    In units of the sizes the information is V diag(l) V', the slope V c. With the factor e^u the gain is sum (c^2 e^2u
    / (1 + l e^2u) - log(1 + l e^2u)) / 2, and u is normal about zero.
    """
    values, vectors = np.linalg.eigh(stds[:, None] * h * stds)
    c = vectors.T @ (stds * b)
    u = width * LOG_SIZES
    square = np.exp(2.0 * u)[:, None]
    gained = 0.5 * np.sum(c**2 * square / (1.0 + np.maximum(values, 0.0) * square), axis=1)
    gained -= 0.5 * np.sum(np.log1p(np.maximum(values, 0.0) * square), axis=1)
    return u, gained - 0.5 * LOG_SIZES**2


def _gain_of_common_size(b: Floats, h: Floats, stds: Floats, width: float) -> float:
    """Compute the gain in log evidence by parameters of one common size, with the size integrated out."""
    _, gained = _log_evidence_by_size(b, h, stds, width)
    return float(np.logaddexp.reduce(gained) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2))


def _best_log_size(b: Floats, h: Floats, stds: Floats, width: float) -> float:
    """Find the logarithm of the most probable common size under the linearised model."""
    u, gained = _log_evidence_by_size(b, h, stds, width)
    return float(u[np.argmax(gained)])


def _log_evidence_by_noise(reached: Floats, r: Floats, width: float) -> tuple[Floats, Floats]:
    """Return logarithms u of factors on the deviation of some residuals, and the gain in log evidence with each.

    e^u = sqrt(1 + s^2) with the common size s. The fit follows: let m be these rows of the free directions, G = m'm, g
    = m'r and w = e^-2u. Then chi-square changes by (w - 1) r'r - (w - 1)^2 g' (1 + (w - 1) G)^-1 g.
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
    """Compute the gain in log evidence with open accuracy of some residuals, with the factor integrated out."""
    _, gained = _log_evidence_by_noise(reached, r, width)
    return float(np.logaddexp.reduce(gained) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2))


def _best_log_noise(reached: Floats, r: Floats, width: float) -> float:
    """Find the logarithm of the most probable factor on the deviation of some residuals."""
    u, gained = _log_evidence_by_noise(reached, r, width)
    return float(u[np.argmax(gained)])
