"""Possible differences of a frame in a record from the identified frame, and their prior.

There are seven kinds of unknowns: factors on the story stiffnesses, factors on the damping, a dashpot in each story,
the uncertain masses and effects of the identified model, the gains of the sensors, the errors of the model's form, and
the levels of the noise. The errors of form are

    dK = sum over i <= j of e_ij omega_i omega_j M (phi_i phi_j' + phi_j phi_i') M / (1 + delta_ij),

with modes phi_i of the identified model. This is a symmetric change of the stiffness that story stiffnesses cannot
represent. Shear models fitted to the modes of finite-element frames with bending beams have e_ij of 0.01 to 0.04, of
similar size for all i and j. For i = j, the errors grow with each mode beyond the measured ones.

The unknowns have a Gaussian prior, conditioned on the measured modes. A change of a story, a dashpot, a gain or the
floor masses widens it along some columns. The likelihood of a record is linearized once, and one formula gives the
evidence of each set of changes, with each standard deviation of e_ij.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.data.kinds import frequency_residual, scaled
from cvxshear.effects import Effect
from cvxshear.effects.readings import SensorGain
from cvxshear.effects.stories import StoryChange
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model import Modes, modes, stiffness_matrix
from cvxshear.response.damping import DampedModel
from cvxshear.response.uncertain import Damped, UncertainFrame, modal_matrix
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.odds import weigh
from cvxshear.util.typing import Bools, Floats, Ints

OTHER_DAMPING_STD = 0.3
"""Standard deviation of the logarithm of each dashpot and of each Rayleigh factor, and of the change of each mode's
ratio since the tests."""

LEFT_BESIDE = 0.1
"""Remaining share of a mode's measured damping ratio beside a dashpot that accounts for the whole ratio."""

GAIN_STDS = (0.001, 0.01)
"""Relative standard deviations of the gains of all sensors: laboratory and field calibrations, equally probable. A
larger error of one sensor is a change with the prior of `SensorGain`."""

SAME_MASSES = 1e-3
"""Smallest standard deviation of a pattern of floor masses, relative to the largest; smaller ones are rounding."""

COUPLED_MODES = 6
"""Number of lowest modes that an error of form couples. Six modes have most of a building's motion. An error of form
changes only the frequencies of higher modes."""

AMPLITUDE_STD = 0.15
"""Relative standard deviation of one factor on all story stiffnesses: instrumented buildings soften by some 5 to 30 %
in strong shaking and mostly recover (Clinton, Bradford, Heaton and Favela 2006), bench frames by some percent."""

SCATTER_STD = 0.003
"""Relative standard deviation of the factors of unchanged stories: some hundredths of the softening of the frame."""

DAMPING_STD = 0.5
"""Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude."""

UNDECLARED_PROBABILITY = 0.1
"""Probability of an undeclared dashpot in some story, and of other floor masses than in the tests: most owners declare
their dampers and loads."""

NO_DASHPOT_STD = 1e-3
"""Standard deviation of an absent dashpot, in units of the deviation of a present one: the dashpot that gives a mode
its measured ratio without other damping."""

NOISE_STD = 1.0
"""Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two."""

MASS_STD = 0.05
"""Relative standard deviation of the floor masses if they changed since the tests: furniture, people, stored goods."""

FORM_STDS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
"""Standard deviations of e_ij, compared by their evidence: from an exact shear frame to a frame with other modes than
the model's."""

DIFFERENCE = 1e-5
"""Step of finite differences of small matrices: rounding and curvature both give relative errors of 1e-5."""

LEAST_WEIGHT = 1e-3
"""Minimum probability of an answer in the average, relative to the most probable answer."""

MOST_CHANGES, KEPT_SETS = 3, 6
"""Maximum number of changes in a set, and number of sets of each size that are extended."""


@dataclass(frozen=True, eq=False)
class VariedFrame:
    """A damped frame with factors on its story stiffnesses and damping, and with possible errors of its matrices.

    Parameters
    ----------
    story_stiffness : ndarray, shape (N,)
        N/m.
    ratios : ndarray, shape (N,)
        Damping ratios of the modes, for modal damping.
    own_std : ndarray, shape (D,)
        Standard deviation of the logarithm of each damping factor.
    dM, dK : ndarray, shape (W, N, N)
        Change of the matrices along each direction of the uncertainty of masses and effects, one standard deviation.
    dgain : ndarray, shape (W, N)
    log_gain : ndarray, shape (W, N + 1)
        Change of the logarithms of the gains of the floors' sensors and of the excitation.
    form : ndarray, shape (X, N, N)
        Changes of the stiffness matrix for e_ij = 1.
    gains : int
        Number of gains of sensors; these are the last of the W directions.
    measured : ndarray of bool, shape (N,)
        Mask of the measured ratios.
    dashpot : ndarray, shape (N,) or (0,)
        Dashpot of each story for an unknown of one, N s/m; the dashpots are the last of the D damping unknowns.
    """

    centre: Damped
    story_stiffness: Floats
    ratios: Floats
    own_std: Floats
    dM: Floats
    dK: Floats
    dgain: Floats
    log_gain: Floats
    form: Floats
    gains: int
    measured: Bools
    dashpot: Floats

    @staticmethod
    def around(frame: UncertainFrame, floors: Sequence[int] | Ints = ()) -> VariedFrame:
        """Set up the variations around the most probable values; sensors are on `floors` and on the excitation."""
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
        # A larger excitation with smaller gains gives the same record. Logarithms of the gains make these
        # combinations a straight line.
        at = [int(floor) - 1 for floor in floors]
        sensors = np.eye(len(base.M) + 1)[[*at, -1]]
        gains = len(sensors)
        dM, dK, dgain = (np.concatenate([each, np.zeros((gains, *each.shape[1:]))]) for each in (dM, dK, dgain))
        log_gain = np.zeros((len(dM), len(base.M) + 1))
        log_gain[len(moved) :] = sensors
        dashpot = _dashpots(centre.model, frame.ratios.values, frame.ratios.measured)
        return VariedFrame(
            centre, frame.story_stiffness, frame.ratios.values, own, dM, dK, dgain, log_gain, form, gains,
            frame.ratios.measured, dashpot,
        )  # fmt: skip

    @cached_property
    def period(self) -> float:
        """Period of the identified frame's first mode, s."""
        return 1.0 / float(self.centre.model.modes.frequencies[0])

    def first_samples(self, step: float) -> int:
        """Count the samples of the first period of a run that was sampled every `step` seconds."""
        return max(2, round(self.period / step))

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of stories, damping unknowns, directions of masses and effects, and errors of the form."""
        return len(self.story_stiffness), len(self.own_std) + len(self.dashpot), len(self.dM), len(self.form)

    @property
    def nuisance_share(self) -> Floats:
        """Relative change of masses and modal stiffnesses along each direction, shape (W,); infinite for gains."""
        own = self.centre.model.modes
        masses = np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M)
        stiffness = np.sum((own.shapes @ self.dK) * own.shapes, axis=2) / own.eigenvalues
        square: Floats = np.mean(masses**2, axis=1) + np.mean(stiffness**2, axis=1)
        share = np.asarray(np.sqrt(np.maximum(square, 1e-8)), dtype=np.float64)
        share[len(share) - self.gains :] = np.inf
        return share

    @property
    def dashpots(self) -> slice:
        """Slice of the dashpots of single stories."""
        N, D, _, _ = self.sizes
        return slice(N + D - len(self.dashpot), N + D)

    @property
    def sensor_gains(self) -> slice:
        """Slice of the gains: the floors' sensors, then the excitation's sensor."""
        N, D, W, _ = self.sizes
        return slice(N + D + W - self.gains, N + D + W)

    def story_factors(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return the ratio of each story's stiffness to the identified one, and its derivatives by the unknowns.

        A unit displacement of all floors i to N together has the resistance of story i: the sum of K over these floors.
        """
        N, D, W, X = self.sizes
        own = np.exp(unknowns[:N])
        nuisance, missed = np.split(unknowns[N + D :], [W])
        tested = 1.0 + self._tested_shares @ nuisance
        heavier, forms = 1.0 + self._heavier @ nuisance, self._shares(self.form)
        J = np.zeros((N, N + D + W + X))
        J[:, :N] = np.diag(tested * own)
        J[:, N + D : N + D + W] = own[:, None] * self._tested_shares + np.outer(forms @ missed, self._heavier)
        J[:, N + D + W :] = heavier * forms
        return tested * own + heavier * (forms @ missed), J

    def _shares(self, changes: Floats) -> Floats:
        """Return the relative change of each story's stiffness by changes of the stiffness matrix, (N, changes)."""
        above = np.cumsum(np.cumsum(changes[:, ::-1, ::-1], axis=1), axis=2)[:, ::-1, ::-1]
        result: Floats = np.diagonal(above, axis1=1, axis2=2).T / self.story_stiffness[:, None]
        return result

    @cached_property
    def _tested_shares(self) -> Floats:
        return self._shares(self.dK)

    @cached_property
    def _heavier(self) -> Floats:
        """Mean relative change of the masses along each of their directions, shape (W,)."""
        result: Floats = np.mean(np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M), axis=1)
        return result

    @cached_property
    def heavier_floors(self) -> Floats:
        """Changes of the unknowns that double the mass of one floor only, shape (N + D + W + X, N).

        The directions of the masses also change the stiffnesses, as identified; the story factors cancel this change.
        If the total mass is exact, the other floors become lighter; base motion cannot distinguish both cases. The
        array has no columns if all masses are exact.
        """
        N, D, W, _ = self.sizes
        result = np.zeros((sum(self.sizes), N))
        share = np.diagonal(self.dM, axis1=1, axis2=2).reshape(W, N) / np.diag(self.centre.model.M)
        if np.max(np.abs(share), initial=0.0) < SAME_MASSES * SAME_MASSES:
            return result[:, :0]
        result[N + D : N + D + W] = np.linalg.pinv(share.T, rcond=SAME_MASSES)
        result[:N] = -self.story_factors(np.zeros(len(result)))[1] @ result
        return result

    def model(self, unknowns: Floats) -> DampedModel:
        """Build the frame for given unknowns: logarithms, logarithms and dashpots, standard deviations, and e_ij.

        A dashpot was present in the tests as well. So a measured ratio of a mode is reduced by the dashpot's part: if
        the dashpot alone would give s times the ratio, the part f(s) remains, which is nearly 1 - s and positive.

        Factors, errors of form and dashpots are relative to the frame's mass: they stay the same if all masses and
        stiffnesses double, which base motion does not determine.

        Raises
        ------
        NoModesError
            If the frame has no modes.
        """
        stiffness, damping, nuisance, missed = np.split(unknowns, np.cumsum(self.sizes)[:3])
        old = self.centre.model
        heavier = 1.0 + self._heavier @ nuisance
        # np.tensordot would take longer to set up than everything else.
        dM, dK, form = (
            (factors @ each.reshape(len(each), old.M.size)).reshape(old.M.shape)
            for factors, each in ((nuisance, self.dM), (nuisance, self.dK), (missed, self.form))
        )
        M, K = old.M + dM, old.K + dK + heavier * form
        tested = self.story_stiffness * (1.0 + self._tested_shares @ nuisance)
        K = K + stiffness_matrix(tested * np.expm1(stiffness))
        damping, dashpots = np.split(damping, [len(self.own_std)])
        scale, own = np.exp(damping), modes(M, K)
        single = heavier * self.dashpot * dashpots if np.any(dashpots) else np.zeros(len(M))
        if self.centre.dashpots is not None:
            C = heavier * stiffness_matrix(self.centre.dashpots.values * scale)
        elif self.centre.rayleigh is not None:
            a, b = self.centre.rayleigh * scale
            C = a * M + b * K
        else:
            ratios = self.ratios * scale
            share = np.where(self.measured, _given(own, single) / ratios, 0.0)
            C = modal_matrix(M, own, ratios * _beside(share))
        C = C + stiffness_matrix(single)
        *floors, excitation = np.exp(nuisance @ self.log_gain)
        gain = (old.gain + nuisance @ self.dgain) * floors
        return DampedModel(M, C, K, gain, old.heights, old.mass_known, float(excitation))


def _dashpots(model: DampedModel, ratios: Floats, measured: Bools) -> Floats:
    """Compute the dashpot of each story that alone gives one measured mode its ratio, shape (N,), N s/m."""
    given = np.array([_given(model.modes, each) for each in np.eye(len(ratios))])
    result: Floats = 1.0 / np.max(given[:, measured] / ratios[measured], axis=1)
    return result


def _given(real: Modes, dashpots: Floats) -> Floats:
    """Compute the damping ratio of each mode from story dashpots, shape (N,)."""
    drifts = np.diff(real.shapes, axis=1, prepend=0.0)
    result: Floats = drifts**2 @ dashpots / (2 * np.sqrt(real.eigenvalues))
    return result


def _beside(share: Floats) -> Floats:
    """Compute f(s), the positive root of f^2 = (1 - s) f + b^2 s; f(1) = b."""
    half = 0.5 * (1.0 - share)
    result: Floats = half + np.sqrt(half**2 + LEFT_BESIDE**2 * share)
    return result


def _form(model: DampedModel, measured: int) -> Floats:
    """Build the factors of e_ij, matrices of shape (X, N, N); they are larger for modes beyond the measured ones."""
    own = model.modes
    # M phi_i omega_i, one row per mode.
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
            parts = [_standardized(each, model, each.added_mass - frame.configuration.added_mass) for each in tests]
            return np.concatenate([np.zeros(0), *parts])

        centre = described(np.zeros(N + W + X))
        if not len(centre) or not frame.uncertain:
            return ModalRows(np.zeros((0, N + W + X)), np.zeros(0))
        J = np.array([(described(DIFFERENCE * row) - centre) / DIFFERENCE for row in np.eye(N + W + X)]).T
        # The sensors of the tests had other gains.
        J[:, N + W - varied.gains : N + W] = 0.0
        return ModalRows(-J, centre)


def _standardized(test: Configuration, model: DampedModel, added: Floats) -> Floats:
    """Compute measured minus modeled frequencies and shape entries of one test, in standard deviations."""
    own = modes(model.M + np.diag(added), model.K)
    at, weights = test.modes - 1, test.entry_weights
    entries = (own.shapes[at] * model.gain)[:, test.measured_floors - 1]
    measured = np.nan_to_num(test.mode_shapes)
    left = weights * (measured - scaled(measured, entries, weights)[0][:, None] * entries)
    logs = np.log(2 * np.pi * test.frequencies)
    correlation = test.frequency_correlation
    above, _ = frequency_residual(logs, own.eigenvalues[at], test.log_frequency_std, correlation=correlation)
    return np.append(-above, left[weights > 0])


@dataclass(frozen=True, eq=False)
class FrameChange:
    """A change since the tests that the frame, its masses or a sensor may have.

    Parameters
    ----------
    kind : str
        "story", "dashpot", "gain", or "gains" or "masses" for all together.
    place : int
        Story or sensor, from 0.
    columns : ndarray, shape (P, k)
        Changes of the unknowns, one standard deviation each.
    log_odds : float
        Prior log odds.
    """

    kind: str
    place: int
    columns: Floats
    log_odds: float


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Mean and covariance of the unknowns, and the log evidence of the measured modes without a constant."""

    mean: Floats
    covariance: Floats
    evidence: float


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
    measured : ModalRows
    changes : tuple of FrameChange
        Possible changes.
    """

    varied: VariedFrame
    others: int
    identified: Floats
    measured: ModalRows
    changes: tuple[FrameChange, ...]

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame, others: int) -> FramePrior:
        """Set up the prior from the identified frame, and from the changes that the file or the catalogue expects."""
        experiment, unit = frame.fitted.experiment, np.eye(sum(varied.sizes) + others)
        story, changed = _expected(StoryChange(), experiment, experiment.stories)
        gain, off = _expected(SensorGain(), experiment, varied.gains)
        damped = _at_each(UNDECLARED_PROBABILITY, experiment.stories)
        changes = [
            FrameChange(kind, place, std * unit[:, [at]], float(np.log(p / (1.0 - p))))
            for kind, places, std, p in (
                ("story", range(experiment.stories), story, changed),
                ("dashpot", _range(varied.dashpots), 1.0, damped),
                ("gain", _range(varied.sensor_gains), gain, off),
            )
            for place, at in enumerate(places)
        ]
        laboratory, field = GAIN_STDS
        changes.append(FrameChange("gains", 0, np.sqrt(field**2 - laboratory**2) * unit[:, varied.sensor_gains], 0.0))
        if varied.heavier_floors.shape[1]:
            heavier = np.zeros((len(unit), experiment.stories))
            heavier[: -others or None] = MASS_STD * varied.heavier_floors
            odds = float(np.log(UNDECLARED_PROBABILITY / (1.0 - UNDECLARED_PROBABILITY)))
            changes.append(FrameChange("masses", 0, heavier, odds))
        rows = ModalRows.around(frame, varied)
        return FramePrior(varied, others, frame.conditional_stiffness(), rows, tuple(changes))

    @property
    def widest(self) -> Gaussian:
        """Prior with all changes and with the largest standard deviation of the errors of form."""
        return self.gaussian(range(len(self.changes)), FORM_STDS[-1])

    def gaussian(self, changed: Sequence[int], form_std: float) -> Gaussian:
        """Return the prior of an `FrameAnswer`."""
        if form_std not in self._by_modes:
            self._by_modes[form_std] = self._given_modes(form_std)
        by_modes = self._by_modes[form_std]
        covariance = by_modes.covariance.copy()
        N = self.varied.sizes[0]
        ratios = slice(N, self.varied.dashpots.start)
        covariance[:N, :N] += AMPLITUDE_STD**2 + SCATTER_STD**2 * np.eye(N)
        covariance[ratios, ratios] += DAMPING_STD**2 + OTHER_DAMPING_STD**2 * np.eye(len(self.varied.own_std))
        for each in changed:
            covariance += self.changes[each].columns @ self.changes[each].columns.T
        return Gaussian(by_modes.mean, covariance, by_modes.evidence)

    @cached_property
    def _by_modes(self) -> dict[float, Gaussian]:
        """Results of `_given_modes` by their argument; many answers share each."""
        return {}

    def _given_modes(self, form_std: float) -> Gaussian:
        """Return the prior of a record without changes of stories, masses and damping since the tests."""
        N, D, W, X = self.varied.sizes
        # The errors of form limit the accuracy of masses and effects from modes.
        share = self.varied.nuisance_share
        modal = np.isfinite(share)
        nuisances = 1.0 + (form_std / share) ** 2 / max(int(modal.sum()), 1)
        nuisances[~modal] = GAIN_STDS[0] ** 2
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


def _range(at: slice) -> range:
    return range(at.start, at.stop)


def _expected(effect: Effect, experiment: Experiment, places: int) -> tuple[float, float]:
    """Return the size of an effect, and its probability at each place, from the file or else from the catalogue."""
    for said in experiment.expected:
        if said.name == effect.name and said.story is None and said.floor is None:
            effect = effect.expecting(size=said.size, probability=said.probability)
    return effect.size or effect.usual, _at_each(effect.probability, places)


def _at_each(probability: float, places: int) -> float:
    """Compute the probability at each of several places from the probability at any of them."""
    return float(1.0 - (1.0 - probability) ** (1.0 / max(places, 1)))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The linearized likelihood at one point: -2 log L = |U d + c|^2 + constant for a step d.

    Parameters
    ----------
    U, c : ndarray, shapes (r, P) and (r,)
    inflation : float
        Scatter of the summed scores, relative to white innovations; at least 1.
    """

    U: Floats
    c: Floats
    inflation: float


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

    def evidences(self, changes: Sequence[FrameChange], sets: Sequence[tuple[int, ...]]) -> list[float]:
        """Return the log evidence, without a constant, of the prior with each set of changes.

        A dashpot is positive: a set with a negative one has no evidence.
        """
        half = np.asarray(np.linalg.cholesky(self.seen))
        columns = [np.linalg.solve(half, self.U @ each.columns) for each in changes]
        data = np.linalg.solve(half, self.data)
        plain = self.prior.evidence - 0.5 * float(data @ data) - float(np.sum(np.log(half.diagonal())))
        found = []
        for chosen in sets:
            moved = np.hstack([np.zeros((len(data), 0)), *(columns[each] for each in chosen)])
            positive = [changes[each].kind == "dashpot" for each in chosen for _ in columns[each].T]
            wider, slope = np.eye(moved.shape[1]) + moved.T @ moved, moved.T @ data
            within = np.linalg.solve(wider, slope)
            gain = 0.5 * (float(slope @ within) - float(np.linalg.slogdet(wider)[1]))
            found.append(-np.inf if np.any(within[positive] < 0) else plain + gain)
        return found

    def posterior(self) -> tuple[Floats, Floats]:
        """Compute mean and covariance of the unknowns."""
        spread = self.U @ self.covariance
        gain = np.linalg.solve(self.seen, spread).T
        return self.prior.mean + gain @ self.data, self.covariance - gain @ spread


@dataclass(frozen=True, eq=False)
class FrameAnswer:
    """One possible way in which the frame differs from the identified one.

    Parameters
    ----------
    changed : tuple of int
        Places in `FramePrior.changes`.
    form_std : float
        Standard deviation of the errors of the model's form.
    """

    changed: tuple[int, ...]
    form_std: float
    probability: float

    @property
    def prior(self) -> tuple[tuple[int, ...], float]:
        """Arguments of `FramePrior.gaussian`."""
        return self.changed, self.form_std


def possible_answers(at: Likelihood, prior: FramePrior, p: Floats) -> tuple[FrameAnswer, ...]:
    """List the possible sets of changes and errors of form, by the evidence of the linearized likelihood.

    Sets of each size extend the best sets of the previous size. All standard deviations of the errors of form have the
    same prior probability.
    """
    scores: dict[tuple[tuple[int, ...], float], float] = {}
    for form_std in FORM_STDS:
        linear = Linear(at, p, prior.gaussian((), form_std))
        level: list[tuple[int, ...]] = [()]
        for _ in range(MOST_CHANGES + 1):
            odds = [sum(prior.changes[each].log_odds for each in chosen) for chosen in level]
            evidences = linear.evidences(prior.changes, level)
            own = {chosen: one + other for chosen, one, other in zip(level, odds, evidences, strict=True)}
            scores |= {(chosen, form_std): score for chosen, score in own.items()}
            kept = ranking.ranked(own, own.__getitem__)[:KEPT_SETS]
            pairs = itertools.product(kept, range(len(prior.changes)))
            level = sorted({tuple(sorted({*base, other})) for base, other in pairs if other not in base})
    order = ranking.ranked(scores, scores.__getitem__)
    probable = [each for each in order if scores[each] > scores[order[0]] + np.log(LEAST_WEIGHT)]
    weights = weigh([scores[each] for each in probable])
    return tuple(FrameAnswer(*each, float(weight)) for each, weight in zip(probable, weights, strict=True))
