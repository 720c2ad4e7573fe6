"""How a frame in a record can differ from the identified one, and how probable each difference is.

Six kinds of unknowns: factors on the story stiffnesses, factors on the damping, the uncertain masses and effects of
the identified model, the gains of the sensors, what the form of the model misses, and the levels of the noise. The
fifth is

    dK = sum over i <= j of e_ij omega_i omega_j M (phi_i phi_j' + phi_j phi_i') M / (1 + delta_ij),

with modes phi_i of the identified model: a symmetric change of the stiffness that no set of stories has. On
finite-element frames whose beams bend, a shear model that was fitted to their modes misses e_ij of 0.01 to 0.04, alike
for all i and j, and of i = j more with each mode beyond the measured ones; their standard deviation is estimated.
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
from cvxshear.model.shear import modes, stiffness_matrix
from cvxshear.response.damped import DampedModel
from cvxshear.response.uncertain import Damped, UncertainFrame, modal_matrix
from cvxshear.util.typing import Floats, Ints

AMPLITUDE_STD = 0.15
"""Relative standard deviation of one factor on all story stiffnesses: instrumented buildings soften by some 5 to 30 %
in strong shaking and mostly recover (Clinton, Bradford, Heaton and Favela 2006), bench frames by some percent."""

SCATTER_STDS = (0.0003, 0.001, 0.003, 0.01)
"""Relative standard deviations by which unchanged stories soften differently, compared by their evidence: from a frame
whose stories all are what they were, or all softened alike, to a tenth of what the whole frame does."""

DAMPING_STD = 0.5
"""Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude."""

OTHER_DAMPING_STD = 0.3
"""Standard deviation of the logarithm of each dashpot, or of Rayleigh's factors, by themselves."""

NOISE_STD = 1.0
"""Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two."""

MASS_STDS = (0.0, 0.05)
"""Relative standard deviations by which floor masses changed since the tests, compared by their evidence: not at all,
or by what is carried into a furnished floor and out of it."""

GAIN_STDS = (0.001, 0.01)
"""Relative standard deviations of what all sensors, the excitation's too, read too much, compared by their evidence:
calibrations as good as laboratories have them, and those of the field. A single one that is off by more changed by
itself, as `SensorGain` expects."""

GAIN_UNIT = 0.01
"""Relative gain that an unknown of one stands for; of a bracket, at the frequency of the `BRACKET_MODE`."""

BRACKET_MODE = 3
"""Mode, or the highest there is, at which a sensor on a bracket of its own reads as much too much as one whose gain is
off: of less in the modes that have most of a building's motion."""

EXACT_MASS = 1e-6
"""Relative standard deviation of masses below which they were declared as exact."""

SAME_MASSES = 1e-3
"""Smallest standard deviation of a pattern of floor masses, relative to the largest, that is not rounding of one that
is exact, as the total may be."""

FORM_STDS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
"""Standard deviations of e_ij that are compared by their evidence: from a shear frame, in which the best data would
show no error, to one whose modes have little to do with the model's."""

MODAL_STEP = 1e-3
"""Step of the unknowns by which modes are differentiated: their curvature leaves a thousandth of a derivative."""

ASSUMED_FREQUENCY_STD, ASSUMED_SHAPE_STD = 0.005, 0.02
"""Relative standard deviations of measured frequencies and shapes where none are declared: usual modal tests."""

COUPLED_MODES = 6
"""Lowest modes that an error of the model's form mixes; of higher modes it changes the frequencies alone. Six have most
of a building's motion, and more would be as many unknowns as all else together."""


@dataclass(frozen=True, eq=False)
class VariedFrame:
    """A damped frame with factors on its story stiffnesses and damping, and with matrices that may be off.

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
    log_gain : ndarray, shape (W, N + 1)
        Change of the logarithms of the gains of the floors' sensors and of the excitation.
    dbracket : ndarray, shape (W, N)
        Change of what the floors' sensors stand on, as `DampedModel.bracket`, s2.
    form : ndarray, shape (X, N, N)
        Changes of the stiffness matrix for e_ij = 1.
    gains : int
        How many of the W directions, the last ones, are brackets and gains of sensors.
    """

    centre: Damped
    story_stiffness: Floats
    ratios: Floats
    own_std: Floats
    dM: Floats
    dK: Floats
    dgain: Floats
    log_gain: Floats
    dbracket: Floats
    form: Floats
    gains: int

    @staticmethod
    def around(frame: UncertainFrame, floors: Sequence[int] | Ints = (), *, excited: bool = False) -> VariedFrame:
        """Set up the variations around the most probable values of an uncertain frame.

        Parameters
        ----------
        frame : UncertainFrame
        floors : sequence of int, optional
            That carry sensors.
        excited : bool, optional
            Whether a sensor recorded the excitation.
        """
        centre = frame.at(np.zeros(frame.size))
        if frame.kind == "modal":
            own = frame.ratios.std
        else:
            own = np.full(2 if centre.rayleigh is not None else len(centre.model.M), OTHER_DAMPING_STD)
        base = frame.undamped(frame.fitted.theta)
        moved = [frame.undamped(frame.fitted.theta + column) for column in frame.nuisance_root().T]
        shape = (len(moved), *base.M.shape)
        dM, dK, dgain = (
            np.array([getattr(each, name) - getattr(base, name) for each in moved]).reshape(shape[: 1 + at.ndim])
            for name, at in (("M", base.M), ("K", base.K), ("gain", base.gain))
        )
        measured = max(int(each.modes.max()) for each in frame.fitted.experiment.configurations)
        form = _form(centre.model, measured)
        # A larger motion than the sensor of the excitation shows, and as much smaller gains, are the same: so that
        # they are along a straight line, gains count by their logarithms.
        at = [int(floor) - 1 for floor in floors]
        sensors = GAIN_UNIT * np.eye(len(base.M) + 1)[[*at, *([-1] if excited else [])]]
        squares = centre.model.modes.eigenvalues
        brackets = GAIN_UNIT / squares[min(BRACKET_MODE, len(squares)) - 1] * np.eye(len(base.M))[at]
        gains = len(brackets) + len(sensors)
        dM, dK, dgain = (np.concatenate([each, np.zeros((gains, *each.shape[1:]))]) for each in (dM, dK, dgain))
        log_gain, dbracket = np.zeros((len(dM), len(base.M) + 1)), np.zeros_like(dgain)
        log_gain[len(dM) - len(sensors) :] = sensors
        dbracket[len(moved) : len(moved) + len(brackets)] = brackets
        return VariedFrame(
            centre, frame.story_stiffness, frame.ratios.values, own, dM, dK, dgain, log_gain, dbracket, form, gains
        )

    @cached_property
    def period(self) -> float:
        """Period of the identified frame's first mode, s."""
        return 1.0 / float(self.centre.model.modes.frequencies[0])

    def first_samples(self, step: float) -> int:
        """Count the samples of the first period of a run that was sampled every `step` seconds."""
        return max(2, round(self.period / step))

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of story factors, damping factors, directions of masses and effects, and errors of the form."""
        return len(self.story_stiffness), len(self.own_std), len(self.dM), len(self.form)

    @property
    def nuisance_share(self) -> Floats:
        """Relative change of masses and modal stiffnesses along each direction, shape (W,); infinite of gains."""
        own = self.centre.model.modes
        masses = np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M)
        stiffness = np.sum((own.shapes @ self.dK) * own.shapes, axis=2) / own.eigenvalues
        square: Floats = np.mean(masses**2, axis=1) + np.mean(stiffness**2, axis=1)
        share = np.asarray(np.sqrt(np.maximum(square, 1e-8)), dtype=np.float64)
        share[len(share) - self.gains :] = np.inf
        return share

    @property
    def sensor_gains(self) -> slice:
        """Which unknowns are the sensors': what each stands on, the gain of each, then that of the excitation's."""
        N, D, W, _ = self.sizes
        return slice(N + D + W - self.gains, N + D + W)

    def story_factors(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return each story's stiffness over the identified one, and its derivatives by the unknowns.

        Story i resists a unit displacement of the floors i to N, as one, by the sum of K over those floors.

        Parameters
        ----------
        unknowns : ndarray, shape (N + D + W + X,)

        Returns
        -------
        factors : ndarray, shape (N,)
        J : ndarray, shape (N, N + D + W + X)
        """
        N, D, W, X = self.sizes
        own = np.exp(unknowns[:N])
        nuisance, missed = np.split(unknowns[N + D :], [W])
        tested = 1.0 + self._shares(self.dK) @ nuisance
        heavier, forms = 1.0 + self._heavier @ nuisance, self._shares(self.form)
        J = np.zeros((N, N + D + W + X))
        J[:, :N] = np.diag(tested * own)
        J[:, N + D : N + D + W] = own[:, None] * self._shares(self.dK) + np.outer(forms @ missed, self._heavier)
        J[:, N + D + W :] = heavier * forms
        return tested * own + heavier * (forms @ missed), J

    def _shares(self, changes: Floats) -> Floats:
        """Return what changes of the stiffness matrix are of each story's stiffness, shape (N, changes)."""
        above = np.cumsum(np.cumsum(changes[:, ::-1, ::-1], axis=1), axis=2)[:, ::-1, ::-1]
        result: Floats = np.diagonal(above, axis1=1, axis2=2).T / self.story_stiffness[:, None]
        return result

    @cached_property
    def _heavier(self) -> Floats:
        """Relative change of the masses, on average, along each of their directions, shape (W,)."""
        result: Floats = np.mean(np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M), axis=1)
        return result

    @cached_property
    def heavier_floors(self) -> Floats:
        """Changes of the unknowns by which each floor alone weighs twice as much, shape (N + D + W + X, N).

        The directions of the masses move the stiffnesses as they were identified together; stories take that back.
        Where the total is exact, the others weigh less by as much, which base motion does not tell from that. Without
        columns where all floors are exact.
        """
        N, D, W, _ = self.sizes
        result = np.zeros((sum(self.sizes), N))
        share = np.diagonal(self.dM, axis1=1, axis2=2).reshape(W, N) / np.diag(self.centre.model.M)
        if np.max(np.abs(share), initial=0.0) < EXACT_MASS:
            return result[:, :0]
        result[N + D : N + D + W] = np.linalg.pinv(share.T, rcond=SAME_MASSES)
        result[:N] = -self.story_factors(np.zeros(len(result)))[1] @ result
        return result

    def model(self, unknowns: Floats) -> DampedModel:
        """Build the frame of given unknowns: logarithms, logarithms, standard deviations, and e_ij.

        Factors, errors of the form and dashpots are of the frame as heavy as it is: with twice the masses and
        stiffnesses they are the same, which base motion does not tell.

        Raises
        ------
        NoModesError
            Where it has no modes.
        """
        stiffness, damping, nuisance, missed = np.split(unknowns, np.cumsum(self.sizes)[:3])
        old = self.centre.model
        M = old.M + np.tensordot(nuisance, self.dM, axes=1)
        heavier = 1.0 + self._heavier @ nuisance
        K = old.K + np.tensordot(nuisance, self.dK, axes=1) + heavier * np.tensordot(missed, self.form, axes=1)
        tested = self.story_stiffness * (1.0 + self._shares(self.dK) @ nuisance)
        K = K + stiffness_matrix(tested * np.expm1(stiffness))
        scale, own = np.exp(damping), modes(M, K)
        if self.centre.dashpots is not None:
            C = heavier * stiffness_matrix(self.centre.dashpots.values * scale)
        elif self.centre.rayleigh is not None:
            a, b = self.centre.rayleigh * scale
            C = a * M + b * K
        else:
            C = modal_matrix(M, own, self.ratios * scale)
        *floors, excitation = np.exp(nuisance @ self.log_gain)
        gain = (old.gain + nuisance @ self.dgain) * floors
        bracket = nuisance @ self.dbracket
        return DampedModel(M, C, K, gain, old.heights, old.mass_known, float(excitation), bracket)


def _form(model: DampedModel, measured: int) -> Floats:
    """Build the matrices that e_ij multiply, shape (X, N, N); those of modes beyond the measured ones are larger."""
    own = model.modes
    # M phi_i omega_i, a row a mode.
    rows = (own.shapes * np.sqrt(own.eigenvalues)[:, None]) @ model.M
    coupled = np.triu_indices(min(len(rows), COUPLED_MODES), k=1)
    pairs = [(i, i) for i in range(len(rows))] + list(zip(*coupled, strict=True))
    single = np.array([np.outer(rows[i], rows[j]) for i, j in pairs])
    mirrored: Floats = single + single.swapaxes(1, 2)
    beyond = np.maximum(np.arange(1, len(rows) + 1) - measured, 0)
    mirrored[: len(rows)] *= (1 + beyond)[:, None, None] / 2
    return mirrored


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
    own_damping : ndarray, shape (D,)
    sizes : tuple of int
        N, D, W and X.
    nuisance_share : ndarray, shape (W,)
        Relative change of the frame along each direction of masses and effects.
    heavier_floors : ndarray, shape (N + D + W + X, N) or (N + D + W + X, 0)
        Of the unknowns, where one floor weighs twice as much.
    sensor_gains : slice
        Which unknowns are gains of sensors.
    others : int
        Number of noise levels.
    measured : ModalRows
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
            varied.nuisance_share, varied.heavier_floors, varied.sensor_gains, others, ModalRows.around(frame, varied),
        )  # fmt: skip

    @property
    def single(self) -> Ints:
        """Unknowns that may have changed by themselves: of every story, then of every gain, shape (N + G,)."""
        gains = np.arange(self.sensor_gains.start, self.sensor_gains.stop if len(self.gain_stds) > 1 else 0)
        return np.concatenate([np.arange(self.sizes[0]), gains])

    @property
    def single_std(self) -> Floats:
        """Standard deviation of each of them where it did, shape (N + G,)."""
        return np.where(np.arange(len(self.single)) < self.sizes[0], self.change_std, self.gain_std / GAIN_UNIT)

    @property
    def log_odds(self) -> Floats:
        """Logarithm of the odds that each of them did, shape (N + G,)."""
        p = np.where(np.arange(len(self.single)) < self.sizes[0], self.probability, self.gain_probability)
        return np.asarray(np.log(p) - np.log1p(-p), dtype=np.float64)

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
            N, D, frame = self.sizes[0], self.sizes[1], sum(self.sizes)
            covariance[:N, :N] += AMPLITUDE_STD**2 + scatter_std**2 * np.eye(N)
            covariance[N : N + D, N : N + D] += DAMPING_STD**2
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
        damping, noise = np.diag(self.own_damping**2), NOISE_STD**2 * np.eye(self.others)
        whole = linalg.block_diag(self.identified, damping, rest, noise)
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
    return effect.size or effect.usual, 1.0 - (1.0 - effect.probability) ** (1.0 / max(places, 1))
