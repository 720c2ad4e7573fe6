"""The frame as it was in a record, from the innovations of the filter (prediction-error method, Ljung 1999).

The filter of a candidate frame predicts each sample of each sensor from all samples before it. Were the frame and the
noise right, what is left (the innovations) would be white with the covariance that the filter states. Their likelihood,

    -2 log L = sum over samples of e_t' S^-1 e_t + samples log det S,

and a Gaussian prior are maximized by Gauss-Newton over the logarithms of factors on the story stiffnesses and on the
damping and over those of the noise. The derivatives run with the filter: with F = A - K H,

    x'_(t+1) = F x'_t + (A' - K' H - K H') x_t + K' (y_t - D p_t) + B' p_t,   e'_t = -H x'_t - H' x_t - D' p_t.

log det S has no residual of its own; rows sqrt(T/2) (I - S^(-1/2) mean(e e') S^(-1/2)) have its gradient and its
expected curvature (Fisher scoring), so that a step stays one least-squares program with bounds.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects.story_change import StoryChange
from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import modes, stiffness_matrix
from cvxshear.programs import LeastSquares
from cvxshear.response.dynamics import Dynamics, Noise, Setting, dynamics, recursion
from cvxshear.response.model import DampedModel
from cvxshear.response.smoother import Steady
from cvxshear.response.uncertain import Damped, UncertainFrame, modal_matrix
from cvxshear.util.typing import Floats, Ints

AMPLITUDE_STD = 0.15
"""Relative standard deviation of one factor on all story stiffnesses: instrumented buildings soften by some 5 to 30 %
in strong shaking and mostly recover (Clinton, Bradford, Heaton and Favela 2006), bench frames by some percent."""

SCATTER_STD = 0.01
"""Relative standard deviation by which unchanged stories soften differently: a tenth of what the whole frame does."""

DAMPING_STD = 0.5
"""Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude."""

OTHER_DAMPING_STD = 0.3
"""Standard deviation of the logarithm of each dashpot, or of Rayleigh's factors, by themselves."""

FIRST_SENSOR = 0.02
FIRST_FORCE = 0.02
"""Sensor noise, relative to a channel's rms, and missed story forces, relative to the rms story force, where the fit
starts and where their priors are centred."""

NOISE_STD = 1.0
"""Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two."""

MOST_NUISANCES = 12
LEAST_EFFECT = 1e-4
"""Combinations of uncertain masses and effects that are fitted along at most, and the least relative change of a mode
that makes one worth it: those left out move no peak by a hundredth of a percent, or are the weakest of many."""

FURTHEST = np.log(10.0)
"""Bound on the logarithm of factors on stiffness and damping: a story ten times softer is another frame."""

FURTHEST_NOISE = np.log(30.0)
"""Bound on the logarithm of a sensor's noise around its start: none is good to 0.1 % of a building's motion."""

FURTHEST_FORCE = np.log(5.0)
"""The same of the missed story forces: 0.4 % to 10 % of the rms story force. No frame is linear to less, and a model
that misses more has no business in a reconstruction."""

DIFFERENCE = 1e-5
"""Step of the logarithms by which small matrices are differentiated: rounding and curvature both leave 1e-5 of it."""

MOST_FIT_STEPS = 12
"""Gauss-Newton steps at most; a fit that starts near takes four to six."""

LEAST_GAIN = 0.1
"""Decrease of -2 log likelihood that ends the fit: a third of a standard deviation of one parameter."""

MOST_DECISIONS = 3
"""Times that the stories left free are decided anew; the second decision mostly is the first."""

DAMPED = (0.0, 1e-2, 1.0, 1e2, 1e4)
"""Weights of rows that hold a step back, relative to the sensitivity to each parameter, tried until one improves."""

FITTED_SAMPLES = 10_000
"""Samples that the frame is fitted to: the strongest stretch of that length. More would sharpen a linear frame by the
root of their number, which model error does not allow, and cost in proportion."""

SCORE_PERIODS = 4.0
"""Fundamental periods over which scores are summed before their scatter is taken: errors of a wrong model hang together
for about as long."""

LEAST_WEIGHT = 1e-3
"""Probability of a set of changed stories below which it is left out of the average."""

MOST_CHANGES = 3
KEPT_SETS = 6
"""Changed stories in a set at most, and sets of each size that the next size grows from."""


@dataclass(frozen=True, eq=False)
class Varied:
    """A damped frame with factors on its story stiffnesses and damping, and with masses and effects that may be off.

    Parameters
    ----------
    centre : Damped
    story_stiffness : ndarray, shape (N,)
        N/m.
    ratios : ndarray, shape (N,)
        Damping ratios of the modes, of modal damping.
    own_std : ndarray, shape (D,)
        Of the logarithm of each damping factor, by itself.
    dM, dK : ndarray, shape (W, N, N)
        Change of the matrices along each direction of the uncertainty of masses and effects, one standard deviation.
    dgain : ndarray, shape (W, N)
    """

    centre: Damped
    story_stiffness: Floats
    ratios: Floats
    own_std: Floats
    dM: Floats
    dK: Floats
    dgain: Floats

    @staticmethod
    def of(frame: UncertainFrame) -> Varied:
        """Around the most probable values of an uncertain frame."""
        centre = frame.at(np.zeros(frame.size))
        if frame.kind == "modal":
            own = frame.ratios.std
        else:
            own = np.full(2 if centre.rayleigh is not None else len(centre.model.M), OTHER_DAMPING_STD)
        base = frame.undamped(frame.fitted.theta)
        directions = frame.nuisance_root()
        moved = [frame.undamped(frame.fitted.theta + column) for column in directions.T]
        shape = (len(moved), *base.M.shape)
        dM, dK, dgain = (
            np.array([getattr(each, name) - getattr(base, name) for each in moved]).reshape(shape[: 1 + at.ndim])
            for name, at in (("M", base.M), ("K", base.K), ("gain", base.gain))
        )
        whole = Varied(centre, frame.story_stiffness, frame.ratios.values, own, dM, dK, dgain)
        return whole._reduced()

    def _reduced(self) -> Varied:
        """With the combinations of the directions that change modes at all, the strongest first."""
        if not len(self.dM):
            return self
        old = self.centre.model

        def described(M: Floats, K: Floats) -> Floats:
            found = modes(M, K)
            # What base motion makes each floor do in each mode, which has neither scale nor sign.
            moved = found.shapes * (found.shapes @ M.sum(axis=1))[:, None]
            return np.concatenate([np.log(found.frequencies), moved.ravel()])

        centre = described(old.M, old.K)
        slopes = [
            (described(old.M + 0.01 * M, old.K + 0.01 * K) - centre) / 0.01
            for M, K in zip(self.dM, self.dK, strict=True)
        ]
        effect = np.concatenate([np.array(slopes).T, self.dgain.T])
        _, sizes, turns = np.linalg.svd(effect, full_matrices=False)
        turns = turns[:MOST_NUISANCES][sizes[:MOST_NUISANCES] > LEAST_EFFECT]
        turned = (np.tensordot(turns, each, axes=1) for each in (self.dM, self.dK, self.dgain))
        return Varied(self.centre, self.story_stiffness, self.ratios, self.own_std, *turned)

    def model(self, stiffness: Floats, damping: Floats, nuisance: Floats) -> DampedModel:
        """The frame of given logarithms of the factors, and masses and effects so many standard deviations off."""
        old = self.centre.model
        M = old.M + np.tensordot(nuisance, self.dM, axes=1)
        K = old.K + np.tensordot(nuisance, self.dK, axes=1)
        K = K + stiffness_matrix(self.story_stiffness * np.expm1(stiffness))
        scale = np.exp(damping)
        if self.centre.dashpots is not None:
            C = stiffness_matrix(self.centre.dashpots.values * scale)
        elif self.centre.rayleigh is not None:
            a, b = self.centre.rayleigh * scale
            C = a * M + b * K
        else:
            C = modal_matrix(M, modes(M, K), self.ratios * scale)
        gain = old.gain + nuisance @ self.dgain
        return DampedModel(M, C, K, gain, old.heights, old.mass_known)


@dataclass(frozen=True, eq=False)
class Stretch:
    """One run without gaps.

    Parameters
    ----------
    excitation : ndarray, shape (samples,)
    y : ndarray, shape (samples, m)
        Accelerations, spikes and gaps filled in.
    start : ndarray, shape (n,)
        State at the beginning.
    """

    excitation: Floats
    y: Floats
    start: Floats


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The linearised likelihood at one point: -2 log L = |U d + c|^2 + constant for a step d.

    Parameters
    ----------
    U, c : ndarray, shapes (P, P) and (P,)
    inflation : float
        Scatter of the summed scores over what a white innovation would have; at least 1.
    """

    U: Floats
    c: Floats
    inflation: float


class PredictionErrors:
    """Innovations of candidates for the frame in a record.

    Unknowns: logarithms of N factors on story stiffnesses and of D on damping, W directions of masses and effects in
    standard deviations, and the logarithms of m sensor noises, of the missed story forces, and of the base acceleration
    where nobody measured it.

    Parameters
    ----------
    varied : Varied
    setting : Setting
    stretches : sequence of Stretch
    noise : Noise
        Where the noise levels start.
    lacking : float, optional
        Relative error of the model's mode shapes where the modes speak against it: the story forces that it misses are
        taken as at least as large.
    """

    def __init__(
        self, varied: Varied, setting: Setting, stretches: Sequence[Stretch], noise: Noise, lacking: float = 0.0
    ) -> None:
        self.varied, self.setting, self.stretches, self.noise = varied, setting, stretches, noise
        self.stories, self.dampers = len(varied.story_stiffness), len(varied.own_std)
        self.frame = slice(0, self.stories + self.dampers + len(varied.dM))
        extra = 0 if setting.base_measured else 1
        self.size = self.frame.stop + len(setting.floors) + 1 + extra
        self.upper = np.full(self.size, FURTHEST_NOISE)
        self.upper[self.frame] = FURTHEST
        force = self.frame.stop + len(setting.floors)
        self.upper[force] = FURTHEST_FORCE
        self.lower = -self.upper
        self.lower[force] = min(max(self.lower[force], np.log(max(lacking, 1e-6) / noise.force)), FURTHEST_FORCE)

    @property
    def samples(self) -> int:
        """Of all stretches together."""
        return sum(len(each.y) for each in self.stretches)

    def model(self, p: Floats) -> DampedModel:
        """The frame at a point."""
        return self.varied.model(*np.split(p[self.frame], [self.stories, self.stories + self.dampers]))

    def noise_at(self, p: Floats) -> Noise:
        """The noise at a point."""
        levels = np.exp(p[self.frame.stop :])
        m = len(self.setting.floors)
        ground = self.noise.ground * levels[m + 1] if len(levels) > m + 1 else 0.0
        return Noise(self.noise.sensors * levels[:m], float(self.noise.force * levels[m]), float(ground))

    def dynamics(self, p: Floats) -> Dynamics:
        """The state-space model at a point."""
        return dynamics(self.model(p), self.noise_at(p), self.setting)

    def objective(self, p: Floats) -> float:
        """-2 log likelihood, without its constant."""
        filtered = Steady.of(self.dynamics(p))
        _, log_det = np.linalg.slogdet(filtered.S)
        inverse = np.linalg.inv(filtered.S)
        total = self.samples * float(log_det)
        for run in self.stretches:
            _, e = filtered.predicted(run.excitation, run.y, run.start)
            total += float(np.sum((e @ inverse) * e))
        return total

    def linearised(self, p: Floats, free: Ints | None = None) -> Likelihood:
        """The rows of a Gauss-Newton step of some of the unknowns, of all where not given, reduced to a triangle."""
        which = np.arange(self.size) if free is None else free
        here = Steady.of(self.dynamics(p))
        whitening = np.linalg.inv(np.linalg.cholesky(here.S))
        slopes = [self._slope(here, p, int(j)) for j in which]
        m = len(whitening)
        residuals: list[Floats] = []
        derivatives: list[Floats] = []
        mean = np.zeros((m, m))
        for run in self.stretches:
            x, e = here.predicted(run.excitation, run.y, run.start)
            seen = run.y - np.outer(run.excitation, here.model.direct)
            following = np.append(run.excitation[1:], run.excitation[-1])
            J = np.empty((len(which), *e.shape))
            for j, slope in enumerate(slopes):
                inputs = x @ slope.through.T + seen @ slope.K.T
                inputs += np.outer(run.excitation, slope.before) + np.outer(following, slope.after)
                dx = recursion(here.F, inputs, np.zeros(len(here.P)))
                moved = -dx @ here.model.H.T - x @ slope.H.T - np.outer(run.excitation, slope.direct)
                J[j] = moved @ whitening.T
            white = e @ whitening.T
            residuals.append(white)
            derivatives.append(J)
            mean += white.T @ white
        count = self.samples
        r = np.concatenate([each.ravel() for each in residuals])
        R = np.concatenate([each.reshape(len(which), -1) for each in derivatives], axis=1).T
        root = np.sqrt(count / 2)
        own = root * (np.eye(m) - mean / count).ravel()
        turns = np.array([(whitening @ slope.S @ whitening.T).ravel() for slope in slopes]).T * root
        # J'r of these rows is half the gradient of T log det S + sum e' S^-1 e by S.
        stacked = np.column_stack([np.concatenate([R, turns]), np.concatenate([r, own])])
        whole = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
        U, c = whole[:-1, :-1], whole[:-1, -1]
        return Likelihood(U, c, 1.0 if free is not None else self._inflation(residuals, derivatives))

    def _inflation(self, residuals: Sequence[Floats], derivatives: Sequence[Floats]) -> float:
        """How much more the summed scores of the frame's parameters scatter than of white innovations."""
        frequency = float(self.varied.centre.model.modes.frequencies[0])
        length = max(1, round(SCORE_PERIODS / (frequency * self.setting.step)))
        rows = self.frame.stop
        spread, curvature = np.zeros((rows, rows)), np.zeros((rows, rows))
        for white, J in zip(residuals, derivatives, strict=True):
            scores = np.sum(J[:rows] * white, axis=2)
            blocks = scores.shape[1] // length
            if blocks < 2:
                continue
            summed = scores[:, : blocks * length].reshape(rows, blocks, length).sum(axis=2)
            summed = summed - summed.mean(axis=1, keepdims=True)
            spread += summed @ summed.T
            flat = J[:rows, : blocks * length].reshape(rows, -1)
            curvature += flat @ flat.T
        if not np.any(curvature):
            return 1.0
        # What the record hardly tells has no scatter to measure.
        known = np.diag(curvature) > np.max(np.diag(curvature)) * 1e-6
        ratio = np.diag(spread)[known] / np.diag(curvature)[known]
        return max(1.0, float(np.mean(ratio)))

    def _slope(self, here: Steady, p: Floats, j: int) -> _Slope:
        moved = p.copy()
        moved[j] += DIFFERENCE
        there = Steady.of(self.dynamics(moved))

        def rate(name: str) -> Floats:
            new, old = (getattr(each.model, name) for each in (there, here))
            result: Floats = (new - old) / DIFFERENCE
            return result

        K = (there.K - here.K) / DIFFERENCE
        H = rate("H")
        through = rate("A") - K @ here.model.H - here.K @ H
        direct = rate("direct")
        # y - D p changes by -D' p, which the gain turns into a change of the state.
        before = rate("before") - here.K @ direct
        return _Slope(through, K, H, direct, before, rate("after"), (there.S - here.S) / DIFFERENCE)


@dataclass(frozen=True, eq=False)
class _Slope:
    """Derivatives of the filter's matrices by one unknown."""

    through: Floats
    K: Floats
    H: Floats
    direct: Floats
    before: Floats
    after: Floats
    S: Floats


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian prior of the unknowns of `PredictionErrors`.

    Parameters
    ----------
    identified : ndarray, shape (N, N)
        Covariance of the logarithms of the story stiffnesses as they were identified, masses and effects given.
    change_std : float
        Of the logarithm of a changed story's factor.
    probability : float
        That one story changed.
    own_damping : ndarray, shape (D,)
    nuisances : int
        W.
    others : int
        Number of noise levels.
    """

    identified: Floats
    change_std: float
    probability: float
    own_damping: Floats
    nuisances: int
    others: int

    @staticmethod
    def of(frame: UncertainFrame, errors: PredictionErrors) -> Prior:
        """What was identified, and what is expected of a story that changed."""
        change = _expected_change(frame.fitted.experiment)
        stories = frame.fitted.experiment.stories
        size = float(change.sizes(None)[0])  # type: ignore[arg-type]  # this effect's size needs no scale of the frame
        return Prior(
            frame.conditional_stiffness(), size, 1.0 - (1.0 - change.probability) ** (1.0 / stories),
            errors.varied.own_std, len(errors.varied.dM), errors.size - errors.frame.stop,
        )  # fmt: skip

    def covariance(self, changed: Sequence[int]) -> Floats:
        """With given stories (from 0) changed."""
        N, D = len(self.identified), len(self.own_damping)
        result = np.eye(N + D + self.nuisances + self.others)
        stories = self.identified + AMPLITUDE_STD**2 + SCATTER_STD**2 * np.eye(N)
        stories[list(changed), list(changed)] += self.change_std**2
        result[:N, :N] = stories
        result[N : N + D, N : N + D] = DAMPING_STD**2 + np.diag(self.own_damping**2)
        at = np.arange(len(result) - self.others, len(result))
        result[at, at] = NOISE_STD**2
        return result

    def root(self, changed: Sequence[int]) -> Floats:
        """Cholesky factor of the covariance."""
        root: Floats = np.asarray(np.linalg.cholesky(self.covariance(changed)), dtype=np.float64)
        return root


def _expected_change(experiment: Experiment) -> StoryChange:
    """A story's change, as the measurement file expects it or as the catalogue does."""
    change = StoryChange()
    for said in experiment.expected:
        if said.name == change.name and said.story is None:
            return change.expecting(size=said.size, probability=said.probability)
    return change


@dataclass(frozen=True, eq=False)
class ChangedStories:
    """A set of stories that may have changed, and its probability."""

    stories: tuple[int, ...]
    probability: float
    mean: Floats
    covariance: Floats


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """The frame in the record.

    Parameters
    ----------
    errors : PredictionErrors
    prior : Prior
    p : ndarray, shape (P,)
        Unknowns of `PredictionErrors`.
    covariance : ndarray, shape (P, P)
        Averaged over the sets of changed stories.
    sets : tuple of ChangedStories
        Most probable first; stories from 0.
    inflation : float
        Of the covariance, for innovations that are not white.
    converged : bool
    """

    errors: PredictionErrors
    prior: Prior
    p: Floats
    covariance: Floats
    sets: tuple[ChangedStories, ...]
    inflation: float
    converged: bool

    @cached_property
    def story_probability(self) -> Floats:
        """That each story changed by itself, shape (N,)."""
        result = np.zeros(self.errors.stories)
        for each in self.sets:
            result[list(each.stories)] += each.probability
        return result

    @property
    def factors(self) -> Floats:
        """On the story stiffnesses, shape (N,)."""
        return np.exp(self.p[: self.errors.stories])

    @property
    def factors_std(self) -> Floats:
        """Their standard deviations, shape (N,)."""
        return self.factors * np.sqrt(np.diag(self.covariance)[: self.errors.stories])

    @property
    def model(self) -> DampedModel:
        """The frame."""
        return self.errors.model(self.p)


def fit_frame(
    errors: PredictionErrors, prior: Prior, backend: Backend, start: Floats | None = None,
    *, free: bool = True,
) -> FittedFrame:  # fmt: skip
    """Fit the frame to the innovations: the noise, then all stories together, then those that the evidence frees.

    Parameters
    ----------
    errors : PredictionErrors
    prior : Prior
    backend : Backend
        Solves the steps.
    start : ndarray, shape (P,), optional
    free : bool, optional
        Whether the frame is fitted; otherwise only the noise is.
    """
    p = np.zeros(errors.size) if start is None else start
    stories: tuple[int, ...] = ()
    if not free:
        noise = np.arange(errors.frame.stop, errors.size)
        p, _, converged = _descended(errors, prior.root(()), p, backend, MOST_FIT_STEPS, noise)
        kept = ChangedStories((), 1.0, p, prior.covariance(()))
        known = errors.setting.base_measured
        covariance = identified_only(prior) if known else prior.covariance(())
        return FittedFrame(errors, prior, p, covariance, (kept,), 1.0, converged)
    for _ in range(MOST_DECISIONS):
        p, at, converged = _descended(errors, prior.root(stories), p, backend, MOST_FIT_STEPS)
        sets = changed_stories(at, prior, p)
        if sets[0].stories == stories:
            break
        stories = sets[0].stories
    weights = np.array([each.probability for each in sets])
    covariance = np.zeros((errors.size, errors.size))
    for weight, each in zip(weights / weights.sum(), sets, strict=True):
        away = each.mean - p
        covariance += weight * (each.covariance + np.outer(away, away))
    return FittedFrame(errors, prior, p, covariance, sets, at.inflation, converged)


def identified_only(prior: Prior) -> Floats:
    """Covariance of the unknowns of a frame that stays as it was identified."""
    result = prior.covariance(())
    N, D = len(prior.identified), len(prior.own_damping)
    result[:N, :N] = prior.identified
    result[N : N + D, N : N + D] = np.diag(prior.own_damping**2)
    return result


def refitted(frame: FittedFrame, errors: PredictionErrors, start: Floats, backend: Backend, steps: int) -> FittedFrame:
    """The same frame fitted to other data, with the same stories free.

    Parameters
    ----------
    frame : FittedFrame
    errors : PredictionErrors
    start : ndarray, shape (P,)
    backend : Backend
    steps : int
        At most.
    """
    prior = dataclasses.replace(frame.prior, others=errors.size - errors.frame.stop)
    root = prior.root(frame.sets[0].stories)
    if not steps:
        return FittedFrame(errors, prior, start, identified_only(prior), frame.sets, 1.0, True)
    p, at, converged = _descended(errors, root, start, backend, steps)
    mean, covariance, _ = _posterior(at, root, p)
    found = ChangedStories(frame.sets[0].stories, 1.0, mean, covariance)
    return FittedFrame(errors, prior, p, covariance, (found,), at.inflation, converged)


def _descended(
    errors: PredictionErrors, root: Floats, p: Floats, backend: Backend, steps: int, free: Ints | None = None
) -> tuple[Floats, Likelihood, bool]:
    """Gauss-Newton from p over the free unknowns, on the posterior whose prior has this Cholesky factor."""
    white = np.linalg.inv(root)
    which = np.arange(errors.size) if free is None else free
    p = np.clip(p, errors.lower, errors.upper)
    value = errors.objective(p) + float(np.sum((white @ p) ** 2))
    at = errors.linearised(p, free)
    for _ in range(steps):
        taken = None
        sensitivity = np.linalg.norm(np.concatenate([at.U, white[:, which]]), axis=0)
        for weight in DAMPED:
            rows = np.concatenate([at.U, white[:, which], weight * np.diag(sensitivity)])
            side = np.concatenate([-at.c, -white @ p, np.zeros(len(which))])
            program = LeastSquares(rows, side, lower=(errors.lower - p)[which], upper=(errors.upper - p)[which])
            trial = p.copy()
            trial[which] += backend.solve(program).x
            found = errors.objective(trial) + float(np.sum((white @ trial) ** 2))
            if found < value:
                taken = trial, found
                break
        if taken is None:
            return p, at, True
        gain, (p, value) = value - taken[1], taken
        at = errors.linearised(p, free)
        if gain < LEAST_GAIN:
            return p, at, True
    return p, at, False


def _posterior(at: Likelihood, root: Floats, p: Floats) -> tuple[Floats, Floats, float]:
    """Mean, covariance and log evidence (but for a constant) of the linearised posterior, inflation allowed for."""
    U, c = at.U / np.sqrt(at.inflation), at.c / np.sqrt(at.inflation)
    # p = root w with w standard normal.
    rows = U @ root
    side = U @ p - c
    precision = np.eye(len(p)) + rows.T @ rows
    w = np.linalg.solve(precision, rows.T @ side)
    _, log_det = np.linalg.slogdet(precision)
    left = rows @ w - side
    evidence = -0.5 * (float(left @ left) + float(w @ w) + float(log_det))
    return root @ w, root @ np.linalg.solve(precision, root.T), evidence


def changed_stories(at: Likelihood, prior: Prior, p: Floats) -> tuple[ChangedStories, ...]:
    """The sets of stories that may have changed, by the evidence of the linearised likelihood.

    Sets of each size grow from the best of the size before.

    Parameters
    ----------
    at : Likelihood
        At p.
    prior : Prior
    p : ndarray, shape (P,)
    """
    N = len(prior.identified)
    odds = float(np.log(prior.probability) - np.log1p(-prior.probability))

    def judged(stories: tuple[int, ...]) -> tuple[float, Floats, Floats]:
        mean, covariance, evidence = _posterior(at, prior.root(stories), p)
        return evidence + odds * len(stories), mean, covariance

    found: dict[tuple[int, ...], tuple[float, Floats, Floats]] = {(): judged(())}
    level: list[tuple[int, ...]] = [()]
    for _ in range(min(MOST_CHANGES, N)):
        grown = {
            tuple(sorted({*base, story})) for base, story in itertools.product(level, range(N)) if story not in base
        }
        found |= {stories: judged(stories) for stories in grown}
        level = sorted(grown, key=lambda stories: -found[stories][0])[:KEPT_SETS]
    order = sorted(found, key=lambda stories: -found[stories][0])
    scores = np.array([found[stories][0] for stories in order])
    weights = np.exp(scores - scores[0])
    weights /= weights.sum()
    return tuple(
        ChangedStories(stories, float(weight), found[stories][1], found[stories][2])
        for stories, weight in zip(order, weights, strict=True)
        if weight >= LEAST_WEIGHT
    )


def strongest(y: Floats, most: int = FITTED_SAMPLES) -> slice:
    """The stretch of at most so many samples that holds the most of a record's motion.

    Parameters
    ----------
    y : ndarray, shape (samples, m)
        Every channel counts alike.
    most : int, optional
    """
    if len(y) <= most:
        return slice(0, len(y))
    scale = np.maximum(np.mean(y**2, axis=0), 1e-300)
    power = np.concatenate([[0.0], np.cumsum(np.sum(y**2 / scale, axis=1))])
    first = int(np.argmax(power[most:] - power[:-most]))
    return slice(first, first + most)
