"""What is known beforehand of a frame in a record: what its tests say, and how probable each change since is.

A Gaussian of the unknowns of a `VariedFrame`, with standard deviations that are compared by their evidence, conditioned
on the measured modes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from cvxshear.effects import Effect
from cvxshear.effects.readings import SensorGain
from cvxshear.effects.stories import StoryChange
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import modes
from cvxshear.response.damped import DampedModel
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.response.varied_frame import GAIN_UNIT, OTHER_DAMPING_STD, VariedFrame
from cvxshear.util.typing import Bools, Floats, Ints

AMPLITUDE_STD = 0.15
"""Relative standard deviation of one factor on all story stiffnesses: instrumented buildings soften by some 5 to 30 %
in strong shaking and mostly recover (Clinton, Bradford, Heaton and Favela 2006), bench frames by some percent."""

SCATTER_STDS = (0.0003, 0.001, 0.003, 0.01)
"""Relative standard deviations by which unchanged stories soften differently, compared by their evidence: from a frame
whose stories all are what they were, or all softened alike, to a tenth of what the whole frame does."""

DAMPING_STD = 0.5
"""Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude."""

DASHPOT_PROBABILITY = 0.1
"""Probability that a story has a dashpot of its own: owners mostly know of their dampers, and a story that yields acts
like one."""

DASHPOT_STD, NO_DASHPOT_STD = 1.0, 1e-3
"""Standard deviation of a dashpot, in units of that which alone would give a mode its measured ratio, where there is
one and where there is none."""

NOISE_STD = 1.0
"""Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two."""

MASS_STDS = (0.0, 0.05)
"""Relative standard deviations by which floor masses changed since the tests, compared by their evidence: not at all,
or by what is carried into a furnished floor and out of it."""

GAIN_STDS = (0.001, 0.01)
"""Relative standard deviations of what all sensors, the excitation's too, read too much, compared by their evidence:
calibrations as good as laboratories have them, and those of the field. A single one that is off by more changed by
itself, as `SensorGain` expects."""

FORM_STDS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
"""Standard deviations of e_ij that are compared by their evidence: from a shear frame, in which the best data would
show no error, to one whose modes have little to do with the model's."""

MODAL_STEP = 1e-3
"""Step of the unknowns by which modes are differentiated: their curvature leaves a thousandth of a derivative."""

ASSUMED_FREQUENCY_STD, ASSUMED_SHAPE_STD = 0.005, 0.02
"""Relative standard deviations of measured frequencies and shapes where none are declared: usual modal tests."""


@dataclass(frozen=True, eq=False)
class ModalRows:
    """What the measured modes say of a frame whose model may be wrong in form, linearised at the identified one.

    Parameters
    ----------
    J : ndarray, shape (d, N + W + X)
        Derivatives of frequencies and shape entries, in standard deviations, by the logarithms of the story
        stiffnesses in the tests, by masses and effects, and by e_ij.
    data : ndarray, shape (d,)
        Measured less modelled.
    """

    J: Floats
    data: Floats

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame) -> ModalRows:
        """Linearise all tests of the frame's state."""
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
        # The tests' sensors had gains of their own.
        J[:, N + W - varied.gains : N + W] = 0.0
        return ModalRows(-J, centre)


def _standardized(test: Configuration, model: DampedModel, added: Floats) -> Floats:
    """Measured less modelled frequencies and shape entries of one test, in standard deviations."""
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

    The measured modes are in it twice, in the identified stiffnesses and masses, where the form of the model counts as
    right, and for what may be wrong of the form.

    Parameters
    ----------
    identified : ndarray, shape (N, N)
        Covariance of the logarithms of the story stiffnesses as they were identified, masses and effects given.
    change_std, gain_std : float
        Of the logarithm of a changed story's factor, and of a sensor's gain that is off.
    probability, gain_probability : float
        That one story changed, and that one gain is off.
    own_damping : ndarray, shape (D - S,)
    sizes : tuple of int
        N, D, W and X.
    nuisance_share : ndarray, shape (W,)
        Relative change of the frame along each direction of masses and effects.
    heavier_floors : ndarray, shape (N + D + W + X, N) or (N + D + W + X, 0)
        Of the unknowns, where one floor weighs twice as much.
    sensor_gains, dashpots : slice
        Which unknowns are gains of sensors, and dashpots of single stories, S of them.
    others : int
        Number of noise levels.
    measured : ModalRows
    gain_stds : tuple of float, optional
    """

    identified: Floats
    change_std: float
    gain_std: float
    probability: float
    gain_probability: float
    own_damping: Floats
    sizes: tuple[int, int, int, int]
    nuisance_share: Floats
    heavier_floors: Floats
    sensor_gains: slice
    dashpots: slice
    others: int
    measured: ModalRows
    gain_stds: tuple[float, ...] = GAIN_STDS

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame, others: int) -> FramePrior:
        """Take what was identified, and what is expected of a story that changed."""
        experiment = frame.fitted.experiment
        (size, probability), (gain, off) = (
            _expected(effect, experiment, count)
            for effect, count in ((StoryChange(), experiment.stories), (SensorGain(), varied.gains))
        )
        return FramePrior(
            frame.conditional_stiffness(), size, gain, probability, off, varied.own_std, varied.sizes,
            varied.nuisance_share, varied.heavier_floors, varied.sensor_gains, varied.dashpots, others,
            ModalRows.around(frame, varied),
        )  # fmt: skip

    @property
    def single(self) -> Ints:
        """Unknowns that may have changed by themselves: of every story, dashpot, gain, shape (N + S + G,)."""
        gains = np.arange(self.sensor_gains.start, self.sensor_gains.stop if len(self.gain_stds) > 1 else 0)
        return np.concatenate([np.arange(self.sizes[0]), np.arange(self.dashpots.start, self.dashpots.stop), gains])

    def _of_single(self, story: float, dashpot: float, gain: float) -> Floats:
        counts = [self.sizes[0], self.dashpots.stop - self.dashpots.start]
        return np.repeat([story, dashpot, gain], [*counts, len(self.single) - sum(counts)])

    @property
    def single_std(self) -> Floats:
        """Standard deviation of each of them where it did, shape (N + S + G,)."""
        return self._of_single(self.change_std, DASHPOT_STD, self.gain_std / GAIN_UNIT)

    @property
    def log_odds(self) -> Floats:
        """Logarithm of the odds that each of them did, shape (N + S + G,)."""
        p = self._of_single(self.probability, _at_each(DASHPOT_PROBABILITY, self.sizes[0]), self.gain_probability)
        return np.asarray(np.log(p) - np.log1p(-p), dtype=np.float64)

    @property
    def one_sided(self) -> Bools:
        """Which of them are positive: dashpots, shape (N + S + G,)."""
        return self._of_single(0.0, 1.0, 0.0) > 0

    def idle_dashpots(self, changed: Sequence[int]) -> Ints:
        """Which unknowns are dashpots that are not there where these singles, and no others, changed."""
        every = np.arange(self.dashpots.start, self.dashpots.stop)
        return np.setdiff1d(every, self.single[list(changed)])

    @property
    def mass_stds(self) -> tuple[float, ...]:
        """What floor masses may have changed by since the tests."""
        return MASS_STDS if self.heavier_floors.shape[1] else MASS_STDS[:1]

    @property
    def widest(self) -> Gaussian:
        """The prior with everything changed by itself, and all standard deviations the largest."""
        stds = FORM_STDS[-1], SCATTER_STDS[-1], self.mass_stds[-1], self.gain_stds[-1]
        return self.gaussian(range(len(self.single)), *stds)

    @property
    def linear_alone(self) -> FramePrior:
        """The same for a record in which neither floor masses nor gains are asked for."""
        return dataclasses.replace(self, heavier_floors=self.heavier_floors[:, :0], gain_stds=self.gain_stds[:1])

    def gaussian(
        self, changed: Sequence[int], form_std: float, scatter_std: float, mass_std: float, gain_std: float, *,
        same: bool = False,
    ) -> Gaussian:  # fmt: skip
        """Return the prior with given stories and gains changed, and given standard deviations.

        Parameters
        ----------
        changed : sequence of int
            Places in `single`.
        form_std : float
            Of e_ij.
        scatter_std : float
            Of the factor of each story that did not change.
        mass_std : float
            Of the factor of each floor mass since the tests.
        gain_std : float
            Of the gain of each sensor.
        same : bool, optional
            Whether stiffnesses and damping are still those of the tests.
        """
        if (form_std, gain_std) not in self._told:
            self._told[form_std, gain_std] = self._told_by_modes(form_std, gain_std)
        told = self._told[form_std, gain_std]
        covariance = told.covariance.copy()
        if not same:
            N, ratios, frame = self.sizes[0], slice(self.sizes[0], self.dashpots.start), sum(self.sizes)
            covariance[:N, :N] += AMPLITUDE_STD**2 + scatter_std**2 * np.eye(N)
            covariance[ratios, ratios] += DAMPING_STD**2 + OTHER_DAMPING_STD**2 * np.eye(len(self.own_damping))
            at = self.single[list(changed)]
            covariance[at, at] += self.single_std[list(changed)] ** 2
            covariance[:frame, :frame] += mass_std**2 * self._heavier
        return Gaussian(told.mean, covariance, told.evidence)

    @cached_property
    def _heavier(self) -> Floats:
        """Covariance of the unknowns, each floor's mass off by itself, shape (N + D + W + X, N + D + W + X)."""
        return np.asarray(self.heavier_floors @ self.heavier_floors.T)

    @cached_property
    def _told(self) -> dict[tuple[float, float], Gaussian]:
        """What `_told_by_modes` returned, by its arguments: dozens of answers share each."""
        return {}

    def _told_by_modes(self, form_std: float, gain_std: float) -> Gaussian:
        """Return the prior of a record in which stories, masses and damping are those of the tests."""
        N, D, W, X = self.sizes
        # What modes say of masses and effects is no better than the form of the model.
        modal = np.isfinite(self.nuisance_share)
        nuisances = 1.0 + (form_std / self.nuisance_share) ** 2 / max(int(modal.sum()), 1)
        nuisances[~modal] = (gain_std / GAIN_UNIT) ** 2
        rest = np.diag(np.concatenate([nuisances, np.full(X, form_std**2)]))
        tested = linalg.block_diag(self.identified, rest)
        damping = np.diag(np.append(self.own_damping, np.full(D - len(self.own_damping), NO_DASHPOT_STD)) ** 2)
        whole = linalg.block_diag(self.identified, damping, rest, NOISE_STD**2 * np.eye(self.others))
        # The record's stiffnesses are those of the tests times factors: both move along with the measured modes.
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
    """Mean and covariance of the unknowns, and the log evidence of the measured modes but for a constant."""

    mean: Floats
    covariance: Floats
    evidence: float


def _expected(effect: Effect, experiment: Experiment, places: int) -> tuple[float, float]:
    """Size of an effect, and its probability at each of its places, as the file expects it or the catalogue does."""
    for said in experiment.expected:
        if said.name == effect.name and said.story is None and said.floor is None:
            effect = effect.expecting(size=said.size, probability=said.probability)
    return effect.size or effect.usual, _at_each(effect.probability, places)


def _at_each(probability: float, places: int) -> float:
    """Probability at each of some places of what has this one at any of them."""
    return float(1.0 - (1.0 - probability) ** (1.0 / max(places, 1)))
