"""Fits of sets of effects to one experiment, their probabilities, and the effort of the fits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.effects.composition import slices
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import Estimate, fitted
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.loop.evidence import log_evidence
from cvxshear.loop.hypotheses import Changes, Hypothesis, Numbering, log_odds
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.parallel import each as in_parallel
from cvxshear.util.typing import Floats

SAME_OPTIMUM = 0.3
"""Largest difference of two fits at the same optimum, in standard deviations of any datum or prior. Fits of the search
end within a tenth of their optimum, and another optimum is many standard deviations away."""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """Set of effects with its fit.

    Parameters
    ----------
    effects : frozenset of LocatedEffect
        Effects in addition to the assumed ones.
    estimate : Estimate or None
        None if no fit was found.
    log_evidence : float
    log_prior : float
        Sum of the logarithms of the prior odds of the effects and of the mode numbers.
    failure : CvxshearError or None
        Reason for a missing fit.
    changes : tuple
        Configurations with other mode numbers than the given ones (`Numbering.changes`).
    """

    effects: frozenset[LocatedEffect]
    estimate: Estimate | None
    log_evidence: float
    log_prior: float
    failure: CvxshearError | None = None
    changes: Changes = ()

    @property
    def score(self) -> float:
        """Logarithm of the probability of the set, up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def improbable(self) -> bool:
        """Whether the residual, or the noise that the residual requires, is improbable."""
        return self.estimate is not None and self.estimate.improbable

    def same_optimum(self, other: ModelClass) -> bool:
        """Whether another fit of this set ended at the same frame, within the resolution of the data and priors."""
        mine, theirs = self.estimate, other.estimate
        if mine is None or theirs is None:
            return False
        n2 = 2 * mine.experiment.stories
        values = {placed: theirs.theta[own] for placed, own in slices(theirs.effects, n2)}
        there = np.concatenate([theirs.theta[:n2], *(values[placed] for placed in mine.effects)])
        return bool(np.all(np.abs(mine.fit.at.J @ (there - mine.theta)) < SAME_OPTIMUM))


@dataclass(frozen=True)
class FitProposal:
    """Set of effects that is worth a fit, and the starting points of the fit.

    Parameters
    ----------
    effects : tuple of LocatedEffect
        Effects in the order of their parameters, with the assumed ones.
    starts : tuple of ndarray, shape (P,)
        Starting points: the first one that fits better than the last one is used.
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
    jobs : int
        Processes over which sets are fitted.
    fits, programs : int
        Fits made so far, and step programs that they solved.
    stand_ins : int
        Fits that another backend made after the backend refused.
    base : Estimate or None
        Fit of the set without effects, after this fit was made.
    """

    numbering: Numbering
    backend: Backend
    hypotheses: Sequence[Hypothesis]
    assumed: tuple[LocatedEffect, ...]
    expectation: EffectPrior
    jobs: int = 1
    fits: int = 0
    programs: int = 0
    stand_ins: int = 0
    base: Estimate | None = None
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

    def proposal(self, start: Estimate, effects: Sequence[LocatedEffect], more: Sequence[Floats] = ()) -> FitProposal:
        """Propose a fit of these effects, started from a fit that shares some of them."""
        n2 = 2 * self.experiment.stories
        values = {placed: start.theta[own] for placed, own in slices(start.effects, n2)}
        own = [values.get(placed, np.array(placed.start)) for placed in effects]
        plain = np.concatenate([start.theta[:n2], *own])
        return FitProposal(tuple(effects), (*more, plain), start.misfit.replaced(effects), start.fit.at.objective)

    def fit(self, misfit: Misfit, start: Floats, accuracy: Accuracy = FULL) -> Estimate:
        """Fit a model from a starting point."""
        self.fits += 1
        found, stood_in = with_stand_in(self.backend, lambda by: fitted(misfit, start, by, accuracy))
        self.stand_ins += stood_in
        return found

    def models(self, proposals: Sequence[FitProposal], accuracy: Accuracy = ROUGH) -> list[ModelClass]:
        """Fit sets, on several processes if there are several."""
        if self.jobs == 1 or len(proposals) < 2:
            found = [_fitted(proposal, self.backend, accuracy) for proposal in proposals]
        else:
            work = _Work(self.backend, accuracy)
            found = [
                (_own(item, proposal), stood_in)
                for (item, stood_in), proposal in zip(
                    in_parallel(work, proposals, jobs=self.jobs), proposals, strict=True
                )
            ]
        self.stand_ins += sum(stood_in for _, stood_in in found)
        return [self._model(proposal, item) for proposal, (item, _) in zip(proposals, found, strict=True)]

    def set_of(self, proposal: FitProposal) -> frozenset[LocatedEffect]:
        """Return the set of a proposal, without the assumed effects."""
        return frozenset(proposal.effects) - frozenset(self.assumed)

    def _model(self, proposal: FitProposal, found: Estimate | CvxshearError) -> ModelClass:
        self.fits += 1
        effects = self.set_of(proposal)
        if isinstance(found, CvxshearError):
            return ModelClass(effects, None, -np.inf, self.log_prior(effects), found, self.numbering.changes)
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
        if model.estimate is None:
            return model
        (found,) = self.models([self.proposal(model.estimate, model.estimate.effects)], FULL)
        return model if found.estimate is None else found


@dataclass(frozen=True)
class _Work:
    """Fit in another process."""

    backend: Backend
    accuracy: Accuracy

    def __call__(self, proposal: FitProposal) -> tuple[Estimate | CvxshearError, bool]:
        return _fitted(proposal, self.backend, self.accuracy)


def _own(found: Estimate | CvxshearError, proposal: FitProposal) -> Estimate | CvxshearError:
    """Bind a fit from another process, which holds copies of the effects, to the effects of this process."""
    if isinstance(found, CvxshearError):
        return found
    theta = found.theta
    misfit = proposal.misfit.replaced(noise=found.misfit.noise)
    fit = type(found.fit)(theta, misfit.evaluate(theta), found.fit.reason, found.fit.steps)
    return Estimate(misfit, found.domain, fit, found.uncertainty, found.noise)


def _fitted(proposal: FitProposal, backend: Backend, accuracy: Accuracy) -> tuple[Estimate | CvxshearError, bool]:
    """Fit a set, or return the reason for a missing fit; also return whether another backend made the fit."""
    try:
        start = _start(proposal)
        return with_stand_in(backend, lambda by: fitted(proposal.misfit, start[0], by, accuracy, start[1]))
    except CvxshearError as error:
        return error, False


def with_stand_in(backend: Backend, fit: Callable[[Backend], Estimate]) -> tuple[Estimate, bool]:
    """Make a fit on one backend, or on `auto` if this backend refuses or fails; also return whether `auto` made it."""
    try:
        return fit(backend), False
    except (UnsuitableError, NoSolutionError):
        if backend.name == "auto":
            raise
        return fit(backends.get("auto")), True


def _start(proposal: FitProposal) -> tuple[Floats, Evaluation | None]:
    """Choose the starting point; also return the residuals there if they were computed."""
    *guesses, plain = proposal.starts
    for guess in guesses:
        try:
            at = proposal.misfit.evaluate(guess)
        except NoModesError:
            continue
        if at.objective <= proposal.objective:
            return guess, at
    return plain, None
