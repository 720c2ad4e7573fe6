"""Linearised model at a fit: the change of the evidence with every further effect, and the twins of an effect.

All hypotheses share one fit and the factorization of its derivatives. At their null values the effects do not influence
each other, so one evaluation with all of them gives every column.

Twins are effects that can replace each other in a model without any change of the data. Effect A has the twin B if the
derivatives of the data by A lie in the span of the derivatives by the frame and by B, to rounding. For example, if all
floor masses of a state grow by one factor, every frequency falls in the same way as if all its stories were softer.
Twins depend on the model and the measured quantities, not on the sets that a search visited.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy import linalg, special

from cvxshear.effects import LocatedEffect, composition
from cvxshear.fit import domain, gaussian
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.fitter import free_basis
from cvxshear.loop.hypotheses import OPEN
from cvxshear.util import decorators, ranking
from cvxshear.util.typing import Floats

#: Rounding: share of an effect's derivatives outside the span of the others that counts as zero.
EXACT = 1e-5

#: Smallest share of an effect's derivatives outside the span of the frame. An effect with less is redundant and needs
#: no twin.
BEYOND_FRAME = 1e-3


class Linearised:
    """Derivatives at a fit by its own parameters and by the parameters of effects that it lacks.

    Parameters
    ----------
    base : Estimate
    candidates : sequence of LocatedEffect
    expectation : EffectPrior
    """

    def __init__(self, base: Estimate, candidates: Sequence[LocatedEffect], expectation: domain.EffectPrior) -> None:
        self.base = base
        self.candidates = list(candidates)
        self.expectation = expectation
        self._free = base.free_directions
        self._reached = base.fit.at.J @ self._free
        self._at = dict(composition.slices(self.candidates, 0))
        self._columns = self._sensitivities()
        self._own = self._columns - self._reached @ (self._reached.T @ self._columns)
        self._slope = self._own.T @ base.fit.at.r
        self._singles = _Singles(self.candidates, expectation)

    def _sensitivities(self) -> Floats:
        """Compute the derivatives by the parameters of the candidates, at their null values, shape (d, p).

        The candidates take turns: every effect copies the derivatives of the matrices, of all effects beside it too.
        """
        base, size = self.base, sum(len(placed.effect.parameters) for placed in self.candidates)
        columns = np.zeros((len(base.fit.at.r), size))
        for some in _alike(self.candidates):
            places = np.concatenate([np.arange(size)[self._at[placed]] for placed in some])
            columns[: base.fit.at.measured, places] = base.misfit.slopes_by(base.theta, some)
        for placed, own in composition.slices(self.candidates, 0):
            if placed.effect.releases:
                columns[:, own] += base.fit.at.J[:, : base.experiment.parameters] @ self._shift(placed)
        return columns

    def _shift(self, placed: LocatedEffect) -> Floats:
        """Find the least change of the frame, in typical units, that keeps all equalities with the effect."""
        scale, base = self.expectation.scale, self.base
        assert scale is not None
        unit = scale.units
        theta = np.concatenate([base.theta, placed.start])
        said = [
            each.constraints.A for each in domain.domain_of(base.experiment, (*base.effects, placed), theta).statements
        ]
        A = np.concatenate([np.zeros((0, len(theta))), *(rows for rows in said if rows is not None)])
        shift: Floats = -unit[:, None] * (np.linalg.pinv(A[:, : len(unit)] * unit) @ A[:, len(base.theta) :])
        return shift

    @property
    def parameters(self) -> int:
        """Number of parameters of the candidates."""
        return int(self._columns.shape[1])

    @decorators.cached_property
    def gains(self) -> Floats:
        """Gain in log evidence of each candidate, shape (n,)."""
        return self._gains(self._own, self.base.fit.at.r)

    def _gains(self, own: Floats, r: Floats) -> Floats:
        """Find the gains from columns orthogonal to the model's own, on the remaining residual."""
        found = np.empty(len(self.candidates))
        single = self._singles
        columns = own[:, single.columns]
        found[single.at] = single.gains(-(columns.T @ r), np.sum(columns**2, axis=0))
        for at in single.others:
            placed = self.candidates[at]
            if placed.effect.rescales:
                found[at] = self._noise(placed, self._reached, r)[0]
            else:
                gains, _ = self._gains_by_size(placed, own[:, self._at[placed]], r)
                found[at] = float(np.logaddexp.reduce(gains))
        return found

    def _noise(self, placed: LocatedEffect, reached: Floats, r: Floats) -> tuple[float, float]:
        """Find the gain with open accuracy of some residuals, and the log of the most probable factor on it."""
        rows = self.base.misfit.rescaled_rows(self.base.fit.at, placed)
        size = gaussian.UnknownSize(
            placed.label, float(np.count_nonzero(r[rows])), placed.effect.size_width, above_one=True
        )
        return gaussian.SizeMarginal([size], [1.0], [reached[rows]], [r[rows]], reached.T @ r).over_grid()

    def _gains_by_size(self, placed: LocatedEffect, own: Floats, r: Floats) -> tuple[Floats, Floats]:
        """Find the gain with each common log size of an effect's parameters, weighted by its prior; and these sizes.

        The parameters of an effect with Student's prior have one size here: that is accurate enough for a ranking.
        """
        effect, stds = placed.effect, self._sizes(placed)
        if effect.common_size:
            sizes, weights = effect.size_width * gaussian.LOG_SIZES, -0.5 * gaussian.LOG_SIZES**2
            weights = weights - np.logaddexp.reduce(weights)
        else:
            sizes, weights = gaussian.LOG_SIZES, gaussian.student_weights(effect.tail)
        gains = gaussian.gains_by_size(-stds * (own.T @ r), stds[:, None] * (own.T @ own) * stds, sizes)
        lower, upper = _limits([placed])
        cut = np.log(special.ndtr(upper / stds) - special.ndtr(lower / stds))
        return gains + weights - float(np.sum(cut)), sizes

    def _sizes(self, placed: LocatedEffect) -> Floats:
        """Return the expected sizes of an effect's parameters; for a uniform prior its standard deviation."""
        lower, upper = _limits([placed])
        stds = self.expectation.of(placed)
        return np.where(np.isinf(stds), (upper - lower) / np.sqrt(12), stds)

    def likely_factors(self, placed: Sequence[LocatedEffect]) -> dict[str, float]:
        """Find the most probable factors on the unknown common sizes and the open accuracy of some candidates."""
        logs = {}
        for each in placed:
            if each.effect.rescales:
                logs[each.label] = self._noise(each, self._reached, self.base.fit.at.r)[1]
            elif each.effect.common_size:
                gains, sizes = self._gains_by_size(each, self._own[:, self._at[each]], self.base.fit.at.r)
                logs[each.label] = float(sizes[np.argmax(gains)])
        return {label: float(np.exp(log)) for label, log in logs.items()}

    def forward(self, log_priors: Floats) -> list[LocatedEffect]:
        """List the effects that the linearised model adds in sequence, the most promising first, while it gains.

        Parameters
        ----------
        log_priors : ndarray, shape (n,)
            Logarithm of the prior odds of each candidate.
        """
        taken: list[LocatedEffect] = []
        open_to = np.array(log_priors)
        own, left, basis = self._own.copy(), self.base.fit.at.r.copy(), self._reached.copy()
        for _ in self.candidates:
            gains = (self._gains(own, left) if taken else self.gains) + open_to
            at = ranking.first_largest(gains)
            if not gains[at] > 0.0:
                break
            best = self.candidates[at]
            taken.append(best)
            open_to[at] = -np.inf
            if best.effect.rescales:
                # Residuals with open accuracy have less weight in all further steps.
                rows = self.base.misfit.rescaled_rows(self.base.fit.at, best)
                weight = np.exp(-self._noise(best, self._reached, left)[1])
                basis[rows] *= weight
                own[rows] *= weight
                left[rows] *= weight
                basis, _ = np.linalg.qr(basis)
            else:
                basis, _ = np.linalg.qr(np.column_stack([basis, own[:, self._at[best]]]))
            own, left = own - basis @ (basis.T @ own), left - basis @ (basis.T @ left)
        return taken

    def predicted(self, placed: Sequence[LocatedEffect], factors: Mapping[str, float] | None = None) -> Floats:
        """Find the minimum of the linearised model with these effects, each within its bounds.

        Parameters
        ----------
        placed : sequence of LocatedEffect
        factors : mapping of str to float, optional
            `likely_factors` of the effects. Default: 1.

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
        sizes = [self.expectation.of(each) * (factors or {}).get(each.label, 1.0) for each in placed]
        precision = 1.0 / np.concatenate(sizes) ** 2
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
                theta[: self.base.experiment.parameters] += self._shift(each) @ (values - null)[at]
        return np.concatenate([theta, values])

    def in_place_of(self, replaced: Sequence[LocatedEffect], log_priors: Floats) -> tuple[list[LocatedEffect], Floats]:
        """Find the causes of one parameter each that replace effects of the fit, the most promising first.

        The fit holds the effects at their sizes, so the derivatives are those of a frame that explains the data: no
        change is too large for them, as long as the matrices are linear in it.

        Parameters
        ----------
        replaced : sequence of LocatedEffect
        log_priors : ndarray, shape (n,)
            Logarithm of the prior odds of each candidate.

        Returns
        -------
        causes : list of LocatedEffect
            Added in sequence while the evidence of the linearised model grows.
        theta : ndarray, shape (P - p + k,)
            Minimum of the linearised model: parameters of the fit without the effect, then of the causes.
        """
        base, single = self.base, self._singles
        J = base.fit.at.J
        own = np.concatenate([np.arange(len(base.theta))[base.own(each)] for each in replaced])
        nulls = np.array([item.null for each in replaced for item in each.effect.parameters])
        free = self._free @ linalg.null_space(self._free[own])
        within = J @ free
        reached = linalg.orth(within)
        residual = base.fit.at.r - J[:, own] @ (base.theta[own] - nulls)
        columns = self._columns[:, single.columns]
        beyond, left = (each - reached @ (reached.T @ each) for each in (columns, residual))
        rounding = EXACT**2 * np.sum(columns**2, axis=0)
        odds = np.where([self.candidates[at].effect.kind == OPEN for at in single.at], -np.inf, log_priors[single.at])
        taken: list[int] = []
        while len(taken) < len(odds):
            h = np.sum(beyond**2, axis=0)
            gains = np.where(h > rounding, single.gains(-(beyond.T @ left), h) + odds, -np.inf)
            best = ranking.first_largest(gains)
            if not gains[best] > 0.0:
                break
            taken.append(best)
            odds[best] = -np.inf
            unit = beyond[:, best] / np.sqrt(h[best])
            beyond, left = (each - np.multiply.outer(unit, unit @ each) for each in (beyond, left))
        change = -np.linalg.lstsq(np.hstack([within, columns[:, taken]]), residual, rcond=None)[0]
        sizes = np.clip(change[len(free.T) :], single.lower[taken], single.upper[taken])
        moved = np.linalg.lstsq(within, residual + columns[:, taken] @ sizes, rcond=None)[0]
        causes = [self.candidates[at] for at in single.at[taken]]
        start = [cause.effect.parameters[0].null for cause in causes] + sizes
        return causes, np.concatenate([np.delete(base.theta - free @ moved, own), start])

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
        return float(1.0 + (first @ first) * self._sizes(placed)[0] ** 2)

    @decorators.cached_property
    def _free_columns(self) -> tuple[Floats, tuple[LocatedEffect | None, ...]]:
        """Derivatives of the data by the directions that the declarations do not fix, and the effect of each direction.

        The effect is None for directions of the frame.
        """
        estimate = self.base
        basis = free_basis(estimate, self.expectation)
        owners = [
            placed
            for placed, own in composition.slices(estimate.effects, estimate.experiment.parameters)
            if not placed.fixed
            for _ in range(own.start, own.stop)
        ]
        frame: list[LocatedEffect | None] = [None] * (basis.shape[1] - len(owners))
        return estimate.fit.at.J[: estimate.fit.at.measured] @ basis, (*frame, *owners)

    def twins(self, placed: LocatedEffect) -> list[LocatedEffect]:
        """List the candidates that can replace an effect of the model without any change of the data."""
        free, owners = self._free_columns
        own = np.array([owner is placed for owner in owners])
        if not own.any():
            return []
        basis = _basis(free[:, ~own])
        wanted = _without(basis, free[:, own])
        size = np.linalg.norm(free[:, own], axis=0)
        if np.max(np.linalg.norm(wanted, axis=0) / np.where(size > 0, size, 1.0)) <= BEYOND_FRAME:
            return []
        found = []
        for other in self.candidates:
            columns = self._measured(other)
            if 0 < columns.shape[1] <= int(own.sum()) and _beyond(_without(basis, columns), wanted) < EXACT:
                found.append(other)
        return found

    def undetermined(self, placed: LocatedEffect, others: Sequence[LocatedEffect]) -> bool:
        """Whether an effect of its expected size changes all data together by less than one standard deviation.

        Changes that the frame, the effects of the model, or the given others can also make do not count.
        """
        columns = self._measured(placed) * placed.effect.expected_sizes(self.base.scale)
        if not columns.shape[1]:
            return False
        more = [self._measured(other) for other in others if other is not placed]
        left = _without(_basis(np.hstack([self._free_columns[0], *more])), columns)
        return bool(np.all(np.linalg.norm(left, axis=0) < 1.0))

    def _measured(self, placed: LocatedEffect) -> Floats:
        """Return the derivatives of the data and the soft priors by an effect's parameters."""
        return self._columns[: self.base.fit.at.measured, self._at[placed]]


def _alike(effects: Sequence[LocatedEffect], most: int = 100) -> Iterator[list[LocatedEffect]]:
    """Divide effects into groups of one state and test, of at most so many parameters, or of one effect.

    Larger groups take more memory, and more time in a tall frame; smaller ones take more time in a low one.
    """
    of_state = defaultdict[tuple[str | None, str | None], list[LocatedEffect]](list)
    for placed in effects:
        of_state[placed.place.state, placed.place.test].append(placed)
    for alike in of_state.values():
        group, size = list[LocatedEffect](), 0
        for placed in alike:
            count = len(placed.effect.parameters)
            if group and size + count > most:
                yield group
                group, size = [], 0
            group.append(placed)
            size += count
        yield group


class _Singles:
    """One-parameter effects with their own priors; their gains are found together.

    Attributes
    ----------
    at, others : ndarray of int
        Places of these effects, and of the others, among the candidates.
    columns : ndarray of int
        Places of the parameters.
    lower, upper : ndarray, shape (n,)
        Bounds of the parameters, as distances from null.
    precision, constants : ndarray, shape (k, n)
        Precisions of the normal parts of each prior, and the logarithms of their weights with the priors' constants.
    """

    def __init__(self, candidates: Sequence[LocatedEffect], expectation: domain.EffectPrior) -> None:
        alone = np.array(
            [len(p.effect.parameters) == 1 and not (p.effect.common_size or p.effect.rescales) for p in candidates],
            dtype=bool,
        )
        self.at, self.others = np.flatnonzero(alone), np.flatnonzero(~alone)
        self.columns = np.array([own.start for _, own in composition.slices(candidates, 0)], dtype=np.int64)[alone]
        single = [placed for placed, of_one in zip(candidates, alone, strict=True) if of_one]
        self.lower, self.upper = _limits(single)
        sizes = np.exp(gaussian.LOG_SIZES)[:, None] * np.array([expectation.of(placed)[0] for placed in single])
        weights = (
            np.array([gaussian.student_weights(placed.effect.tail) for placed in single])
            .reshape(-1, len(gaussian.LOG_SIZES))
            .T
        )
        self.precision = 1.0 / sizes**2
        self.constants = weights + _log_normal_constants(self.lower, self.upper, sizes)

    def gains(self, b: Floats, h: Floats) -> Floats:
        """Find the gain of each effect, shape (n,), from its slope b and its curvature h, which narrows the prior."""
        precision = h + self.precision
        untouched = precision <= 0.0
        std = 1.0 / np.sqrt(np.where(untouched, 1.0, precision))
        parts = self.constants + gaussian.log_interval(self.lower, self.upper, -b, std) + np.log(std)
        # The data do not depend on the parameter; a uniform prior between its bounds stays uniform.
        even = self.constants + np.log(np.where(untouched, self.upper - self.lower, 1.0)) - 0.5 * np.log(2 * np.pi)
        found: Floats = np.logaddexp.reduce(np.where(untouched, even, parts), axis=0)
        return found


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


def _basis(columns: Floats) -> Floats:
    """Return orthonormal columns that span the given columns, to rounding."""
    lengths = np.linalg.norm(columns, axis=0)
    unit = columns[:, lengths > 0] / lengths[lengths > 0]
    left, values, _ = np.linalg.svd(unit, full_matrices=False)
    return left[:, values > EXACT * values[0]] if len(values) else left


def _without(basis: Floats, columns: Floats) -> Floats:
    """Return the part of each column outside the span of a basis; zero if that part is rounding."""
    left: Floats = columns - basis @ (basis.T @ columns)
    rounding = np.linalg.norm(left, axis=0) <= EXACT * np.linalg.norm(columns, axis=0)
    return np.where(rounding, 0.0, left)


def _beyond(columns: Floats, wanted: Floats) -> float:
    """Return the largest share of a wanted column outside the span of the given columns."""
    size = np.linalg.norm(wanted, axis=0)
    if columns.shape[1] == 1 and np.any(columns):
        unit = columns / np.linalg.norm(columns)
        left = wanted - unit @ (unit.T @ wanted)
    else:
        left = _without(_basis(columns), wanted)
    return float(np.max(np.linalg.norm(left, axis=0) / np.where(size > 0, size, 1.0), initial=0.0))
