"""Sets of effects fitted to one experiment, how probable the data make each, and the effort the fits take."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.fit.efficient import Estimate, fitted
from cvxshear.fit.expectation import EffectPrior
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.loop.evidence import log_evidence
from cvxshear.loop.hypotheses import Hypothesis, log_odds
from cvxshear.loop.numbering import Changes, Numbering
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.parallel import each as in_parallel
from cvxshear.util.typing import Floats

SAME_OPTIMUM = 0.3
"""Largest difference of two fits of a set, in standard deviations of any datum or prior, that is none: fits of the
search end within a tenth of their optimum, and another optimum is many away."""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """A set of effects with its fit.

    Parameters
    ----------
    effects : frozenset of Placed
        Those beyond what was assumed from the start.
    estimate : Estimate or None
        None where no fit was found.
    log_evidence : float
    log_prior : float
        Sum of the logarithms of the prior odds, of the effects and of the numbers of the modes.
    failure : CvxshearError or None
        Why there is no fit.
    changes : tuple
        Configurations whose modes are numbered otherwise than given (`Numbering.changes`).
    """

    effects: frozenset[Placed]
    estimate: Estimate | None
    log_evidence: float
    log_prior: float
    failure: CvxshearError | None = None
    changes: Changes = ()

    @property
    def score(self) -> float:
        """Logarithm of its probability, up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def improbable(self) -> bool:
        """Whether its residual, or the noise that it asks for, is improbable."""
        return self.estimate is not None and self.estimate.improbable

    def same_optimum(self, other: ModelClass) -> bool:
        """Whether another fit of this set ended at the same frame, as far as any datum or prior could tell."""
        mine, theirs = self.estimate, other.estimate
        if mine is None or theirs is None:
            return False
        n2 = 2 * mine.experiment.stories
        values = {placed: theirs.theta[own] for placed, own in slices(theirs.effects, n2)}
        there = np.concatenate([theirs.theta[:n2], *(values[placed] for placed in mine.effects)])
        return bool(np.all(np.abs(mine.fit.at.J @ (there - mine.theta)) < SAME_OPTIMUM))


@dataclass(frozen=True)
class FitProposal:
    """A set of effects that is worth a fit, and where that starts.

    Parameters
    ----------
    effects : tuple of Placed
        In the order of their parameters, those assumed included.
    starts : tuple of ndarray, shape (P,)
        Starting points: the first that fits better than the last does is taken.
    misfit : Misfit
        Whose data and noise the fit has.
    objective : float
        Of the fit that it started from.
    """

    effects: tuple[Placed, ...]
    starts: tuple[Floats, ...]
    misfit: Misfit
    objective: float


@dataclass(eq=False)
class Fitter:
    """Fits sets of effects on one backend and counts the effort.

    Parameters
    ----------
    numbering : Numbering
        The experiment, its modes numbered in one way.
    backend : Backend
    hypotheses : sequence of Hypothesis
    assumed : tuple of Placed
        In every set.
    expectation : EffectPrior
    jobs : int
        Processes over which sets are fitted.
    fits, programs : int
        Fits made so far, and step programs that they solved.
    stand_ins : int
        Fits that the backend refused and another one made.
    base : Estimate or None
        Of the set without any effect, once it was fitted.
    """

    numbering: Numbering
    backend: Backend
    hypotheses: Sequence[Hypothesis]
    assumed: tuple[Placed, ...]
    expectation: EffectPrior
    jobs: int = 1
    fits: int = 0
    programs: int = 0
    stand_ins: int = 0
    base: Estimate | None = None
    _log_odds: dict[Placed, float] = field(init=False)

    def __post_init__(self) -> None:
        self._log_odds = {item.placed: item.log_odds for item in self.hypotheses}

    @property
    def experiment(self) -> Experiment:
        """What the sets are fitted to."""
        return self.numbering.experiment

    def log_prior(self, effects: Collection[Placed]) -> float:
        """Sum of the logarithms of the prior odds, each effect's beside its companion where that is there."""
        there = {(each.effect.name, each.place) for each in (*effects, *self.assumed)}
        return sum(
            log_odds(placed.effect.accompanies)
            if (placed.effect.companion, placed.place) in there
            else self._log_odds[placed]
            for placed in effects
        )

    def log_priors(self, further: Sequence[Placed], effects: frozenset[Placed]) -> Floats:
        """Logarithms of the prior odds of further effects beside a set, shape (n,)."""
        own = self.log_prior(effects)
        return np.array([self.log_prior(effects | {placed}) - own for placed in further])

    def proposal(self, start: Estimate, effects: Sequence[Placed], more: Sequence[Floats] = ()) -> FitProposal:
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
        """Fit sets, over processes where there are several."""
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

    def set_of(self, proposal: FitProposal) -> frozenset[Placed]:
        """Return the set that a proposal is of, without what is assumed in every set."""
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
        """Fit the same set to full accuracy; return it as it is where that fails."""
        if model.estimate is None:
            return model
        (found,) = self.models([self.proposal(model.estimate, model.estimate.effects)], FULL)
        return model if found.estimate is None else found


@dataclass(frozen=True)
class _Work:
    """A fit in another process."""

    backend: Backend
    accuracy: Accuracy

    def __call__(self, proposal: FitProposal) -> tuple[Estimate | CvxshearError, bool]:
        return _fitted(proposal, self.backend, self.accuracy)


def _own(found: Estimate | CvxshearError, proposal: FitProposal) -> Estimate | CvxshearError:
    """Bind a fit from another process to the effects of this one: there they were copies."""
    if isinstance(found, CvxshearError):
        return found
    theta = found.theta
    misfit = proposal.misfit.replaced(noise=found.misfit.noise)
    fit = type(found.fit)(theta, misfit.evaluate(theta), found.fit.reason, found.fit.steps)
    return Estimate(misfit, found.domain, fit, found.uncertainty, found.noise)


def _fitted(proposal: FitProposal, backend: Backend, accuracy: Accuracy) -> tuple[Estimate | CvxshearError, bool]:
    """Fit a set, or return why there is no fit; and whether another backend had to make it."""
    try:
        start = _start(proposal)
        return with_stand_in(backend, lambda by: fitted(proposal.misfit, start[0], by, accuracy, start[1]))
    except CvxshearError as error:
        return error, False


def with_stand_in(backend: Backend, fit: Callable[[Backend], Estimate]) -> tuple[Estimate, bool]:
    """Make a fit on one backend, or on `auto` where that one refuses or fails; and whether it did."""
    try:
        return fit(backend), False
    except (UnsuitableError, NoSolutionError):
        if backend.name == "auto":
            raise
        return fit(backends.get("auto")), True


def _start(proposal: FitProposal) -> tuple[Floats, Evaluation | None]:
    """Choose the starting point, and the residuals there where they had to be looked at."""
    *guesses, plain = proposal.starts
    for guess in guesses:
        try:
            at = proposal.misfit.evaluate(guess)
        except NoModesError:
            continue
        if at.objective <= proposal.objective:
            return guess, at
    return plain, None
