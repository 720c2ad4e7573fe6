"""State-space model of a damped frame with noise, and its motion without noise.

With displacements u against the ground, velocities v and relative deviations f of the story forces,

    u' = v,   v' = M^-1 (-K u - C v + load p(t)) + M0^-1 T diag(d) f,   f' = -alpha f + white noise,

M0 and d_i = k_i (rms drift of story i) belong to the identified frame, and each f_i has the standard deviation s. The
process noise enters as accelerations, so a frame with all masses and stiffnesses scaled has the same noise. A model
with an error of a few percent in a story's stiffness misses a force proportional to that story's drift. This force
changes with the frame's vibration. Hence the process noise acts between floors, and its corner frequency alpha is the
first mode's frequency. White noise on the floors would have neither property.

The known excitation is a straight line between samples (first-order hold), and the noise is integrated over a step.
Hence the result is exact for any step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from cvxshear.model import transformation
from cvxshear.records.motion import DrivenRun
from cvxshear.response.damping import DampedModel
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

#: Relative rounding error of a number.
ROUNDING = float(np.finfo(np.float64).eps)

#: Maximum number of doublings of the step: 2^60 samples exceed any record.
MOST_DOUBLINGS = 60

#: Samples per block of a linear recursion: about the square root of the samples of a long record.
BLOCK = 64


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations that a fit to the record estimates.

    Parameters
    ----------
    sensors : ndarray, shape (m,)
        Noise of each channel, m/s2.
    force : float
        s: missed story forces, relative to the rms story force.
    ground : float
        Noise of the excitation's sensor, in its unit.
    """

    sensors: Floats
    force: float
    ground: float = 0.0


@dataclass(frozen=True, eq=False)
class Setting:
    """Constants of a fit of frame and noise.

    Parameters
    ----------
    floors : ndarray of int, shape (m,)
        Floors with sensors.
    step : float
        Time between samples, s.
    force_floor : int
        Floor on which a measured force acts; 0 for base motion.
    corner : float
        alpha, rad/s.
    story_force : ndarray, shape (N,)
        d: rms story forces of the identified frame, N.
    mass : ndarray, shape (N, N)
        M0, kg.
    """

    floors: Ints
    step: float
    force_floor: int
    corner: float
    story_force: Floats
    mass: Floats

    @property
    def states(self) -> int:
        """n: displacements, velocities and story forces."""
        return 3 * len(self.story_force)


@dataclass(frozen=True, eq=False)
class StateOutputs:
    """Rows that turn states into the outputs of a reconstruction.

    The outputs are total accelerations, displacements, drifts and story forces of the frame, then the overturning
    moment if story heights are declared.

    Parameters
    ----------
    rows : ndarray, shape (outputs, n)
    direct : ndarray, shape (outputs,)
        Weights of the excitation.
    """

    rows: Floats
    direct: Floats

    def of(self, states: Floats, excitation: Floats) -> Floats:
        """Return the outputs over time, shape (samples, outputs)."""
        return np.asarray(states @ self.rows.T + np.outer(excitation[:, 1], self.direct))


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Discrete state-space model x+ = A x + before q + after q+ + w, y = H x + direct p + e.

    The excitation follows straight lines between the samples q, and has the values p at the samples. For an excitation
    that is linear between its samples, q equals p. For a band-limited excitation, the lines through q have its
    spectrum. An array of shape (samples, 2) has q and p.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    before, after : ndarray, shape (n,)
        Weights of q at the beginning and at the end of a step.
    Q : ndarray, shape (n, n)
        Covariance of w, with the noise of the excitation's sensor.
    H : ndarray, shape (m, n)
    direct : ndarray, shape (m,)
    R : ndarray, shape (m,)
        Variances of e.
    """

    A: Floats
    before: Floats
    after: Floats
    Q: Floats
    H: Floats
    direct: Floats
    R: Floats
    outputs: StateOutputs

    @cached_property
    def P0(self) -> Floats:  # noqa: N802
        """Stationary covariance of the state under the noise alone, shape (n, n)."""
        return doubled(self.A, self.Q)

    def start_covariance(self, seen: Floats) -> Floats:
        """Covariance of the first state of a record, shape (n, n).

        The frame is in the stationary motion that a white excitation and the noise cause. Its mean square is that of
        the sensors' first samples, shape (samples, m); missing ones are nan.
        """
        driven = doubled(self.A, np.outer(self.before + self.after, self.before + self.after))
        shown = np.broadcast_to(np.sum(self.H @ driven * self.H, axis=1), seen.shape)[np.isfinite(seen)]
        power = float(np.nansum(seen**2)) / max(float(np.sum(shown)), 1e-300)
        return np.asarray(self.P0 + power * driven)

    def seen_by(self, channels: Bools) -> Dynamics:
        """Return the model with a subset of its sensors; the mask has shape (m,)."""
        return replace(self, H=self.H[channels], direct=self.direct[channels], R=self.R[channels])

    def weighted(self, weights: Floats) -> Dynamics:
        """Return the model with a weight for each sensor, shape (m,); a sensor with the weight zero shows nothing."""
        seen = weights > 0
        return replace(self, H=self.H * seen[:, None], R=self.R / np.where(seen, weights, 1.0))

    def shown(self, excitation: Floats) -> Floats:
        """Return the excitation's direct part of the sensors' values, shape (samples, m)."""
        return np.outer(excitation[:, 1], self.direct)


def steps_of(excitation: Floats) -> Floats:
    """Return q at the beginning and at the end of each step, shape (samples, 2); the last row is unused."""
    lines = excitation[:, 0]
    return np.column_stack([lines, np.append(lines[1:], lines[-1])])


def dynamics(model: DampedModel, noise: Noise, setting: Setting) -> Dynamics:
    """Build the discrete state-space model of a frame."""
    N, n = len(model.M), setting.states
    own, load, through = _motion(model, setting.force_floor)
    # Proportional to the motion: a larger motion with smaller gains must give the same model.
    missed = model.input_gain * np.linalg.solve(setting.mass, transformation(N) * setting.story_force)
    rates, load, spread = np.zeros((n, n)), np.append(load, np.zeros(n - 2 * N)), np.zeros((n, n))
    rates[: 2 * N, : 2 * N] = own
    rates[N : 2 * N, 2 * N : 3 * N] = missed
    rates[2 * N : 3 * N, 2 * N : 3 * N] = -setting.corner * np.eye(N)
    spread[2 * N : 3 * N, 2 * N : 3 * N] = 2 * setting.corner * noise.force**2 * np.eye(N)
    total = rates[N : 2 * N]
    A, before, after, Q = discretized(rates, load, spread, setting.step)
    # An error of one sample of the excitation moves the frame in both neighboring steps.
    moved = noise.ground * (before + after)
    at = setting.floors - 1
    H, direct = total[at] * model.gain[at, None], through[at] * model.gain[at]
    outputs = _outputs(model, total, through, setting.force_floor)
    return Dynamics(A, before, after, Q + np.outer(moved, moved), H, direct, noise.sensors**2, outputs)


def slopes(own: Dynamics, others: Sequence[Dynamics], sizes: Floats) -> dict[str, Floats]:
    """Differentiate the matrices of a model by differences to models at the given distances.

    Returns
    -------
    dict of str to ndarray
        Derivatives by the names of `Dynamics`; the first dimension is the direction.
    """
    names = ("A", "before", "after", "Q", "H", "direct", "R")
    return {
        name: np.array(
            [(getattr(other, name) - getattr(own, name)) / size for other, size in zip(others, sizes, strict=True)]
        )
        for name in names
    }


def _motion(model: DampedModel, force_floor: int) -> tuple[Floats, Floats, Floats]:
    """Return rates and load of displacements and velocities, and the load's part of the total accelerations."""
    N = len(model.M)
    rates = np.zeros((2 * N, 2 * N))
    rates[:N, N:] = np.eye(N)
    rates[N:] = -np.linalg.solve(model.M, np.hstack([model.K, model.C]))
    through = np.zeros(N)
    if force_floor:
        through = model.input_gain * np.linalg.solve(model.M, np.eye(N)[force_floor - 1])
    return rates, np.append(np.zeros(N), through if force_floor else np.full(N, -model.input_gain)), through


def _outputs(model: DampedModel, total: Floats, through: Floats, force_floor: int) -> StateOutputs:
    """Return the rows of the reported quantities from the rows of the total accelerations."""
    N = len(model.M)
    moved = np.eye(N, total.shape[1])
    above = np.triu(np.ones((N, N)))
    shear, direct = -above @ model.M @ total, -above @ model.M @ through
    if force_floor:
        direct = direct + model.input_gain * above[:, force_floor - 1]
    rows = [total, moved, np.diff(moved, axis=0, prepend=0.0), shear]
    weights = [through, np.zeros(2 * N), direct]
    if model.heights is not None:
        rows.append((model.heights @ shear)[None])
        weights.append(np.atleast_1d(model.heights @ direct))
    return StateOutputs(np.concatenate(rows), np.concatenate(weights))


def discretized(rates: Floats, load: Floats, spread: Floats, step: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Integrate x' = rates x + load p + white noise of this density over a step in which p is a straight line.

    A matrix exponential over a part of the step gives the transition, the loads and the covariance of the noise (Van
    Loan 1978). The part is then doubled repeatedly, because the exponential of -rates can overflow over a whole step.

    Returns
    -------
    ndarray, shape (n, n)
        Transition.
    ndarray, shape (n,)
    ndarray, shape (n,)
        Weights of p at the beginning and at the end of the step.
    ndarray, shape (n, n)
        Covariance of the noise.
    """
    n = len(rates)
    wide = np.zeros((n + 2, n + 2))
    wide[:n, :n], wide[:n, n], wide[n, n + 1] = rates, load, 1.0 / step
    size = float(linalg.norm(linalg.matrix_balance(rates, permute=False)[0], 1)) * step
    halvings = max(0, int(np.ceil(np.log2(max(size, 1.0)))))
    part = step / 2**halvings
    E = linalg.expm(part * wide)
    Q = np.zeros((n, n))
    if np.any(spread):
        Q = E[:n, :n] @ linalg.expm(part * np.block([[-rates, spread], [np.zeros((n, n)), rates.T]]))[:n, n:]
    for _ in range(halvings):
        Q = Q + E[:n, :n] @ Q @ E[:n, :n].T
        E = E @ E
    after = E[:n, n + 1]
    return E[:n, :n], E[:n, n] - after, after, 0.5 * (Q + Q.T)


def doubled(A: Floats, Q: Floats) -> Floats:
    """Solve P = A P A' + Q for a stable A and one or several symmetric Q, by doubling the number of steps.

    Raises
    ------
    LinAlgError
        If the powers of A grow beyond 64 bits.
    """
    P, power = Q, A
    try:
        with np.errstate(over="raise", invalid="raise"):
            for _ in range(MOST_DOUBLINGS):
                # One large product for all Q: A P A' is the transpose of P A' times A'.
                half = (P.reshape(-1, len(A)) @ power.T).reshape(P.shape).swapaxes(-1, -2)
                P = P + (half.reshape(-1, len(A)) @ power.T).reshape(P.shape)
                power = power @ power
                if np.max(np.abs(power)) <= ROUNDING:
                    break
    except FloatingPointError:
        raise linalg.LinAlgError("the powers of the transition matrix do not fit into 64 bits") from None
    return 0.5 * (P + P.swapaxes(-1, -2))


def recursion(F: Floats, B: Floats, signals: Floats, start: Floats) -> Floats:
    """Compute x_0 = start, x_(t+1) = F x_t + B' s_t, by products of large matrices.

    The states at the beginnings of the blocks are computed first, then all blocks in parallel.

    Parameters
    ----------
    F : ndarray, shape (n, n)
    B : ndarray, shape (k, n)
    signals : ndarray, shape (samples, k)
        The last row is not used.
    start : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (samples, n)
    """
    (samples, k), n, turned = signals.shape, len(F), np.ascontiguousarray(F.T)
    block = min(BLOCK, samples)
    blocks = -(-samples // block)
    cut = np.zeros((blocks * block, k))
    cut[:samples] = signals
    cut = cut.reshape(blocks, block, k)
    reach = [B]
    for _ in range(block - 1):
        reach.append(reach[-1] @ turned)
    added = cut.reshape(blocks, -1) @ np.concatenate(reach[::-1])
    leap, state = np.linalg.matrix_power(turned, block), start
    states = np.empty((blocks, n))
    for begun, end in zip(states, added, strict=True):
        begun[...] = state
        state = state @ leap + end
    result = np.empty((blocks, block, n))
    for j in range(block):
        result[:, j] = states
        states = states @ turned + cut[:, j] @ B
    return result.reshape(-1, n)[:samples]


@dataclass(frozen=True, eq=False)
class Response:
    """Motion of every floor, from rest.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        s.
    acceleration : ndarray, shape (samples, N)
        Total accelerations of the floors, m/s2.
    displacement : ndarray, shape (samples, N)
        Displacements of the floors against the ground, m.
    story_force : ndarray, shape (samples, N)
        Shear of story i: the forces on floors i and above minus their inertia, N. Without a mass scale, per kilogram
        of the frame.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool
    """

    time: Floats
    acceleration: Floats
    displacement: Floats
    story_force: Floats
    heights: Floats | None
    mass_known: bool

    @property
    def drift(self) -> Floats:
        """Story drifts: each floor's displacement minus the lower floor's, shape (samples, N), m."""
        return np.diff(self.displacement, axis=1, prepend=0.0)

    @property
    def drift_ratio(self) -> Floats | None:
        """Drift over story height, shape (samples, N); None if heights are not declared."""
        return None if self.heights is None else self.drift / self.heights

    @property
    def story_shear(self) -> Floats | None:
        """`story_force`, N; None if the mass scale is unknown."""
        return self.story_force if self.mass_known else None

    @property
    def base_shear(self) -> Floats | None:
        """Shear of the first story, shape (samples,), N."""
        return self.story_force[:, 0] if self.mass_known else None

    @property
    def overturning_moment(self) -> Floats | None:
        """Moment of the floors' forces about the base, shape (samples,), N m; without gravity on displaced floors."""
        return self.story_force @ self.heights if self.mass_known and self.heights is not None else None


def response(model: DampedModel, run: DrivenRun, step: float) -> Response:
    """Compute the motion of the floors, exactly for an excitation that is a straight line between samples.

    Parameters
    ----------
    model : DampedModel
    run : DrivenRun
        A base acceleration if its floor is 0, else a force.
    step : float
        Time between samples, s.

    Raises
    ------
    InputError
        If the force acts on a floor that the frame does not have.
    """
    n = len(model.M)
    if run.floor > n:
        raise InputError(f"the force acts on floor {run.floor} of a frame of {n} stories")
    rates, load, through = _motion(model, run.floor)
    A, before, after, _ = discretized(rates, load, np.zeros_like(rates), step)
    states = recursion(A, np.array([before, after]), steps_of(run.drive), np.zeros(2 * n))
    return response_of(model, _outputs(model, rates[n:], through, run.floor).of(states, run.drive), step)


def response_of(model: DampedModel, outputs: Floats, step: float) -> Response:
    """Return the motion that outputs over time describe, shape (samples, outputs), in the order of `StateOutputs`."""
    n = len(model.M)
    acceleration, displacement, _, force = (outputs[:, k * n : (k + 1) * n] for k in range(4))
    time = step * np.arange(len(outputs), dtype=np.float64)
    return Response(time, acceleration, displacement, force, model.heights, model.mass_known)
