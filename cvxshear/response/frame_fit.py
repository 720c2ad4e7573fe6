"""Fit the frame to the innovations of a record and select the changed stories by the evidence.

The likelihood of the innovations times a Gaussian prior is maximized by Gauss-Newton. Its steps are programs with
bounds, first over a short part of the record, then over a long one. The evidence of the linearized likelihood selects
the stories that changed by themselves and the size of the model's errors of form. The covariance belongs to the mixture
of all answers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.response.damped import DampedModel
from cvxshear.response.frame_prior import (
    FORM_STDS,
    GAIN_STDS,
    MASS_STDS,
    NO_DASHPOT_STD,
    NOISE_STD,
    SCATTER_STDS,
    FrameChange,
    FramePrior,
    Gaussian,
    Linear,
    possible_answers,
)
from cvxshear.response.innovations import Directions, Likelihood, PredictionErrors
from cvxshear.response.varied_frame import GAIN_UNIT
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats, Ints

FIRST_SAMPLES, FITTED_SAMPLES = 2_000, 10_000
"""Samples of the strongest segment of each run in the first and in the last fit. The time of a fit is proportional to
this number; model errors limit the accuracy with more samples."""

LEAST_INFORMATION, FIRST_INFORMATION = 0.5, 10.0
"""Minimum information, relative to the prior, for a direction to be fitted, in the last and in the first fit. A record
with less information reduces the variance by less than a fifth, and the prior of the direction remains."""

MOST_FIT_STEPS = 12
"""Maximum number of Gauss-Newton steps; four to six are usual."""

FITTED, FIRST_FITTED = 0.1, 1.0
"""Tolerances of the last and the first fit: largest change of a combined residual, in standard deviations of one
parameter."""

IDLE = 10.0 * NO_DASHPOT_STD
"""Bound on an absent dashpot, in units of its prior: ten standard deviations."""

MOST_DECISIONS = 3
"""Maximum number of selections of the changed stories; the second usually repeats the first."""

GROWN_INFLATION = 2.0
"""Refit with the new inflation of the scores if it exceeds the old one by this factor. A wrong model must not override
the prior of masses and effects."""

NONLINEAR = 4.0
"""Largest inflation of the scores for a record of a linear frame with sound sensors. Linear frames have 1
to 2, a clock 5 ms late gives 5, and a yielding story 4 to 50."""


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """Result of the fit of a frame to a record.

    Parameters
    ----------
    p : ndarray, shape (P,)
        Unknowns of `PredictionErrors`.
    covariance : ndarray, shape (P, P)
        Averaged over the answers.
    answers : tuple of FrameChange
        Most probable first.
    inflation : float
        Factor on the covariance of the likelihood, for innovations that are not white.
    along : Directions
        Directions along which the frame was fitted.
    log_evidence : float
        Log probability of the record, averaged over the answers. A fixed frame has one answer.
    """

    errors: PredictionErrors
    prior: FramePrior
    p: Floats
    covariance: Floats
    answers: tuple[FrameChange, ...]
    inflation: float
    converged: bool
    along: Directions
    log_evidence: float

    @cached_property
    def story_probability(self) -> Floats:
        """Probability that each story changed by itself, shape (N,)."""
        return self._changed[: self.errors.stories]

    @cached_property
    def dashpot_probability(self) -> Floats:
        """Probability that each story has a dashpot of its own, shape (N,)."""
        return self._changed[self.errors.stories : self._first_gain]

    @property
    def dashpots(self) -> tuple[Floats, Floats]:
        """Dashpot of each story, and its standard deviation, shapes (N,), N s/m."""
        return self._unknown(self.errors.varied.dashpots, self.errors.varied.dashpot)

    def _unknown(self, at: slice, unit: Floats) -> tuple[Floats, Floats]:
        """Return some unknowns and their standard deviations, in units."""
        return unit * self.p[at], np.abs(unit) * np.sqrt(np.diag(self.covariance)[at])

    @cached_property
    def gain_probability(self) -> Floats:
        """Probability that each sensor has a gain error of its own, shape (m,); the excitation's sensor is last."""
        return self._changed[self._first_gain :]

    @property
    def _first_gain(self) -> int:
        return self.errors.stories + len(self.errors.varied.dashpot)

    @cached_property
    def _changed(self) -> Floats:
        result = np.zeros(self._first_gain + self.errors.varied.gains)
        for each in self.answers:
            result[list(each.changed)] += each.probability
        return result

    @property
    def mass_probability(self) -> float:
        """Probability that floor masses changed."""
        return sum(each.probability for each in self.answers if each.mass_std > 0)

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Relative gain error of each sensor, and its standard deviation, shapes (m,); the excitation's is last."""
        at, m = self.errors.varied.sensor_gains, len(self.errors.setting.floors)
        # If the excitation was larger than measured, its sensor reads too little.
        signs = np.where(np.arange(at.stop - at.start) < m, 1.0, -1.0)
        logarithms, std = self._unknown(at, GAIN_UNIT * signs)
        return np.expm1(logarithms), np.exp(logarithms) * std

    @property
    def factors(self) -> Floats:
        """Story stiffnesses in this record over the identified ones, shape (N,)."""
        return self.errors.varied.story_factors(self.p[self.errors.frame])[0]

    @property
    def factors_std(self) -> Floats:
        """Standard deviations of the factors, shape (N,): both stiffnesses are uncertain."""
        return np.asarray(np.sqrt(np.diag(self._factors_covariance) + self.scale_std**2))

    @property
    def scale_std(self) -> float:
        """Relative standard deviation of the total mass, and hence of all stiffnesses, from mass changes since tests.

        Base motion gives only the relative changes of the floors' masses, not their common factor.
        """
        if not self.errors.setting.base_measured or self.errors.setting.force_floor:
            return 0.0
        return MASS_STDS[-1] * float(np.sqrt(self.mass_probability / self.errors.stories))

    @property
    def mean_factor(self) -> tuple[float, float]:
        """Mean of the factors, and its standard deviation."""
        return float(np.mean(self.factors)), float(np.sqrt(np.mean(self._factors_covariance) + self.scale_std**2))

    @property
    def against_others(self) -> tuple[Floats, Floats]:
        """Ratio of each story's factor to the mean of the unchanged stories, minus one, and its deviation, (N,) each.

        Common errors of all stories, such as the mass scale, cancel.
        """
        N, f = len(self.factors), self.factors
        weights = np.maximum(1.0 - self.story_probability, 1e-6) * (1.0 - np.eye(N)) + 1e-12
        weights /= weights.sum(axis=1, keepdims=True)
        others = weights @ f if N > 1 else np.ones(1)
        J = np.diag(1.0 / others) - (f / others**2)[:, None] * (weights if N > 1 else 0.0)
        std = np.sqrt(np.maximum(np.sum((J @ self._factors_covariance) * J, axis=1), 0.0))
        return f / others - 1.0, std

    @cached_property
    def mass_change(self) -> tuple[Floats, Floats]:
        """Relative change of each floor's mass since the tests, and its standard deviation, shapes (N,).

        The values belong to the most probable answer with changed masses; they are zero without such an answer. The
        difference from the identified masses is partly the error of the identification.
        """
        N = self.errors.stories
        answer = next((each for each in self.answers if each.mass_std > 0), None)
        if answer is None:
            return np.zeros(N), np.zeros(N)
        prior, variance = self.prior.gaussian(*answer.prior), answer.mass_std**2
        heavier = np.zeros((len(self.p), self.prior.varied.heavier_floors.shape[1]))
        heavier[self.errors.frame] = self.prior.varied.heavier_floors
        G = variance * np.linalg.solve(prior.covariance, heavier).T
        covariance = variance * (np.eye(N) - G @ heavier) + G @ self.covariance @ G.T
        return G @ (self.p - prior.mean), np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @cached_property
    def _factors_covariance(self) -> Floats:
        varied, frame = self.errors.varied, self.errors.frame
        _, J = varied.story_factors(self.p[frame])
        N, D, W, _ = varied.sizes
        masses = J[:, N + D : N + D + W]
        result: Floats = J @ self.covariance[frame, frame] @ J.T + self.prior.identified + masses @ masses.T
        return result

    @property
    def model(self) -> DampedModel:
        """Frame at the most probable unknowns."""
        return self.errors.model(self.p)


class _Point:
    """The posterior at one point; derivatives are computed on demand."""

    def __init__(self, posterior: _Posterior, p: Floats) -> None:
        self.posterior, self.p = posterior, p
        white = posterior.white @ (p - posterior.prior.mean)
        self.objective = posterior.errors.objective(p) / posterior.inflation + float(white @ white)

    @cached_property
    def likelihood(self) -> Likelihood:
        return self.posterior.errors.linearised(self.p, self.posterior.along)

    @cached_property
    def triangle(self) -> tuple[Floats, Floats]:
        at, white, root = self.likelihood, self.posterior.white, np.sqrt(self.posterior.inflation)
        away = white @ (self.p - self.posterior.prior.mean)
        return np.concatenate([at.U / root, white]), np.concatenate([at.c / root, away])

    @property
    def r(self) -> Floats:
        return self.triangle[1]

    @property
    def J(self) -> Floats:  # noqa: N802
        return self.triangle[0]


class _Posterior:
    """-2 log of the posterior density of the unknowns, for Gauss-Newton.

    Parameters
    ----------
    inflation : float, optional
        Factor that divides the log likelihood: the scores of a wrong model scatter more than the likelihood predicts.
    """

    def __init__(self, errors: PredictionErrors, along: Directions, prior: Gaussian, inflation: float = 1.0) -> None:
        self.errors, self.along, self.prior, self.inflation = errors, along, prior, inflation
        self.white = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> _Point:
        return _Point(self, theta)

    def maximum(
        self, p: Floats, backend: Backend, steps: int, form_std: float, near: float = FITTED, idle: Ints | None = None
    ) -> tuple[_Point, bool]:
        """Find the most probable point from p on, and whether the search converged within `steps` steps.

        Absent (idle) dashpots stay near zero, as in their prior.
        """
        lower, upper = self.errors.lower(form_std), self.errors.upper.copy()
        if idle is not None:
            lower[idle], upper[idle] = -IDLE, IDLE
            p = np.clip(p, lower, upper)
        bounds = Constraints(lower=lower, upper=upper)
        domain = Domain([NamedConstraints("bounds", bounds)], np.ones(len(p)), np.full(len(p), np.inf))
        found = gauss_newton(self, p, domain, backend, Accuracy(near, steps))
        return found.at, found.converged


def fit_frame(
    errors: PredictionErrors,
    prior: FramePrior,
    backend: Backend,
    start: Floats | None = None,
    *,
    free: bool = True,
    dashpots: bool = True,
) -> FittedFrame:
    """Fit the frame to the innovations.

    Parameters
    ----------
    backend : Backend
        Solver of the steps.
    start : ndarray, shape (P,), optional
        End of an earlier fit; without `start`, a rough fit to a short part comes first.
    free : bool, optional
        Whether the frame is fitted; otherwise only the noise is fitted.
    dashpots : bool, optional
        Whether the rough fit has a dashpot in every story.
    """
    p = np.zeros(errors.size) if start is None else start
    answer = FrameChange((), FORM_STDS[0], SCATTER_STDS[0], MASS_STDS[0], GAIN_STDS[0], 1.0)
    if not free:
        noise = np.eye(errors.size)[errors.frame.stop :]
        # The frame stays as identified; its uncertainty is part of the bands.
        still = Gaussian(np.zeros(errors.size), NOISE_STD**2 * np.eye(errors.size), 0.0)
        at, converged = _Posterior(errors, Directions(noise.T, noise), still).maximum(
            p, backend, MOST_FIT_STEPS, FORM_STDS[-1], idle=prior.idle_dashpots(())
        )
        covariance = prior.gaussian(*answer.prior, same=errors.setting.base_measured).covariance
        along, evidence = at.posterior.along, -0.5 * at.objective
        return FittedFrame(errors, prior, at.p, covariance, (answer,), 1.0, converged, along, evidence)
    if start is None:
        rough = _Posterior(
            errors.shortened(FIRST_SAMPLES, p), informative(errors, prior, p, FIRST_INFORMATION), prior.widest
        )
        idle = prior.idle_dashpots(range(len(prior.single)) if dashpots else ())
        p = rough.maximum(p, backend, MOST_FIT_STEPS, FORM_STDS[-1], FIRST_FITTED, idle)[0].p
    along, inflation = informative(errors, prior, p), 1.0
    # The start must be near the right answer. Otherwise the fit would change the masses or their scale in place of a
    # story, and rarely return, because base motion does not determine this scale.
    rough_likelihood = errors.linearised(p, along)
    answer = possible_answers(rough_likelihood, prior, p)[0]
    nearer, _ = Linear(rough_likelihood, p, prior.gaussian(*answer.prior)).posterior()
    nearer = np.clip(nearer, errors.lower(answer.form_std), errors.upper)
    p = nearer if errors.stable(nearer) else p
    for _ in range(MOST_DECISIONS):
        posterior = _Posterior(errors, along, prior.gaussian(*answer.prior), inflation)
        idle = prior.idle_dashpots(answer.changed)
        at, converged = posterior.maximum(p, backend, MOST_FIT_STEPS, answer.form_std, idle=idle)
        p, answers, before = at.p, possible_answers(at.likelihood, prior, at.p), answer
        answer = answers[0]
        if answer.prior == before.prior and at.likelihood.inflation <= GROWN_INFLATION * inflation:
            break
        inflation = max(inflation, at.likelihood.inflation)
    first_gain = errors.stories + len(errors.varied.dashpot)
    asked = answer.mass_std or answer.gain_std > GAIN_STDS[0] or any(each >= first_gain for each in answer.changed)
    if asked and at.likelihood.inflation > NONLINEAR:
        # If the record does not fit a linear frame, masses and gains absorb other errors: fit without their changes.
        return fit_frame(errors, prior.linear_alone, backend, start)
    found = _mixed(errors, prior, at, answers, converged)
    if converged or start is not None or not dashpots:
        return found
    # Other starts may converge: from the identified frame, or without dashpots in the rough fit.
    for begin, with_dashpots in ((np.zeros(errors.size), True), (None, False)):
        other = fit_frame(errors, prior, backend, begin, dashpots=with_dashpots)
        if other.converged or other.log_evidence > found.log_evidence:
            found = other
        if found.converged:
            break
    return found


def informative(errors: PredictionErrors, prior: FramePrior, p: Floats, least: float = LEAST_INFORMATION) -> Directions:
    """Find the directions on which the record has information, for all possible changes and errors of form."""
    # An unknown first state would hide information in a short part that the whole record has.
    short = errors.shortened(FIRST_SAMPLES, p, free=False)
    root = np.asarray(np.linalg.cholesky(prior.widest.covariance), dtype=np.float64)
    return short.informed(p, root, least * np.sqrt(short.samples / errors.samples))


def refitted(frame: FittedFrame, errors: PredictionErrors, gone: int, backend: Backend, steps: int) -> FittedFrame:
    """Fit the frame again without one sensor, with the same possible answers.

    Parameters
    ----------
    gone : int
        Index of the unknown of the sensor's noise.
    steps : int
        Maximum number of steps; with zero steps the frame stays unchanged.
    """
    prior = dataclasses.replace(frame.prior, others=frame.prior.others - 1)
    start = np.delete(frame.p, gone)
    if not steps:
        covariance = np.delete(np.delete(frame.covariance, gone, axis=0), gone, axis=1)
        return FittedFrame(errors, prior, start, covariance, frame.answers, 1.0, True, frame.along, frame.log_evidence)
    along = frame.along.without(gone)
    best = frame.answers[0]
    posterior = _Posterior(errors, along, prior.gaussian(*best.prior), frame.inflation)
    at, converged = posterior.maximum(start, backend, steps, best.form_std, idle=prior.idle_dashpots(best.changed))
    return _mixed(errors, prior, at, frame.answers, converged)


def _mixed(
    errors: PredictionErrors, prior: FramePrior, at: _Point, answers: Sequence[FrameChange], converged: bool
) -> FittedFrame:
    """Return the frame with the covariance of the mixture of the answers."""
    total = sum(each.probability for each in answers)
    covariance = np.zeros((errors.size, errors.size))
    for each in answers:
        mean, own = Linear(at.likelihood, at.p, prior.gaussian(*each.prior)).posterior()
        away = mean - at.p
        covariance += each.probability / total * (own + np.outer(away, away))
    inflation, along, evidence = at.likelihood.inflation, at.posterior.along, _log_evidence(at, prior, answers)
    return FittedFrame(errors, prior, at.p, covariance, tuple(answers), inflation, converged, along, evidence)


def _log_evidence(at: _Point, prior: FramePrior, answers: Sequence[FrameChange]) -> float:
    """Compute the log probability of the record over all answers: the best answer's, divided by its probability."""
    best = answers[0]
    linear = Linear(at.likelihood, at.p, prior.gaussian(*best.prior))
    own = linear.evidence(np.zeros((len(at.p), 0))).plain + float(prior.log_odds[list(best.changed)].sum())
    # The triangle has the part that depends on the unknowns; the rest of -2 log likelihood is constant.
    rest = at.posterior.errors.objective(at.p) - float(at.likelihood.c @ at.likelihood.c)
    return own - float(np.log(best.probability)) - 0.5 * rest
