"""The frame as it was in a record: fitted to the innovations, single stories freed by the evidence.

The likelihood of the innovations times a Gaussian prior is maximized by Gauss-Newton, whose steps are programs with
bounds: first over a short part of the record, then over a long one. Which stories changed by themselves, and how much
the form of the model misses, is decided by the evidence of the linearised likelihood; the covariance is that of the
mixture of all answers.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.priors import Constraints
from cvxshear.programs.statements import NamedConstraints
from cvxshear.response.damped import DampedModel
from cvxshear.response.innovations import Directions, Likelihood, PredictionErrors
from cvxshear.response.varied_frame import (
    FORM_STDS,
    GAIN_STDS,
    GAIN_UNIT,
    MASS_STDS,
    NOISE_STD,
    SCATTER_STDS,
    FramePrior,
    Gaussian,
)
from cvxshear.util.typing import Floats

FIRST_SAMPLES, FITTED_SAMPLES = 2_000, 10_000
"""Samples of each run, the strongest stretch of that length, that the frame is fitted to first and at last. More would
sharpen a linear frame by the root of their number, which model error does not allow, and cost in proportion."""

LEAST_INFORMATION, FIRST_INFORMATION = 0.5, 10.0
"""Length of a prior standard deviation in those of the record's from which on a direction is fitted along, at last and
at first. Along one of less the variance would fall by less than a fifth; it keeps that of the prior."""

MOST_FIT_STEPS = 12
"""Gauss-Newton steps at most; a fit that starts near takes four to six."""

FITTED, FIRST_FITTED = 0.1, 1.0
"""Largest change of a combined residual that ends the fit and the first one: that many standard deviations of one
parameter."""

MOST_DECISIONS = 3
"""Times that the stories left free are decided anew; the second decision mostly is the first."""

GROWN_INFLATION = 2.0
"""Growth of the inflation of the scores from which on the frame is fitted again under it: what is known of masses and
effects must not give way to the innovations of a model that is wrong."""

NONLINEAR = 4.0
"""Inflation of the scores from which on a record is said not to be that of a linear frame with sound sensors: those
have 1 to 2, with bending beams too, a clock 5 ms late makes it 5 and a story that yields 4 to 50."""

LEAST_WEIGHT = 1e-3
"""Probability of an answer, relative to the most probable one, below which it is left out of the average."""

MOST_CHANGES = 3
KEPT_SETS = 6
"""Changed stories in a set at most, and sets of each size that the next size grows from."""


_Widths = tuple[tuple[int, ...], float, float, float, float]
"""What changed by itself, and the standard deviations of form, stories, masses and gains."""


@dataclass(frozen=True, eq=False)
class Answer:
    """One possible way in which the frame differs from the identified one.

    Parameters
    ----------
    changed : tuple of int
        Stories, from 0, and sensors that changed by themselves: places in `FramePrior.single`.
    form_std : float
        Standard deviation of the errors of the model's form.
    scatter_std : float
        Standard deviation of the factors of the other stories.
    mass_std : float
        Standard deviation of the factors of the floor masses.
    gain_std : float
        Standard deviation of the gains of the sensors.
    probability : float
    """

    changed: tuple[int, ...]
    form_std: float
    scatter_std: float
    mass_std: float
    gain_std: float
    probability: float

    @property
    def prior(self) -> _Widths:
        """Arguments of `FramePrior.gaussian`."""
        return self.changed, self.form_std, self.scatter_std, self.mass_std, self.gain_std


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """The frame as it was in the record.

    Parameters
    ----------
    errors : PredictionErrors
    prior : FramePrior
    p : ndarray, shape (P,)
        Unknowns of `PredictionErrors`.
    covariance : ndarray, shape (P, P)
        Averaged over the answers.
    answers : tuple of Answer
        Most probable first.
    inflation : float
        Of the covariance, for innovations that are not white.
    converged : bool
    along : Directions
        Along which it was fitted.
    log_evidence : float
        Log of the probability of the record, averaged over the answers; that of the fit where the frame stays.
    """

    errors: PredictionErrors
    prior: FramePrior
    p: Floats
    covariance: Floats
    answers: tuple[Answer, ...]
    inflation: float
    converged: bool
    along: Directions
    log_evidence: float

    @cached_property
    def story_probability(self) -> Floats:
        """Probability that each story changed by itself, shape (N,)."""
        return self._changed[: self.errors.stories]

    @cached_property
    def gain_probability(self) -> Floats:
        """Probability that each sensor's gain is off by itself, shape (m,) with the excitation's last."""
        return self._changed[self.errors.stories :]

    @cached_property
    def _changed(self) -> Floats:
        result = np.zeros(self.errors.stories + self.errors.varied.gains)
        for each in self.answers:
            result[list(each.changed)] += each.probability
        return result

    @property
    def mass_probability(self) -> float:
        """Probability that floor masses changed."""
        return sum(each.probability for each in self.answers if each.mass_std > 0)

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Relative error of each sensor, the excitation's last, and its standard deviation, shapes (m,)."""
        # An excitation that was larger than its sensor shows: that one reads too little.
        signs = np.where(self._sensors("log_gain")[:, -1] > 0, -1.0, 1.0)
        values, std = self._unknown_sensors("log_gain")
        return GAIN_UNIT * signs * values, GAIN_UNIT * std

    @property
    def brackets(self) -> tuple[Floats, Floats]:
        """What each sensor stands on (`DampedModel.bracket`), and its standard deviation, shapes (m,), s2."""
        unit = self._sensors("dbracket").sum(axis=1)
        values, std = self._unknown_sensors("dbracket")
        return unit * values, unit * std

    def _sensors(self, name: str) -> Floats:
        """Return the rows of an array of the sensors' directions that are not empty."""
        rows: Floats = getattr(self.errors.varied, name)
        return rows[rows.any(axis=1)]

    def _unknown_sensors(self, name: str) -> tuple[Floats, Floats]:
        """Return those unknowns and their standard deviations."""
        rows = getattr(self.errors.varied, name)
        first = self.errors.varied.sensor_gains.stop - len(rows)
        at = first + np.flatnonzero(rows.any(axis=1))
        return self.p[at], np.sqrt(np.diag(self.covariance)[at])

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
        """Relative standard deviation of the total mass, and so of all stiffnesses, since floors may have changed.

        Base motion tells how each floor changed against the others, not all together.
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
        """Each story's factor over that of the stories that hardly changed, less one, and its deviation, shapes (N,).

        What all stories share, such as the scale of the masses, is in neither.
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

        Under the most probable answer in which they changed; zeros where there is none. The difference from the
        identified masses is partly the error of these.
        """
        N = self.errors.stories
        answer = next((each for each in self.answers if each.mass_std > 0), None)
        if answer is None:
            return np.zeros(N), np.zeros(N)
        prior, variance = self.prior.gaussian(*answer.prior), answer.mass_std**2
        heavier = np.zeros((len(self.p), self.prior.heavier_floors.shape[1]))
        heavier[self.errors.frame] = self.prior.heavier_floors
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
        """The frame at the most probable unknowns."""
        return self.errors.model(self.p)


class _Point:
    """The posterior at one point; derivatives are computed where they are asked for."""

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
    errors : PredictionErrors
    along : Directions
    prior : Gaussian
    inflation : float, optional
        By which the likelihood is tempered: scores of a model that is wrong scatter more than they say.
    """

    def __init__(self, errors: PredictionErrors, along: Directions, prior: Gaussian, inflation: float = 1.0) -> None:
        self.errors, self.along, self.prior, self.inflation = errors, along, prior, inflation
        self.white = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> _Point:
        return _Point(self, theta)

    def maximum(
        self, p: Floats, backend: Backend, steps: int, form_std: float, near: float = FITTED
    ) -> tuple[_Point, bool]:
        """Find the most probable point from p on, and whether it was reached within so many steps."""
        bounds = Constraints(lower=self.errors.lower(form_std), upper=self.errors.upper)
        domain = Domain([NamedConstraints("bounds", bounds)], np.ones(len(p)), np.full(len(p), np.inf))
        found = gauss_newton(self, p, domain, backend, Accuracy(near, steps))
        return found.at, found.converged


def fit_frame(
    errors: PredictionErrors, prior: FramePrior, backend: Backend, start: Floats | None = None, *, free: bool = True
) -> FittedFrame:
    """Fit the frame to the innovations.

    Parameters
    ----------
    errors : PredictionErrors
    prior : FramePrior
    backend : Backend
        Solves the steps.
    start : ndarray, shape (P,), optional
        Where an earlier fit ended; without it a rough fit to a short part goes before.
    free : bool, optional
        Whether the frame is fitted; otherwise only the noise is.
    """
    p = np.zeros(errors.size) if start is None else start
    answer = Answer((), FORM_STDS[0], SCATTER_STDS[0], MASS_STDS[0], GAIN_STDS[0], 1.0)
    if not free:
        noise = np.eye(errors.size)[errors.frame.stop :]
        # The frame stays as it was identified: nothing of it is fitted, its uncertainty is in the bands.
        still = Gaussian(np.zeros(errors.size), NOISE_STD**2 * np.eye(errors.size), 0.0)
        at, converged = _Posterior(errors, Directions(noise.T, noise), still).maximum(
            p, backend, MOST_FIT_STEPS, FORM_STDS[-1]
        )
        covariance = prior.gaussian(*answer.prior, same=errors.setting.base_measured).covariance
        along, evidence = at.posterior.along, -0.5 * at.objective
        return FittedFrame(errors, prior, at.p, covariance, (answer,), 1.0, converged, along, evidence)
    if start is None:
        rough = _Posterior(
            errors.shortened(FIRST_SAMPLES, p),
            informative(errors, prior, p, FIRST_INFORMATION),
            prior.widest,
        )
        p = rough.maximum(p, backend, MOST_FIT_STEPS, FORM_STDS[-1], FIRST_FITTED)[0].p
    along, inflation = informative(errors, prior, p), 1.0
    # From the prior of another answer, or far from that of the right one, the fit would move masses or their scale in
    # place of a changed story, and hardly find back: base motion does not tell that scale.
    rough_likelihood = errors.linearised(p, along)
    answer = possible_answers(rough_likelihood, prior, p)[0]
    nearer, _ = _Linear(rough_likelihood, p, prior.gaussian(*answer.prior)).posterior()
    nearer = np.clip(nearer, errors.lower(answer.form_std), errors.upper)
    p = nearer if errors.stable(nearer) else p
    for _ in range(MOST_DECISIONS):
        posterior = _Posterior(errors, along, prior.gaussian(*answer.prior), inflation)
        at, converged = posterior.maximum(p, backend, MOST_FIT_STEPS, answer.form_std)
        p, answers, before = at.p, possible_answers(at.likelihood, prior, at.p), answer
        answer = answers[0]
        if answer.prior == before.prior and at.likelihood.inflation <= GROWN_INFLATION * inflation:
            break
        inflation = max(inflation, at.likelihood.inflation)
    asked = answer.mass_std or answer.gain_std > GAIN_STDS[0] or max(answer.changed, default=0) >= errors.stories
    if asked and at.likelihood.inflation > NONLINEAR:
        # Masses and gains that leave the record as unlike a linear frame's as this take up what is none of theirs.
        return fit_frame(errors, prior.linear_alone, backend, start)
    found = _mixed(errors, prior, at, answers, converged)
    if converged or start is not None:
        return found
    # From the frame as it was identified the way may be another.
    again = fit_frame(errors, prior, backend, np.zeros(errors.size))
    return again if again.converged or again.log_evidence > found.log_evidence else found


def informative(errors: PredictionErrors, prior: FramePrior, p: Floats, least: float = LEAST_INFORMATION) -> Directions:
    """Find the directions on which the record has information, whichever stories changed and whatever the form misses.

    Parameters
    ----------
    errors : PredictionErrors
    prior : FramePrior
    p : ndarray, shape (P,)
    least : float, optional
    """
    # An unknown first state would hide from a short part what the whole record tells.
    short = errors.shortened(FIRST_SAMPLES, p, free=False)
    root = np.asarray(np.linalg.cholesky(prior.widest.covariance), dtype=np.float64)
    return short.informed(p, root, least * np.sqrt(short.samples / errors.samples))


def refitted(frame: FittedFrame, errors: PredictionErrors, gone: int, backend: Backend, steps: int) -> FittedFrame:
    """Fit the frame again without one sensor, with the same answers possible.

    Parameters
    ----------
    frame : FittedFrame
    errors : PredictionErrors
    gone : int
        Unknown that the sensor's noise was.
    backend : Backend
    steps : int
        At most; with none the frame stays as it was.
    """
    prior = dataclasses.replace(frame.prior, others=frame.prior.others - 1)
    start = np.delete(frame.p, gone)
    if not steps:
        covariance = np.delete(np.delete(frame.covariance, gone, axis=0), gone, axis=1)
        return FittedFrame(errors, prior, start, covariance, frame.answers, 1.0, True, frame.along, frame.log_evidence)
    along = frame.along.without(gone)
    best = frame.answers[0]
    posterior = _Posterior(errors, along, prior.gaussian(*best.prior), frame.inflation)
    at, converged = posterior.maximum(start, backend, steps, best.form_std)
    return _mixed(errors, prior, at, frame.answers, converged)


def _mixed(
    errors: PredictionErrors, prior: FramePrior, at: _Point, answers: Sequence[Answer], converged: bool
) -> FittedFrame:
    """Return the frame with the covariance of the mixture of the answers."""
    total = sum(each.probability for each in answers)
    covariance = np.zeros((errors.size, errors.size))
    for each in answers:
        mean, own = _Linear(at.likelihood, at.p, prior.gaussian(*each.prior)).posterior()
        away = mean - at.p
        covariance += each.probability / total * (own + np.outer(away, away))
    inflation, along, evidence = at.likelihood.inflation, at.posterior.along, _log_evidence(at, prior, answers)
    return FittedFrame(errors, prior, at.p, covariance, tuple(answers), inflation, converged, along, evidence)


def _log_evidence(at: _Point, prior: FramePrior, answers: Sequence[Answer]) -> float:
    """Log of the probability of the record, all answers together: that of the best one over its share."""
    best = answers[0]
    linear = _Linear(at.likelihood, at.p, prior.gaussian(*best.prior))
    own = linear.evidence(np.zeros((len(at.p), 0))).plain + float(prior.log_odds[list(best.changed)].sum())
    # The triangle holds what depends on the unknowns; the rest of -2 log likelihood is the same for all of them.
    rest = at.posterior.errors.objective(at.p) - float(at.likelihood.c @ at.likelihood.c)
    return own - float(np.log(best.probability)) - 0.5 * rest


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Log evidence of linear data, but for a constant.

    Parameters
    ----------
    plain : float
        Of the prior as it is.
    G, b : ndarray, shapes (N, N) and (N,)
        Products of the directions along which it may be wider, as the data see them, with each other and the data.
    """

    plain: float
    G: Floats
    b: Floats

    def of(self, sets: Sequence[tuple[int, ...]]) -> Floats:
        """Log evidences of priors whose covariance is larger by the outer products of some directions, shape (len,)."""
        result = np.full(len(sets), self.plain)
        # Sets of one size together: one by one they take half the time of a reconstruction.
        for size in {len(own) for own in sets} - {0}:
            chosen = [place for place, own in enumerate(sets) if len(own) == size]
            at = np.array([sets[place] for place in chosen], dtype=np.int64)
            wider = np.eye(size) + self.G[at[:, :, None], at[:, None, :]]
            within = np.linalg.solve(wider, self.b[at][:, :, None])[:, :, 0]
            result[chosen] += 0.5 * (np.sum(self.b[at] * within, axis=1) - np.linalg.slogdet(wider)[1])
        return result


class _Linear:
    """Linear data of unknowns with a Gaussian prior, the likelihood tempered by its inflation.

    Parameters
    ----------
    at : Likelihood
    p : ndarray, shape (P,)
        Where it was linearised.
    prior : Gaussian
    """

    def __init__(self, at: Likelihood, p: Floats, prior: Gaussian) -> None:
        self.U, self.prior, self.covariance = at.U, prior, prior.covariance
        self.data = at.U @ (p - prior.mean) - at.c
        self.seen = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(at.c))

    def evidence(self, changes: Floats) -> _Evidence:
        """Return the evidence, as it depends on what changed by itself.

        Parameters
        ----------
        changes : ndarray, shape (P, N)
            Directions, each a standard deviation long, along which the prior may be wider.
        """
        half = np.asarray(np.linalg.cholesky(self.seen))
        white = np.linalg.solve(half, np.column_stack([self.U @ changes, self.data]))
        moved, data = white[:, :-1], white[:, -1]
        plain = self.prior.evidence - 0.5 * float(data @ data) - float(np.sum(np.log(half.diagonal())))
        return _Evidence(plain, moved.T @ moved, moved.T @ data)

    def posterior(self) -> tuple[Floats, Floats]:
        """Mean and covariance of the unknowns."""
        spread = self.U @ self.covariance
        gain = np.linalg.solve(self.seen, spread).T
        return self.prior.mean + gain @ self.data, self.covariance - gain @ spread


def possible_answers(at: Likelihood, prior: FramePrior, p: Floats) -> tuple[Answer, ...]:
    """Which stories and gains may have changed and how much the form may miss, by the linearised likelihood's evidence.

    Sets of each size grow from the best of the size before. All sizes of the form's errors, of the scatter of the
    stories, and of what the masses changed by, are equally probable beforehand.

    Parameters
    ----------
    at : Likelihood
        At p.
    prior : FramePrior
    p : ndarray, shape (P,)
    """
    single, log_odds = range(len(prior.single)), prior.log_odds.tolist()
    scores: dict[_Widths, float] = {}
    changes = np.eye(len(p))[:, prior.single] * prior.single_std
    for widths in itertools.product(FORM_STDS, SCATTER_STDS, prior.mass_stds, prior.gain_stds):
        evidence = _Linear(at, p, prior.gaussian((), *widths)).evidence(changes)
        level: list[tuple[int, ...]] = [()]
        for size in range(min(MOST_CHANGES, len(single)) + 1):
            grown = level
            if size:
                pairs = itertools.product(level, single)
                grown = sorted({tuple(sorted({*base, other})) for base, other in pairs if other not in base})
            own = {
                each: score + sum(log_odds[at] for at in each)
                for each, score in zip(grown, evidence.of(grown).tolist(), strict=True)
            }
            scores |= {(each, *widths): score for each, score in own.items()}
            level = sorted(own, key=own.__getitem__, reverse=True)[:KEPT_SETS]
    best = max(scores.values())
    kept = {each: np.exp(score - best) for each, score in scores.items() if score > best + np.log(LEAST_WEIGHT)}
    total = sum(kept.values())
    order = sorted(kept, key=lambda each: -kept[each])
    return tuple(Answer(*each, float(kept[each] / total)) for each in order)
