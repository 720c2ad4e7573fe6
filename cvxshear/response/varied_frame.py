"""How a frame in a record can differ from the identified one, and how probable each difference is.

Seven kinds of unknowns: factors on the story stiffnesses, factors on the damping, a dashpot in each story, the
uncertain masses and effects of the identified model, the gains of the sensors, what the form of the model misses, and
the levels of the noise. The sixth is

    dK = sum over i <= j of e_ij omega_i omega_j M (phi_i phi_j' + phi_j phi_i') M / (1 + delta_ij),

with modes phi_i of the identified model: a symmetric change of the stiffness that no set of stories has. On
finite-element frames whose beams bend, a shear model that was fitted to their modes misses e_ij of 0.01 to 0.04, alike
for all i and j, and of i = j more with each mode beyond the measured ones; their standard deviation is estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.model.shear import Modes, modes, stiffness_matrix
from cvxshear.response.damped import DampedModel
from cvxshear.response.uncertain import Damped, UncertainFrame, modal_matrix
from cvxshear.util.cached import cached_property
from cvxshear.util.typing import Bools, Floats, Ints

OTHER_DAMPING_STD = 0.3
"""Standard deviation of the logarithm of each dashpot and of each Rayleigh factor, and of the change of each mode's
ratio since the tests."""

LEFT_BESIDE = 0.1
"""Remaining share of a mode's measured damping ratio beside a dashpot that accounts for the whole ratio."""

GAIN_UNIT = 0.01
"""Relative gain error of a sensor for an unknown of one."""

EXACT_MASS = 1e-6
"""Masses with a smaller relative standard deviation count as exact."""

SAME_MASSES = 1e-3
"""Smallest standard deviation of a pattern of floor masses, relative to the largest; smaller ones are rounding."""

COUPLED_MODES = 6
"""Number of lowest modes that an error of form couples. Six modes have most of a building's motion. An error of form
changes only the frequencies of higher modes."""


@dataclass(frozen=True, eq=False)
class VariedFrame:
    """A damped frame with factors on its story stiffnesses and damping, and with matrices that may be off.

    Parameters
    ----------
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
    form : ndarray, shape (X, N, N)
        Changes of the stiffness matrix for e_ij = 1.
    gains : int
        How many of the W directions, the last ones, are gains of sensors.
    measured : ndarray of bool, shape (N,)
        Which of the ratios were measured.
    dashpot : ndarray, shape (N,) or (0,)
        Dashpot of each story that an unknown of one stands for, N s/m; of the D damping unknowns they are the last.
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
    def around(frame: UncertainFrame, floors: Sequence[int] | Ints = (), *, excited: bool = False) -> VariedFrame:
        """Set up the variations around the most probable values, with sensors on some floors and of the excitation."""
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
        """Relative change of masses and modal stiffnesses along each direction, shape (W,); infinite of gains."""
        own = self.centre.model.modes
        masses = np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M)
        stiffness = np.sum((own.shapes @ self.dK) * own.shapes, axis=2) / own.eigenvalues
        square: Floats = np.mean(masses**2, axis=1) + np.mean(stiffness**2, axis=1)
        share = np.asarray(np.sqrt(np.maximum(square, 1e-8)), dtype=np.float64)
        share[len(share) - self.gains :] = np.inf
        return share

    @property
    def dashpots(self) -> slice:
        """Which unknowns are dashpots of single stories."""
        N, D, _, _ = self.sizes
        return slice(N + D - len(self.dashpot), N + D)

    @property
    def sensor_gains(self) -> slice:
        """Slice of the gains: the floors' sensors, then the excitation's sensor."""
        N, D, W, _ = self.sizes
        return slice(N + D + W - self.gains, N + D + W)

    def story_factors(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return each story's stiffness over the identified one, and its derivatives by the unknowns.

        Story i resists a unit displacement of the floors i to N, as one, by the sum of K over those floors.
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
        """Return what changes of the stiffness matrix are of each story's stiffness, shape (N, changes)."""
        above = np.cumsum(np.cumsum(changes[:, ::-1, ::-1], axis=1), axis=2)[:, ::-1, ::-1]
        result: Floats = np.diagonal(above, axis1=1, axis2=2).T / self.story_stiffness[:, None]
        return result

    @cached_property
    def _tested_shares(self) -> Floats:
        return self._shares(self.dK)

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
        """Build the frame of given unknowns: logarithms, logarithms and dashpots, standard deviations, and e_ij.

        A dashpot was there in the tests as well. So what it gives a mode is taken from a ratio that was measured: the
        part f(s) stays beside a dashpot that alone would give s times of it, nearly 1 - s and never nothing.

        Factors, errors of the form and dashpots are of the frame as heavy as it is: with twice the masses and
        stiffnesses they are the same, which base motion does not tell.

        Raises
        ------
        NoModesError
            Where it has no modes.
        """
        stiffness, damping, nuisance, missed = np.split(unknowns, np.cumsum(self.sizes)[:3])
        old = self.centre.model
        heavier = 1.0 + self._heavier @ nuisance
        # A tensor product takes as long to set up as all else.
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
    """Dashpot of each story that alone would give one of the measured modes its ratio, shape (N,), N s/m."""
    given = np.array([_given(model.modes, each) for each in np.eye(len(ratios))])
    result: Floats = 1.0 / np.max(given[:, measured] / ratios[measured], axis=1)
    return result


def _given(real: Modes, dashpots: Floats) -> Floats:
    """Damping ratio that story dashpots give each mode, shape (N,)."""
    drifts = np.diff(real.shapes, axis=1, prepend=0.0)
    result: Floats = drifts**2 @ dashpots / (2 * np.sqrt(real.eigenvalues))
    return result


def _beside(share: Floats) -> Floats:
    """f(s), the positive root of f^2 = (1 - s) f + b^2 s, which is b for s = 1."""
    half = 0.5 * (1.0 - share)
    result: Floats = half + np.sqrt(half**2 + LEFT_BESIDE**2 * share)
    return result


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
