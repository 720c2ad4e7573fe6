"""Prior of the frame in a record: its tests, and the probability of each change since.

The unknowns of a `VariedFrame` have a Gaussian prior, conditioned on the measured modes. The evidence selects its
standard deviations. The likelihood is linearized once. Each set of changed stories, dashpots and sensors has such a
prior, and one formula gives its evidence.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.effects import Effect
from cvxshear.effects.readings import SensorGain
from cvxshear.effects.stories import StoryChange
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import modes
from cvxshear.response.damped import DampedModel
from cvxshear.response.innovations import Likelihood
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.response.varied_frame import GAIN_UNIT, OTHER_DAMPING_STD, VariedFrame
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats, Ints

AMPLITUDE_STD = 0.15
"""Relative standard deviation of one factor on all story stiffnesses: instrumented buildings soften by some 5 to 30 %
in strong shaking and mostly recover (Clinton, Bradford, Heaton and Favela 2006), bench frames by some percent."""

SCATTER_STDS = (0.0003, 0.001, 0.003, 0.01)
"""Relative standard deviations of the factors of unchanged stories, compared by their evidence: from equal factors to a
tenth of the softening of the whole frame."""

DAMPING_STD = 0.5
"""Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude."""

DASHPOT_PROBABILITY = 0.1
"""Probability that a story has an undeclared dashpot. Most owners declare their dampers; a yielding story acts like a
damper."""

DASHPOT_STD, NO_DASHPOT_STD = 1.0, 1e-3
"""Standard deviations of a present and of an absent dashpot. The unit is the dashpot that gives a mode its measured
ratio without other damping."""

NOISE_STD = 1.0
"""Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two."""

MASS_STDS = (0.0, 0.05)
"""Relative standard deviations of mass changes since the tests, compared by their evidence: no change, or the usual
change of furniture."""

GAIN_STDS = (0.001, 0.01)
"""Relative standard deviations of the gains of all sensors, with the excitation's, compared by their evidence:
laboratory and field calibrations. A larger error of one sensor is a change with the prior of `SensorGain`."""

FORM_STDS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
"""Standard deviations of e_ij, compared by their evidence: from an exact shear frame to a frame with other modes than
the model's."""

MODAL_STEP = 1e-3
"""Step of the unknowns in derivatives of modes; curvature gives a relative error of a thousandth."""

ASSUMED_FREQUENCY_STD, ASSUMED_SHAPE_STD = 0.005, 0.02
"""Relative standard deviations of measured frequencies and shapes without declared ones: usual modal tests."""


@dataclass(frozen=True, eq=False)
class ModalRows:
    """Measured modes as linear data of a frame with errors of form, linearized at the identified frame.

    Parameters
    ----------
    J : ndarray, shape (d, N + W + X)
        Derivatives of frequencies and shape entries, in standard deviations, by the logarithms of the story
        stiffnesses in the tests, by masses and effects, and by e_ij.
    data : ndarray, shape (d,)
        Measured values minus the model's.
    """

    J: Floats
    data: Floats

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame) -> ModalRows:
        """Linearize all tests of the frame's state."""
        N, D, W, X = varied.sizes
        configurations = frame.fitted.experiment.configurations
        tests = [each for each in configurations if each.state == frame.configuration.state]

        def described(z: Floats) -> Floats:
            model = varied.model(np.concatenate([z[:N], np.zeros(D), z[N:]]))
            return np.concatenate(
                [np.zeros(0), *(_standardized(test, model, test.added_mass - frame.configuration.added_mass)
                                for test in tests)]
            )  # fmt: skip

        centre = described(np.zeros(N + W + X))
        if not len(centre) or not frame.uncertain:
            return ModalRows(np.zeros((0, N + W + X)), np.zeros(0))
        J = np.array([(described(MODAL_STEP * row) - centre) / MODAL_STEP for row in np.eye(N + W + X)]).T
        # The sensors of the tests had other gains.
        J[:, N + W - varied.gains : N + W] = 0.0
        return ModalRows(-J, centre)


def _standardized(test: Configuration, model: DampedModel, added: Floats) -> Floats:
    """Compute measured minus modeled frequencies and shape entries of one test, in standard deviations."""
    own = modes(model.M + np.diag(added), model.K)
    at = test.modes - 1
    std = ASSUMED_FREQUENCY_STD if test.frequency_std is None else test.frequency_std
    parts = [np.log(test.frequencies / own.frequencies[at]) / std]
    declared = np.asarray(ASSUMED_SHAPE_STD if test.mode_shape_std is None else test.mode_shape_std, dtype=np.float64)
    stds = np.broadcast_to(declared if declared.ndim == 2 else declared.reshape(-1, 1), test.mode_shapes.shape)
    for measured, mode, noise in zip(test.mode_shapes, at, stds, strict=False):
        there = np.isfinite(measured)
        if there.sum() < 2:
            continue
        entry = (own.shapes[mode] * model.gain)[test.measured_floors - 1][there]
        seen = measured[there]
        largest = np.abs(seen) if test.mode_shape_noise == "multiplicative" else np.abs(seen).max()
        weight = 1.0 / np.maximum(noise[there] * largest, 1e-12 * np.abs(seen).max())
        scale = float((weight * entry) @ (weight * seen) / ((weight * entry) @ (weight * entry)))
        parts.append(weight * (seen - scale * entry))
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class FramePrior:
    """Gaussian prior of the unknowns of a `VariedFrame` and of the levels of the noise.

    The measured modes enter twice: in the identified stiffnesses and masses, with an exact form of the model, and as
    data for the errors of form.

    Parameters
    ----------
    varied : VariedFrame
    others : int
        Number of noise levels.
    identified : ndarray, shape (N, N)
        Covariance of the identified log story stiffnesses, given masses and effects.
    change_std, gain_std : float
        Standard deviations of the logarithm of a changed story's factor, and of a wrong sensor gain.
    probability, gain_probability : float
        Probabilities that one story changed, and that one gain is wrong.
    measured : ModalRows
    mass_stds, gain_stds : tuple of float, optional
        Possible standard deviations of mass changes since the tests, and of the sensors' gains.
    """

    varied: VariedFrame
    others: int
    identified: Floats
    change_std: float
    gain_std: float
    probability: float
    gain_probability: float
    measured: ModalRows
    mass_stds: tuple[float, ...] = MASS_STDS
    gain_stds: tuple[float, ...] = GAIN_STDS

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame, others: int) -> FramePrior:
        """Set up the prior from the identified frame, and from the expected changes of a story."""
        experiment = frame.fitted.experiment
        size, probability = _expected(StoryChange(), experiment, experiment.stories)
        gain, off = _expected(SensorGain(), experiment, varied.gains)
        return FramePrior(
            varied, others, frame.conditional_stiffness(), size, gain, probability, off,
            ModalRows.around(frame, varied), MASS_STDS if varied.heavier_floors.shape[1] else MASS_STDS[:1],
        )  # fmt: skip

    @property
    def single(self) -> Ints:
        """Indices of the unknowns that may change individually: stories, dashpots, gains; shape (N + S + G,)."""
        gains = self.varied.sensor_gains if len(self.gain_stds) > 1 else slice(0)
        result: Ints = np.r_[: self.varied.sizes[0], self.varied.dashpots, gains]
        return result

    def _of_single(self, story: float, dashpot: float, gain: float) -> Floats:
        counts = [self.varied.sizes[0], len(np.r_[self.varied.dashpots])]
        return np.repeat([story, dashpot, gain], [*counts, len(self.single) - sum(counts)])

    @property
    def single_std(self) -> Floats:
        """Standard deviation of each single change, shape (N + S + G,)."""
        return self._of_single(self.change_std, DASHPOT_STD, self.gain_std / GAIN_UNIT)

    @property
    def log_odds(self) -> Floats:
        """Log odds of each single change, shape (N + S + G,)."""
        p = self._of_single(
            self.probability, _at_each(DASHPOT_PROBABILITY, self.varied.sizes[0]), self.gain_probability
        )
        return np.asarray(np.log(p) - np.log1p(-p), dtype=np.float64)

    @property
    def one_sided(self) -> Bools:
        """Mask of the positive unknowns (dashpots), shape (N + S + G,)."""
        return self._of_single(0.0, 1.0, 0.0) > 0

    def idle_dashpots(self, changed: Sequence[int]) -> Ints:
        """Return the indices of the absent dashpots if only these single unknowns changed."""
        return np.setdiff1d(np.r_[self.varied.dashpots], self.single[list(changed)])

    @property
    def widest(self) -> Gaussian:
        """Prior with all individual changes and with the largest standard deviations."""
        stds = FORM_STDS[-1], SCATTER_STDS[-1], self.mass_stds[-1], self.gain_stds[-1]
        return self.gaussian(range(len(self.single)), *stds)

    @property
    def linear_alone(self) -> FramePrior:
        """Copy of the prior without changes of floor masses and gains."""
        return dataclasses.replace(self, mass_stds=MASS_STDS[:1], gain_stds=GAIN_STDS[:1])

    def gaussian(
        self, changed: Sequence[int], form_std: float, scatter_std: float, mass_std: float, gain_std: float, *,
        same: bool = False,
    ) -> Gaussian:  # fmt: skip
        """Return the prior of an `FrameChange`.

        Parameters
        ----------
        same : bool, optional
            Whether stiffnesses and damping have not changed since the tests.
        """
        if (form_std, gain_std) not in self._by_modes:
            self._by_modes[form_std, gain_std] = self._given_modes(form_std, gain_std)
        by_modes = self._by_modes[form_std, gain_std]
        covariance = by_modes.covariance.copy()
        if not same:
            N, frame = self.varied.sizes[0], sum(self.varied.sizes)
            ratios = slice(N, self.varied.dashpots.start)
            covariance[:N, :N] += AMPLITUDE_STD**2 + scatter_std**2 * np.eye(N)
            covariance[ratios, ratios] += DAMPING_STD**2 + OTHER_DAMPING_STD**2 * np.eye(len(self.varied.own_std))
            at = self.single[list(changed)]
            covariance[at, at] += self.single_std[list(changed)] ** 2
            if mass_std:
                covariance[:frame, :frame] += mass_std**2 * (self.varied.heavier_floors @ self.varied.heavier_floors.T)
        return Gaussian(by_modes.mean, covariance, by_modes.evidence)

    @cached_property
    def _by_modes(self) -> dict[tuple[float, float], Gaussian]:
        """Results of `_given_modes` by their arguments; many answers share each."""
        return {}

    def _given_modes(self, form_std: float, gain_std: float) -> Gaussian:
        """Return the prior of a record without changes of stories, masses and damping since the tests."""
        N, D, W, X = self.varied.sizes
        # The errors of form limit the accuracy of masses and effects from modes.
        share = self.varied.nuisance_share
        modal = np.isfinite(share)
        nuisances = 1.0 + (form_std / share) ** 2 / max(int(modal.sum()), 1)
        nuisances[~modal] = (gain_std / GAIN_UNIT) ** 2
        rest = np.diag(np.concatenate([nuisances, np.full(X, form_std**2)]))
        tested = linalg.block_diag(self.identified, rest)
        own = self.varied.own_std
        damping = np.diag(np.append(own, np.full(D - len(own), NO_DASHPOT_STD)) ** 2)
        whole = linalg.block_diag(self.identified, damping, rest, NOISE_STD**2 * np.eye(self.others))
        # The record's stiffnesses are the tests' stiffnesses times factors: both change with the measured modes.
        crossed = np.zeros((len(whole), len(tested)))
        crossed[:N, :N] = self.identified
        crossed[N + D : N + D + W + X, N:] = rest
        J, data = self.measured.J, self.measured.data
        seen = J @ tested @ J.T + np.eye(len(data))
        gain = np.linalg.solve(seen, J @ crossed.T).T
        _, log_det = np.linalg.slogdet(seen)
        evidence = -0.5 * float(data @ np.linalg.solve(seen, data) + log_det)
        covariance = whole - gain @ J @ crossed.T
        return Gaussian(gain @ data, 0.5 * (covariance + covariance.T), evidence)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Mean and covariance of the unknowns, and the log evidence of the measured modes without a constant."""

    mean: Floats
    covariance: Floats
    evidence: float


def _expected(effect: Effect, experiment: Experiment, places: int) -> tuple[float, float]:
    """Return the size of an effect, and its probability at each place, from the file or else from the catalogue."""
    for said in experiment.expected:
        if said.name == effect.name and said.story is None and said.floor is None:
            effect = effect.expecting(size=said.size, probability=said.probability)
    return effect.size or effect.usual, _at_each(effect.probability, places)


def _at_each(probability: float, places: int) -> float:
    """Compute the probability at each of several places from the probability at any of them."""
    return float(1.0 - (1.0 - probability) ** (1.0 / max(places, 1)))


LEAST_WEIGHT = 1e-3
"""Minimum probability of an answer in the average, relative to the most probable answer."""

MOST_CHANGES = 3
KEPT_SETS = 6
"""Maximum number of changed stories in a set, and number of sets of each size that are extended."""

Widths = tuple[tuple[int, ...], float, float, float, float]
"""Single changes, and the standard deviations of form, stories, masses and gains."""


@dataclass(frozen=True, eq=False)
class FrameChange:
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
    """

    changed: tuple[int, ...]
    form_std: float
    scatter_std: float
    mass_std: float
    gain_std: float
    probability: float

    @property
    def prior(self) -> Widths:
        """Arguments of `FramePrior.gaussian`."""
        return self.changed, self.form_std, self.scatter_std, self.mass_std, self.gain_std


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Log evidence of linear data, without a constant.

    Parameters
    ----------
    plain : float
        Log evidence of the unchanged prior.
    G, b : ndarray, shapes (N, N) and (N,)
        For the directions along which the prior may be wider: products with each other, and with the data.
    """

    plain: float
    G: Floats
    b: Floats

    def of(self, sets: Sequence[tuple[int, ...]], one_sided: Bools) -> Floats:
        """Compute log evidences for sets of directions whose outer products are added to the covariance, (len,).

        Parameters
        ----------
        one_sided : ndarray of bool, shape (N,)
            Directions with positive unknowns; a set with a negative unknown has no evidence.
        """
        result = np.full(len(sets), self.plain)
        # Sets of the same size are computed together; single computations would take half of the whole time.
        for size in {len(own) for own in sets} - {0}:
            chosen = np.array([place for place, own in enumerate(sets) if len(own) == size])
            at = np.array([sets[place] for place in chosen], dtype=np.int64)
            wider = np.eye(size) + self.G[at[:, :, None], at[:, None, :]]
            within = np.linalg.solve(wider, self.b[at][:, :, None])[:, :, 0]
            result[chosen] += 0.5 * (np.sum(self.b[at] * within, axis=1) - np.linalg.slogdet(wider)[1])
            result[chosen[np.any((within < 0) & one_sided[at], axis=1)]] = -np.inf
        return result


class Linear:
    """Linear data of unknowns with a Gaussian prior; the inflation divides the log likelihood.

    Parameters
    ----------
    p : ndarray, shape (P,)
        Point of the linearization.
    """

    def __init__(self, at: Likelihood, p: Floats, prior: Gaussian) -> None:
        self.U, self.prior, self.covariance = at.U, prior, prior.covariance
        self.data = at.U @ (p - prior.mean) - at.c
        self.seen = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(at.c))

    def evidence(self, changes: Floats) -> _Evidence:
        """Return the evidence of priors that may be wider along columns of changes, one standard deviation long."""
        half = np.asarray(np.linalg.cholesky(self.seen))
        white = np.linalg.solve(half, np.column_stack([self.U @ changes, self.data]))
        moved, data = white[:, :-1], white[:, -1]
        plain = self.prior.evidence - 0.5 * float(data @ data) - float(np.sum(np.log(half.diagonal())))
        return _Evidence(plain, moved.T @ moved, moved.T @ data)

    def posterior(self) -> tuple[Floats, Floats]:
        """Compute mean and covariance of the unknowns."""
        spread = self.U @ self.covariance
        gain = np.linalg.solve(self.seen, spread).T
        return self.prior.mean + gain @ self.data, self.covariance - gain @ spread


def possible_answers(at: Likelihood, prior: FramePrior, p: Floats) -> tuple[FrameChange, ...]:
    """List the possible changes of stories and gains and errors of form, by the evidence of the linearized likelihood.

    Sets of each size extend the best sets of the previous size. All standard deviations of the errors of form, of the
    scatter of the stories and of the mass changes have the same prior probability.
    """
    single, log_odds, one_sided = range(len(prior.single)), prior.log_odds, prior.one_sided
    scores: dict[Widths, float] = {}
    changes = np.eye(len(p))[:, prior.single] * prior.single_std
    for widths in itertools.product(FORM_STDS, SCATTER_STDS, prior.mass_stds, prior.gain_stds):
        evidence = Linear(at, p, prior.gaussian((), *widths)).evidence(changes)
        level: list[tuple[int, ...]] = [()]
        for size in range(min(MOST_CHANGES, len(single)) + 1):
            grown = level
            if size:
                pairs = itertools.product(level, single)
                grown = sorted({tuple(sorted({*base, other})) for base, other in pairs if other not in base})
            odds = log_odds[np.array(grown, dtype=np.int64)].sum(axis=1)
            own = dict(zip(grown, (evidence.of(grown, one_sided) + odds).tolist(), strict=True))
            scores |= {(each, *widths): score for each, score in own.items()}
            level = ranking.ranked(own, own.__getitem__)[:KEPT_SETS]
    best = max(scores.values())
    kept = {each: np.exp(score - best) for each, score in scores.items() if score > best + np.log(LEAST_WEIGHT)}
    total = sum(kept.values())
    order = ranking.ranked(kept, kept.__getitem__)
    return tuple(FrameChange(*each, float(kept[each] / total)) for each in order)
