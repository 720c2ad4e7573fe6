"""Fits of sets of effects to one experiment, their effort, and their evidence.

The evidence of a set is the probability of the data under the set (Beck and Yuen 2004), by Laplace's approximation at
the penalised optimum. Let x be the directions that the equalities leave free, and H the Gauss-Newton Hessian of half
the sum of squares, with the priors among its rows. Then

    log Z = -objective / 2 - log det H / 2 + sum over effects of the logarithm of their priors' constants
            - sum of log theta over the frame + the logarithm of the part of the Gaussian that keeps the inequalities
            + the term of undeclared noise.

A parameter pressed against a bound with the multiplier w has integral(exp(-w t - t^2 / 2 s^2)) dt in place of a whole
Gaussian, with variance s^2. A parameter with Student's t as its prior has the integral of this prior times the
likelihood's Gaussian (`log_tailed_interval`). Directions of the frame count in units of a typical floor and story,
which are the same in every set, so the constants of the frame's own prior cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import optimize, special

from cvxshear import backends
from cvxshear.data import NoiseFactors
from cvxshear.effects import LocatedEffect, composition
from cvxshear.fit import domain, gauss_newton, gaussian
from cvxshear.fit.efficient import Estimate, fitted, fitted_with
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.fit.turning_floors import general_parameters
from cvxshear.loop.hypotheses import Changes, Hypothesis, Numbering, log_odds
from cvxshear.measurement.experiment import Experiment
from cvxshear.motions import THREE_MOTIONS, symmetric
from cvxshear.programs import LeastSquares, constraints
from cvxshear.util import errors
from cvxshear.util.typing import Floats

#: Rounding: share of a parameter's precision that counts as no contribution of the data to its interval.
TINY = 1e-12

#: Tests times parameters of the largest fit that counts as one unit of work: the unit of `search.MOST_WORK`.
SMALL_FIT = 200

#: Largest distance from an active inequality, in standard deviations.
TOUCHING = 1e-4

#: Largest difference of two fits at the same optimum, in standard deviations of any datum or prior. Fits of the search
#: end within a tenth of their optimum, and another optimum is many standard deviations away.
SAME_OPTIMUM = 0.3


@dataclass(frozen=True, eq=False)
class ModelClass:
    """Set of effects with its fit.

    Parameters
    ----------
    effects : frozenset of LocatedEffect
        Effects in addition to the assumed ones.
    estimate : Estimate
    log_evidence : float
    log_prior : float
        Sum of the logarithms of the prior odds of the effects and of the mode numbers.
    changes : tuple
        Configurations with other mode numbers than the given ones (`Numbering.changes`).
    """

    effects: frozenset[LocatedEffect]
    estimate: Estimate
    log_evidence: float
    log_prior: float
    changes: Changes = ()

    @property
    def score(self) -> float:
        """Logarithm of the probability of the set, up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def improbable(self) -> bool:
        """Whether the residual, or the noise that the residual requires, is improbable."""
        return self.estimate.improbable

    def same_optimum(self, other: ModelClass) -> bool:
        """Whether another fit of this set ended at the same frame, within the resolution of the data and priors."""
        mine, theirs = self.estimate, other.estimate
        size = mine.experiment.parameters
        values = {placed: theirs.theta[own] for placed, own in composition.slices(theirs.effects, size)}
        there = np.concatenate([theirs.theta[:size], *(values[placed] for placed in mine.effects)])
        return bool(np.all(np.abs(mine.fit.at.J @ (there - mine.theta)) < SAME_OPTIMUM))


@dataclass(frozen=True)
class FitProposal:
    """Set of effects that is worth a fit, and the starting points of the fit.

    Parameters
    ----------
    effects : tuple of LocatedEffect
        Effects in the order of their parameters, with the assumed ones.
    starts : tuple of ndarray, shape (P,)
        Starting points: the best one is used, the last one if no other fits better than `objective`.
    misfit : Misfit
        Misfit with the data and noise of the fit.
    objective : float
        Objective of the fit that the proposal started from.
    """

    effects: tuple[LocatedEffect, ...]
    starts: tuple[Floats, ...]
    misfit: Misfit
    objective: float


@dataclass(eq=False)
class Fitter:
    """Fitter of sets of effects on one backend, with a count of the effort.

    Parameters
    ----------
    numbering : Numbering
        Experiment under one numbering of its modes.
    backend : Backend
    hypotheses : sequence of Hypothesis
    assumed : tuple of LocatedEffect
        Effects that every set holds.
    expectation : EffectPrior
    fits, programs : int
        Fits made so far, and step programs that they solved.
    stand_ins : int
        Fits that another backend made after the backend refused.
    failures : dict of frozenset of LocatedEffect to CvxshearError
        Sets that could not be fitted, with the reason.
    work : float
        Work done so far, in small fits: a larger one counts by its tests times parameters (`SMALL_FIT`). It does not
        depend on the machine.
    general : ndarray, shape (10 N,), or None
        Frame with a center of its own for every floor and story that turns, fitted without effects.
    """

    numbering: Numbering
    backend: backends.Backend
    hypotheses: Sequence[Hypothesis]
    assumed: tuple[LocatedEffect, ...]
    expectation: domain.EffectPrior
    fits: int = 0
    programs: int = 0
    stand_ins: int = 0
    failures: dict[frozenset[LocatedEffect], errors.CvxshearError] = field(default_factory=dict)
    work: float = 0.0
    general: Floats | None = None
    _log_odds: dict[LocatedEffect, float] = field(init=False)

    def __post_init__(self) -> None:
        self._log_odds = {item.placed: item.log_odds for item in self.hypotheses}

    @property
    def experiment(self) -> Experiment:
        """Experiment that the sets are fitted to."""
        return self.numbering.experiment

    def log_prior(self, effects: Collection[LocatedEffect]) -> float:
        """Return the sum of the log prior odds of the effects, each given its companion if the set holds it."""
        there = {(each.effect.name, each.place) for each in (*effects, *self.assumed)}
        return sum(
            log_odds(placed.effect.accompanies)
            if (placed.effect.companion, placed.place) in there
            else self._log_odds[placed]
            for placed in effects
        )

    def log_priors(self, further: Sequence[LocatedEffect], effects: frozenset[LocatedEffect]) -> Floats:
        """Return the logarithms of the prior odds of further effects beside a set, shape (n,)."""
        own = self.log_prior(effects)
        return np.array([self.log_prior(effects | {placed}) - own for placed in further])

    def proposal(
        self,
        start: Estimate,
        effects: Sequence[LocatedEffect],
        more: Sequence[Floats] = (),
        factors: Mapping[str, float] | None = None,
    ) -> FitProposal:
        """Propose a fit of these effects, started from a fit that shares some of them.

        Parameters
        ----------
        start : Estimate
        effects : sequence of LocatedEffect
        more : sequence of ndarray, shape (P,), optional
            Further starting points.
        factors : mapping of str to float, optional
            Factors on the unknown sizes of further effects to start with, by label. Default: 1.
        """
        size = self.experiment.parameters
        values = {placed: start.theta[own] for placed, own in composition.slices(start.effects, size)}
        own = [values.get(placed, np.array(placed.start)) for placed in effects]
        plain = np.concatenate([start.theta[:size], *own])
        if self.general is not None and any(placed.place.state is None for placed in effects):
            more = (*more, self._near_general(self.general, effects, plain))
        noise = NoiseFactors((*start.misfit.noise.factors, *(factors or {}).items()))
        return FitProposal(
            tuple(effects), (*more, plain), start.misfit.replaced(effects, noise), start.fit.at.objective
        )

    def _near_general(self, general: Floats, effects: Sequence[LocatedEffect], start: Floats) -> Floats:
        """Find the frame with these effects that is nearest to the general one.

        A symmetric frame may have modes in x and y of almost one frequency. Their derivatives tell nothing of the
        eccentricity that mixes them.
        """
        experiment = self.experiment
        frame = symmetric(general, experiment.stories)
        bare = experiment.configurations[0].unloaded("the frame itself")
        mass, stiffness = (float(np.mean(each)) for each in experiment.levels(frame))
        size = np.concatenate([experiment.units(mass, stiffness), np.ones(len(start) - len(frame))])
        size_of_general = THREE_MOTIONS.units(mass, stiffness, experiment.radius)

        def off(x: Floats) -> tuple[Floats, Floats]:
            theta, slopes = general_parameters(composition.compose(experiment, bare, effects, size * x))
            return (theta - general) / size_of_general, slopes * size / size_of_general[:, None]

        def residuals(x: Floats) -> Floats:
            return off(x)[0]

        def derivatives(x: Floats) -> Floats:
            return off(x)[1]

        nearest = optimize.least_squares(residuals, np.concatenate([frame, start[len(frame) :]]) / size, derivatives)
        return np.asarray(size * nearest.x)

    def fit(self, misfit: Misfit, start: Floats, accuracy: gauss_newton.Accuracy = gauss_newton.FULL) -> Estimate:
        """Fit a model from a starting point."""
        self.count(misfit.parameters, fits=1)
        found, stood_in = with_stand_in(self.backend, lambda by: fitted(misfit, start, by, accuracy))
        self.stand_ins += stood_in
        return found

    def at(self, base: Estimate, frame: Floats) -> Estimate:
        """Evaluate the model of a fit at another frame, without a step."""
        theta = np.concatenate([frame, base.theta[len(frame) :]])
        none = gauss_newton.Accuracy(most_steps=0)
        return with_stand_in(self.backend, lambda by: fitted_with(base.misfit, theta, by, none))[0]

    def models(
        self, proposals: Sequence[FitProposal], accuracy: gauss_newton.Accuracy = gauss_newton.ROUGH
    ) -> list[ModelClass]:
        """Fit sets; the reasons of missing fits are kept in `failures`."""
        return [found for proposal in proposals if (found := self._model(proposal, accuracy)) is not None]

    def set_of(self, proposal: FitProposal) -> frozenset[LocatedEffect]:
        """Return the set of a proposal, without the assumed effects."""
        return frozenset(proposal.effects) - frozenset(self.assumed)

    def count(self, parameters: int, fits: int = 0) -> None:
        """Count fits of so many parameters, or derivatives of all data by so many."""
        self.fits += fits
        self.work += max(1.0, len(self.experiment.tested) * parameters / SMALL_FIT)

    def _model(self, proposal: FitProposal, accuracy: gauss_newton.Accuracy) -> ModelClass | None:
        self.count(proposal.misfit.parameters, fits=1)
        try:
            start, at = _start(proposal)
            found, stood_in = with_stand_in(self.backend, lambda by: fitted(proposal.misfit, start, by, accuracy, at))
        except errors.CvxshearError as error:
            self.failures[self.set_of(proposal)] = error
            return None
        self.stand_ins += stood_in
        self.programs += found.fit.steps
        return self.model_of(found)

    def model_of(self, estimate: Estimate) -> ModelClass:
        """Score an estimate as the fit of its set."""
        effects = frozenset(estimate.effects) - frozenset(self.assumed)
        log_prior = self.numbering.log_odds + self.log_prior(effects)
        evidence = log_evidence(estimate, self.expectation)
        return ModelClass(effects, estimate, evidence, log_prior, changes=self.numbering.changes)

    def refined(self, model: ModelClass) -> ModelClass:
        """Fit the same set to full accuracy; return the old fit if this fails."""
        return self._model(self.proposal(model.estimate, model.estimate.effects), gauss_newton.FULL) or model


def with_stand_in(
    backend: backends.Backend,
    fit: Callable[[backends.Backend], Estimate],
    refusals: tuple[type[errors.CvxshearError], ...] = (errors.UnsuitableError, errors.NoSolutionError),
) -> tuple[Estimate, bool]:
    """Make a fit on one backend, or on `auto` if this backend refuses or fails; also return whether `auto` made it."""
    try:
        return fit(backend), False
    except refusals:
        if backend.name == "auto":
            raise
        return fit(backends.get("auto")), True


def _start(proposal: FitProposal) -> tuple[Floats, Evaluation | None]:
    """Choose the starting point; also return the residuals there if they were computed."""
    *guesses, best = proposal.starts
    objective, there = proposal.objective, None
    for guess in guesses:
        try:
            at = proposal.misfit.evaluate(guess)
        except errors.NoModesError:
            continue
        if at.objective <= objective:
            best, objective, there = guess, at.objective, at
    return best, there


def log_evidence(estimate: Estimate, expectation: domain.EffectPrior) -> float:
    """Return the logarithm of the evidence, up to a constant that all sets for the same data share.

    Parameters
    ----------
    estimate : Estimate
        The penalised optimum.
    expectation : EffectPrior
        The expectation used in the fit.
    """
    B = free_basis(estimate, expectation)
    U, c = estimate.fit.at.triangle
    moved = U @ B
    H = moved.T @ moved
    sign, log_det = np.linalg.slogdet(H)
    if sign <= 0:
        return -np.inf
    value = -0.5 * (estimate.fit.at.objective + float(log_det)) + estimate.noise.gain - _log_size(estimate, expectation)
    value += sum(_log_constant(placed, expectation) for placed in estimate.effects if not placed.fixed)
    return float(value + _log_kept(estimate, B, H, moved.T @ c))


def _log_size(estimate: Estimate, expectation: domain.EffectPrior) -> float:
    """Return the sum of the logarithms of masses and stiffnesses in typical units: the prior is on the logarithms."""
    scale = expectation.scale
    assert scale is not None, "evidence needs an expectation"
    return float(np.sum(np.log(estimate.theta[: len(scale.units)] / scale.units)))


def free_basis(estimate: Estimate, expectation: domain.EffectPrior) -> Floats:
    """Return columns that span the directions that the equalities leave free, shape (P, f).

    The first columns are orthonormal directions of the frame, in units of a typical floor and story. Each parameter of
    the effects then has one column: its own entry is 1, and the frame changes by the least that keeps the equalities.
    """
    size = len(estimate.theta)
    scale = expectation.scale
    assert scale is not None, "evidence needs an expectation"
    unit = scale.units
    first = len(unit)
    A, _ = _program(estimate).equalities
    lengths = np.linalg.norm(np.hstack([A[:, :first] * unit, A[:, first:]]), axis=1)
    A = A / np.where(lengths > 0, lengths, 1.0)[:, None]
    frame, own = A[:, :first] * unit, A[:, first:]
    without_frame = np.linalg.norm(frame, axis=1) < 1e-12
    inverse = np.linalg.pinv(frame, rcond=1e-10)
    _, values, right = np.linalg.svd(frame, full_matrices=True)
    open_frame = right[int(np.sum(values > 1e-10)) :].T
    # An effect held at a value has its own row and no direction.
    fixed = np.any(np.abs(own[without_frame]) > 0, axis=0)
    parameters = np.flatnonzero(~fixed)
    B = np.zeros((size, open_frame.shape[1] + len(parameters)))
    B[:first, : open_frame.shape[1]] = unit[:, None] * open_frame
    for column, parameter in enumerate(parameters, open_frame.shape[1]):
        B[first + parameter, column] = 1.0
        B[:first, column] = -unit * (inverse @ own[:, parameter])
    return B


def _program(estimate: Estimate) -> LeastSquares:
    """Write the constraints of a fit about its optimum."""
    empty = LeastSquares(R=estimate.fit.at.triangle[0], s=np.zeros(len(estimate.fit.at.triangle[1])))
    return constraints.constrained(empty, estimate.domain.statements, estimate.theta)


def _log_constant(placed: LocatedEffect, expectation: domain.EffectPrior) -> float:
    """Return the log constant of an effect's prior, times sqrt(2 pi) per parameter as in Laplace's integral."""
    value = 0.0
    tail, normal = placed.effect.tail, placed.effect.common_size
    peak = -0.5 * np.log(2 * np.pi) if normal else -0.5 * np.log(tail) - special.betaln(0.5 * tail, 0.5)
    for item, std in zip(placed.effect.parameters, expectation.of(placed), strict=True):
        if np.isinf(std) and np.isinf(item.upper - item.lower):
            # The effect has no prior size: only an assumed effect, which is in every set, may lack one.
            continue
        value += 0.5 * np.log(2 * np.pi)
        if np.isinf(std):
            value -= np.log(item.upper - item.lower)
        else:
            ends = (np.array([item.lower, item.upper]) - item.null) / std
            below, above = special.ndtr(ends) if normal else special.stdtr(tail, ends)
            value += peak - np.log(std) - np.log(above - below)
    return float(value)


def _log_kept(estimate: Estimate, B: Floats, H: Floats, gradient: Floats) -> float:
    """Return the logarithm of the part of the Gaussian that keeps the inequalities, each taken alone.

    An effect's parameter is limited by its own interval; other rows cut the remaining Gaussian.
    """
    program = _program(estimate)
    value = 0.0
    assert program.lower is not None
    assert program.upper is not None
    G, h = program.replace(lower=None, upper=None).inequalities
    rows = np.concatenate([-np.eye(len(B)), np.eye(len(B)), G]) @ B
    slack = np.concatenate([-program.lower, program.upper, h])
    within = B / estimate.domain.interval_std[:, None]
    together = set(range(estimate.experiment.parameters, len(B)))
    std = _spread(rows, H + within.T @ within)
    alone = [row for row in range(2 * len(B)) if row % len(B) in together]
    # The standard deviation of a parameter excludes its own interval, which cuts the Gaussian explicitly, and includes
    # the intervals of the other parameters. If two parameters act alike (flexible joints and braces), a free one would
    # otherwise be carried far beyond the limit of the other.
    own_part = (std[alone] / np.concatenate([estimate.domain.interval_std] * 2)[alone]) ** 2
    std[alone] = std[alone] / np.sqrt(np.maximum(1.0 - own_part, TINY))
    multipliers = _multipliers(rows, slack <= TOUCHING * std, gradient)
    priors = dict(_tailed_priors(estimate))
    for p in sorted(together):
        if std[p] > 0:
            slope = multipliers[p] - multipliers[p + len(B)]
            between = -slack[p], slack[p + len(B)]
            tailed_prior = priors.get(p)
            value += (
                float(gaussian.log_interval(*between, slope, std[p]))
                if tailed_prior is None
                else gaussian.log_tailed_interval(*between, slope, std[p], *tailed_prior)
            )
    own_interval = (np.arange(len(rows)) < 2 * len(B)) & np.isin(np.arange(len(rows)) % len(B), sorted(together))
    cut = ~own_interval & (std > 0)
    return value + float(
        np.sum(gaussian.log_interval(-np.inf, np.maximum(slack[cut], 0.0), -multipliers[cut], std[cut]))
    )


def _spread(rows: Floats, H: Floats) -> Floats:
    """Return the standard deviations of these rows under a Gaussian of this precision."""
    variance: Floats = np.einsum("ij,ji->i", rows, np.linalg.solve(H, rows.T))
    return np.sqrt(np.maximum(variance, 0.0))


def _multipliers(rows: Floats, active: np.ndarray[tuple[int], np.dtype[np.bool_]], gradient: Floats) -> Floats:
    """Return w >= 0 with gradient + rows' w = 0, zero for rows that are not active."""
    result = np.zeros(len(rows))
    lengths = np.linalg.norm(rows, axis=1)
    active = active & (lengths > 0)
    if np.any(active):
        unit = rows[active] / lengths[active, None]
        result[active] = optimize.nnls(unit.T, -gradient)[0] / lengths[active]
    return result


def _tailed_priors(estimate: Estimate) -> Iterator[tuple[int, tuple[float, float, float]]]:
    """Yield the parameters with Student's t as prior: place in theta, deviation from null, size, degrees of freedom."""
    for placed, own in composition.slices(estimate.effects, estimate.experiment.parameters):
        if placed.fixed or placed.effect.common_size or np.isinf(placed.effect.tail):
            continue
        sizes = estimate.misfit.expectation.of(placed)
        for p, item, size in zip(range(own.start, own.stop), placed.effect.parameters, sizes, strict=True):
            if np.isfinite(size):
                yield p, (float(estimate.theta[p]) - item.null, float(size), placed.effect.tail)
