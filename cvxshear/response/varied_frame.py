"""Frames that a record may be of: the identified frame with factors, dashpots, gains and errors of form.

The unknowns are factors on the story stiffnesses, factors on the damping, a dashpot in each story, the uncertain masses
and effects of the identified model, the gains of the sensors, and the errors of the model's form. These errors are

    dK = sum over i <= j of e_ij omega_i omega_j M (phi_i phi_j' + phi_j phi_i') M / (1 + delta_ij),

times the mean factor of the stories, with modes phi_i of the identified model. This is a symmetric change of the
stiffness that story stiffnesses cannot represent. Shear models fitted to the modes of finite-element frames with
bending beams have e_ij of 0.01 to 0.04, of similar size for all i and j. For i = j, the errors grow with each mode
beyond the measured ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.model import Modes, modes, stiffness_matrix
from cvxshear.response.damping import DampedModel
from cvxshear.response.uncertain import Damped, UncertainFrame, modal_matrix
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats, Ints

#: Standard deviation of the logarithm of each dashpot and of each Rayleigh factor, and of the change of each mode's
#: ratio since the tests.
OTHER_DAMPING_STD = 0.3

#: Remaining share of a mode's measured damping ratio beside a dashpot that accounts for the whole ratio.
LEFT_BESIDE = 0.1

#: Smallest standard deviation of a pattern of floor masses, relative to the largest; smaller ones are rounding.
SAME_MASSES = 1e-3

#: Number of lowest modes that an error of form couples. Six modes have most of a building's motion. An error of form
#: changes only the frequencies of higher modes.
COUPLED_MODES = 6

#: Step of finite differences of small matrices: rounding and curvature both give relative errors of 1e-5.
DIFFERENCE = 1e-5


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
        centre = frame.centre
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
        # The dashpot of each story that alone gives one measured mode its ratio.
        ratios, seen = frame.ratios.values, frame.ratios.measured
        given = np.array([_given(centre.model.modes, each) for each in np.eye(len(ratios))])
        dashpot = 1.0 / np.max(given[:, seen] / ratios[seen], axis=1)
        return VariedFrame(
            centre, frame.story_stiffness, ratios, own, dM, dK, dgain, log_gain, form, gains, seen, dashpot
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
        heavier, common = 1.0 + self._heavier @ nuisance, np.exp(np.mean(unknowns[:N]))
        forms = common * self._shares(self.form)
        J = np.zeros((N, N + D + W + X))
        J[:, :N] = np.diag(tested * own) + heavier * (forms @ missed)[:, None] / N
        J[:, N + D : N + D + W] = own[:, None] * self._tested_shares + np.outer(forms @ missed, self._heavier)
        J[:, N + D + W :] = heavier * forms
        return tested * own + heavier * (forms @ missed), J

    def _shares(self, changes: Floats) -> Floats:
        """Return the relative change of each story's stiffness by changes of the stiffness matrix, (N, changes)."""
        above = np.cumsum(np.cumsum(changes[:, ::-1, ::-1], axis=1), axis=2)[:, ::-1, ::-1]
        return np.asarray(np.diagonal(above, axis1=1, axis2=2).T / self.story_stiffness[:, None])

    @cached_property
    def _tested_shares(self) -> Floats:
        return self._shares(self.dK)

    @cached_property
    def _heavier(self) -> Floats:
        """Mean relative change of the masses along each of their directions, shape (W,)."""
        return np.asarray(np.mean(np.diagonal(self.dM, axis1=1, axis2=2) / np.diag(self.centre.model.M), axis=1))

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
        # A frame that is softer as a whole has a softer form, too.
        M, K = old.M + dM, old.K + dK + heavier * np.exp(np.mean(stiffness)) * form
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


def _given(real: Modes, dashpots: Floats) -> Floats:
    """Compute the damping ratio of each mode from story dashpots, shape (N,)."""
    drifts = np.diff(real.shapes, axis=1, prepend=0.0)
    return np.asarray(drifts**2 @ dashpots / (2 * np.sqrt(real.eigenvalues)))


def _beside(share: Floats) -> Floats:
    """Compute f(s), the positive root of f^2 = (1 - s) f + b^2 s; f(1) = b."""
    half = 0.5 * (1.0 - share)
    return np.asarray(half + np.sqrt(half**2 + LEFT_BESIDE**2 * share))


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
