"""Fit the frame to the innovations of a record and select the changes since the tests by the evidence.

The likelihood of the innovations times a Gaussian prior is maximized by Gauss-Newton. Its steps are programs with
bounds, first over a short part of the record, then over a long one. The evidence of the linearized likelihood selects
the changes and the size of the model's errors of form. The covariance belongs to the mixture of all answers.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.response import frame_prior
from cvxshear.response.damping import DampedModel
from cvxshear.response.innovations import Directions, PredictionErrors
from cvxshear.response.sources import covariance_root
from cvxshear.response.varied_frame import DIFFERENCE
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import NoModesError
from cvxshear.util.quantities import SURE
from cvxshear.util.typing import Floats

#: Samples of the strongest segment of each run for the last fit, and for the first one and the choice of directions.
#: The time of a fit is proportional to this number; model errors limit the accuracy with more samples.
FITTED_SAMPLES, PROBED_SAMPLES = 10_000, 2_000

#: Minimum information, relative to the prior, for a direction to be fitted. A record with less information reduces the
#: variance by less than a fifth, and the prior of the direction remains.
LEAST_INFORMATION = 0.5

#: Accuracy of a fit; four to eight steps are usual.
FITTED = Accuracy(step=0.1, most_steps=20)

#: Maximum number of selections of the changes, each with a fit.
MOST_REFITS = 4


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """Result of the fit of a frame to a record.

    Parameters
    ----------
    p : ndarray, shape (P,)
        Unknowns of `PredictionErrors`.
    covariance : ndarray, shape (P, P)
        Averaged over the answers.
    answers : tuple of FrameAnswer
        Most probable first.
    inflation : float
        Factor on the covariance of the likelihood, for innovations that are not white.
    along : Directions
        Directions along which the frame was fitted.
    log_evidence : float
        Log probability of the record, averaged over the answers. A fixed frame has one answer.
    """

    errors: PredictionErrors
    prior: frame_prior.FramePrior
    p: Floats
    covariance: Floats
    answers: tuple[frame_prior.FrameAnswer, ...]
    inflation: float
    converged: bool
    along: Directions
    log_evidence: float

    def probability(self, kind: str) -> Floats:
        """Return the probability of each change of a kind (`FrameChange`)."""
        places = [place for place, each in enumerate(self.prior.changes) if each.kind == kind]
        return np.array([sum(each.probability for each in self.answers if place in each.changed) for place in places])

    @cached_property
    def story_probability(self) -> Floats:
        """Probability that each story changed by itself, shape (N,)."""
        return self.probability("story")

    @cached_property
    def dashpot_probability(self) -> Floats:
        """Probability that each story has a dashpot of its own, shape (N,)."""
        return self.probability("dashpot")

    @cached_property
    def mass_probability(self) -> float:
        """Probability that floor masses changed."""
        return float(np.sum(self.probability("masses")))

    def doubted(self) -> FittedFrame:
        """Return the frame with the covariance of a frame of which every story may have changed."""
        stories = [place for place, each in enumerate(self.prior.changes) if each.kind == "story"]
        return replace(self, covariance=self.prior.gaussian(stories, frame_prior.FORM_STDS[0]).covariance)

    @property
    def dashpots(self) -> tuple[Floats, Floats]:
        """Dashpot of each story, and its standard deviation, shapes (N,), N s/m."""
        return self._unknown(self.errors.varied.dashpots, self.errors.varied.dashpot)

    def _unknown(self, at: slice, unit: Floats) -> tuple[Floats, Floats]:
        """Return some unknowns and their standard deviations, in units."""
        return unit * self.p[at], np.abs(unit) * np.sqrt(np.diag(self.covariance)[at])

    @property
    def delays(self) -> tuple[Floats, Floats]:
        """Delay of each sensor in samples, and its standard deviation, shapes (m,); 0 if it is not sure."""
        values, std = self._unknown(self.errors.delays, np.ones(len(self.errors.setting.floors)))
        late = np.zeros(len(values))
        for each in self.answers:
            columns = [self.prior.changes[change].columns[self.errors.delays] for change in each.changed]
            late += each.probability * np.any(np.hstack([values[:, None] * 0.0, *columns]), axis=1)
        return np.where(late >= SURE, values, 0.0), std

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Relative gain error of each sensor, and its standard deviation, shapes (m,); the excitation's is last."""
        at, m = self.errors.varied.sensor_gains, len(self.errors.setting.floors)
        # If the excitation was larger than measured, its sensor reads too little.
        signs = np.where(np.arange(at.stop - at.start) < m, 1.0, -1.0)
        logarithms, std = self._unknown(at, signs)
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
        if self.errors.setting.force_floor:
            return 0.0
        return frame_prior.MASS_STD * float(np.sqrt(self.mass_probability / self.errors.stories))

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
        masses = [place for place, each in enumerate(self.prior.changes) if each.kind == "masses"]
        answer = next((each for each in self.answers if set(masses) & set(each.changed)), None)
        if answer is None:
            return np.zeros(self.errors.stories), np.zeros(self.errors.stories)
        prior, heavier = self.prior.gaussian(*answer.prior), self.prior.changes[masses[0]].columns
        G = frame_prior.MASS_STD * np.linalg.solve(prior.covariance, heavier).T
        covariance = (
            frame_prior.MASS_STD**2 * np.eye(len(G)) - frame_prior.MASS_STD * G @ heavier + G @ self.covariance @ G.T
        )
        return G @ (self.p - prior.mean), np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @cached_property
    def modal_std(self) -> tuple[Floats, Floats]:
        """Relative standard deviations of the frame's frequencies and of its damping ratios, shapes (N,)."""
        frame = self.errors.frame

        def described(p: Floats) -> Floats:
            model = self.errors.model(p)
            return np.log([model.modes.frequencies, model.ratios])

        centre, change = described(self.p), np.zeros(len(self.p))
        variance = np.zeros_like(centre)
        for column in covariance_root(self.covariance[frame, frame]).T:
            change[frame] = DIFFERENCE * column
            variance += ((described(self.p + change) - centre) / DIFFERENCE) ** 2
        frequencies, ratios = np.sqrt(variance)
        return frequencies, ratios

    @cached_property
    def _factors_covariance(self) -> Floats:
        varied, frame = self.errors.varied, self.errors.frame
        _, J = varied.story_factors(self.p[frame])
        N, D, W, _ = varied.sizes
        masses = J[:, N + D : N + D + W]
        return np.asarray(J @ self.covariance[frame, frame] @ J.T + self.prior.identified + masses @ masses.T)

    @cached_property
    def model(self) -> DampedModel:
        """Frame at the most probable unknowns."""
        return self.errors.model(self.p)


class _Point:
    """The posterior at one point; derivatives are computed on demand."""

    def __init__(self, posterior: _Posterior, p: Floats) -> None:
        self.posterior, self.p = posterior, p
        self.away = posterior.white @ (p - posterior.prior.mean)
        self.objective = posterior.errors.objective(p) + float(self.away @ self.away)

    @cached_property
    def likelihood(self) -> frame_prior.Likelihood:
        return self.posterior.errors.linearised(self.p, self.posterior.along)

    @property
    def triangle(self) -> tuple[Floats, Floats]:
        return self.J, self.r

    @property
    def r(self) -> Floats:
        return np.concatenate([self.likelihood.c, self.away])

    @property
    def J(self) -> Floats:  # noqa: N802
        return np.concatenate([self.likelihood.U, self.posterior.white])


class _Posterior:
    """-2 log of the posterior density of the unknowns, for Gauss-Newton."""

    def __init__(self, errors: PredictionErrors, along: Directions, prior: frame_prior.Gaussian) -> None:
        self.errors, self.along, self.prior = errors, along, prior
        self.white = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> _Point:
        return _Point(self, theta)

    def maximum(self, p: Floats, backend: Backend, accuracy: Accuracy = FITTED) -> tuple[_Point, bool]:
        """Find the most probable point from p on, and whether the search converged."""
        lower, upper = self.errors.bounds(self.prior)
        bounds = NamedConstraints("bounds", Constraints(lower=lower, upper=upper))
        domain = Domain([bounds], np.ones(len(p)), np.full(len(p), np.inf))
        found = gauss_newton(self, np.clip(p, lower, upper), domain, backend, accuracy)
        return found.at, found.converged


def fit_frame(
    errors: PredictionErrors,
    prior: frame_prior.FramePrior,
    backend: Backend,
    start: Floats | None = None,
    *,
    free: bool = True,
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
    """
    p = np.zeros(errors.size) if start is None else start
    if not free:
        noise = np.eye(errors.size)[errors.levels]
        # The frame stays as identified; its possible changes since the tests are part of the bands.
        still = frame_prior.Gaussian(np.zeros(errors.size), frame_prior.NOISE_STD**2 * np.eye(errors.size), 0.0)
        at, converged = _Posterior(errors, Directions(noise.T, noise), still).maximum(p, backend)
        answer = frame_prior.FrameAnswer((), frame_prior.FORM_STDS[0], 1.0)
        covariance = prior.gaussian(*answer.prior).covariance
        along, evidence = at.posterior.along, -0.5 * at.objective
        return FittedFrame(errors, prior, at.p, covariance, (answer,), 1.0, converged, along, evidence)
    if start is None:
        short = errors.shortened(PROBED_SAMPLES)
        p = _Posterior(short, informative(errors, prior, p), prior.widest).maximum(p, backend)[0].p
    along = informative(errors, prior, p)
    # The start must be near the right answer. Otherwise the fit would change the masses or their scale in place of a
    # story, and rarely return, because base motion does not determine this scale.
    likelihood = errors.linearised(p, along)
    answer = frame_prior.possible_answers(likelihood, prior, p)[0]
    p = _nearer(errors, likelihood, prior.gaussian(*answer.prior), p)
    for _ in range(MOST_REFITS):
        at, converged = _Posterior(errors, along, prior.gaussian(*answer.prior)).maximum(p, backend)
        p, answers, before = at.p, frame_prior.possible_answers(at.likelihood, prior, at.p), answer
        answer = answers[0]
        if answer.prior == before.prior:
            break
    return _mixed(errors, prior, at, answers, converged)


def _nearer(
    errors: PredictionErrors, likelihood: frame_prior.Likelihood, prior: frame_prior.Gaussian, p: Floats
) -> Floats:
    """Return a better start: the maximum of a linearized likelihood, with the noise of p; p if it has no modes.

    The likelihood is linear in the levels of the noise over much smaller steps.
    """
    nearer = np.clip(frame_prior.Linear(likelihood, p, prior).posterior()[0], *errors.bounds(prior))
    nearer[errors.levels] = p[errors.levels]
    with contextlib.suppress(NoModesError, np.linalg.LinAlgError):
        return nearer if np.isfinite(errors.objective(nearer)) else p
    return p


def informative(errors: PredictionErrors, prior: frame_prior.FramePrior, p: Floats) -> Directions:
    """Find the directions on which the record has information, for all possible changes and errors of form."""
    short = errors.shortened(PROBED_SAMPLES)
    root = np.asarray(np.linalg.cholesky(prior.widest.covariance), dtype=np.float64)
    return short.informed(p, root, LEAST_INFORMATION * np.sqrt(short.samples / errors.samples))


def refitted(frame: FittedFrame, errors: PredictionErrors, backend: Backend, *, free: bool) -> FittedFrame:
    """Fit the frame again to other innovations, without a sensor, with the same possible answers.

    One Gauss-Newton step is enough: the fit starts from the result with all sensors, and mainly needs the new
    covariance. A frame that is not free stays unchanged.
    """
    if not free:
        return replace(frame, errors=errors)
    posterior = _Posterior(errors, frame.along, frame.prior.gaussian(*frame.answers[0].prior))
    at, converged = posterior.maximum(frame.p, backend, replace(FITTED, most_steps=1))
    return _mixed(errors, frame.prior, at, frame.answers, converged)


def _mixed(
    errors: PredictionErrors,
    prior: frame_prior.FramePrior,
    at: _Point,
    answers: Sequence[frame_prior.FrameAnswer],
    converged: bool,
) -> FittedFrame:
    """Return the frame with the covariance of the mixture of the answers."""
    covariance = np.zeros((errors.size, errors.size))
    linears = [frame_prior.Linear(at.likelihood, at.p, prior.gaussian(*each.prior)) for each in answers]
    for each, linear in zip(answers, linears, strict=True):
        mean, own = linear.posterior()
        away = mean - at.p
        covariance += each.probability * (own + np.outer(away, away))
    # The log probability over all answers is the best answer's, divided by its probability.
    best, (evidence,) = answers[0], linears[0].evidences((), [()])
    evidence += sum(prior.changes[each].log_odds for each in best.changed) - float(np.log(best.probability))
    # The triangle has the part that depends on the unknowns; the rest of -2 log likelihood is constant.
    evidence -= 0.5 * (errors.objective(at.p) - float(at.likelihood.c @ at.likelihood.c))
    inflation, along = at.likelihood.inflation, at.posterior.along
    return FittedFrame(errors, prior, at.p, covariance, tuple(answers), inflation, converged, along, evidence)
