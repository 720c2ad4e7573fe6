"""State-space model of a damped frame with errors in the story forces of its model.

With displacements u against the ground, velocities v and relative deviations f of the story forces,

    u' = v,   v' = M^-1 (-K u - C v + load p(t)) + M0^-1 T diag(d) f,   f' = -alpha f + white noise,

M0 and d_i = k_i (rms drift of story i) belong to the identified frame, and each f_i has the standard deviation s. The
process noise enters as accelerations, so a frame with all masses and stiffnesses scaled has the same noise. A model
with an error of a few percent in a story's stiffness misses a force proportional to that story's drift. This force
changes with the frame's vibration. Hence the process noise acts between floors, and its corner frequency alpha is the
first mode's frequency. White noise on the floors would have neither property. If the base motion was not measured, the
base acceleration is one more state of this kind.

The known excitation is a straight line between samples (first-order hold), and the noise is integrated over a step.
Hence the result is exact for any step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from cvxshear.model.shear import transformation
from cvxshear.response.damped import DampedModel
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats, Ints

SETTLED_RICCATI = 1e-13
"""Relative change of a covariance that ends the doubling of the Riccati equation. Each round doubles the number of
correct digits, so the next change is below rounding."""

SUMMED_SIZE, SUMMED_POWERS = 0.5, 14
"""Norm of the rates times a part of a step, and number of terms of the power series. The first omitted term is below
rounding."""

FORGOTTEN = 1e-10
"""Largest entry of a power of the transition matrix that counts as zero: its square is below rounding."""

MOST_DOUBLINGS = 60
"""Maximum number of doublings of the step: 2^60 samples exceed any record."""


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
        Base acceleration if it was not measured, m/s2; otherwise the noise of the excitation's sensor, in its unit.
    """

    sensors: Floats
    force: float
    ground: float = 0.0


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
    Q, Q_input : ndarray, shape (n, n)
        Covariance of w, and its part from the noise of the excitation's sensor, which is also present before and after
        the motion.
    H : ndarray, shape (m, n)
    direct : ndarray, shape (m,)
    R : ndarray, shape (m,)
        Variances of e.
    """

    A: Floats
    before: Floats
    after: Floats
    Q: Floats
    Q_input: Floats
    H: Floats
    direct: Floats
    R: Floats
    outputs: Outputs

    @cached_property
    def P0(self) -> Floats:  # noqa: N802
        """Stationary covariance of the state under the noise alone, shape (n, n)."""
        return doubled(self.A, self.Q)

    def seen_by(self, channels: Bools) -> Dynamics:
        """Return the model with a subset of its sensors; the mask has shape (m,)."""
        return dataclasses.replace(self, H=self.H[channels], direct=self.direct[channels], R=self.R[channels])

    def driven(self, excitation: Floats) -> Floats:
        """Return the excitation's change of the state in each step, shape (samples, n); the last row is unused."""
        driven: Floats = steps_of(excitation) @ [self.before, self.after]
        return driven

    def shown(self, excitation: Floats) -> Floats:
        """Return the excitation's direct part of the sensors' values, shape (samples, m)."""
        return np.outer(excitation[:, 1], self.direct)


@dataclass(frozen=True, eq=False)
class Outputs:
    """Rows that turn states into the outputs of a reconstruction.

    The outputs are total accelerations, displacements, drifts and story forces of the frame, then the overturning
    moment if story heights are declared, and the base acceleration if it is estimated.

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
        result: Floats = states @ self.rows.T
        if np.any(self.direct):
            result += np.outer(excitation[:, 1], self.direct)
        return result


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
    ground_corner : float
        Corner frequency of an unmeasured base acceleration, rad/s.
    story_force : ndarray, shape (N,)
        d: rms story forces of the identified frame, N.
    mass : ndarray, shape (N, N)
        M0, kg.
    """

    floors: Ints
    step: float
    force_floor: int
    base_measured: bool
    corner: float
    ground_corner: float
    story_force: Floats
    mass: Floats

    @property
    def states(self) -> int:
        """n: displacements, velocities, story forces, and an unmeasured base acceleration."""
        return 3 * len(self.story_force) + (0 if self.base_measured else 1)

    def without(self, channel: int) -> Setting:
        """Return the setting with one channel fewer."""
        return dataclasses.replace(self, floors=np.delete(self.floors, channel))


def steps_of(excitation: Floats) -> Floats:
    """Return q at the beginning and at the end of each step, shape (samples, 2); the last row is unused."""
    lines = excitation[:, 0]
    return np.column_stack([lines, np.append(lines[1:], lines[-1])])


def dynamics(model: DampedModel, noise: Noise, setting: Setting) -> Dynamics:
    """Build the discrete state-space model of a frame."""
    own = _Rates.of(model, noise, setting)
    A, before, after, Q = (each[0] for each in _over_a_step(own.rates, own.load, own.density, setting.step))
    # An error of one sample moves the frame in both neighboring steps.
    moved = own.ground * (before + after)
    Q_input = np.outer(moved, moved)
    return Dynamics(A, before, after, Q + Q_input, Q_input, own.H, own.direct, own.R, outputs_of(model, noise, setting))


def dynamics_slopes(
    centre: tuple[DampedModel, Noise], beside: Sequence[tuple[DampedModel, Noise]], sizes: Floats, setting: Setting
) -> dict[str, Floats]:
    """Differentiate the discrete state-space model by differences to frames at the given distances.

    Returns
    -------
    dict of str to ndarray
        Derivatives by the names of `Dynamics`; the first dimension is the direction.
    """
    own = _Rates.of(*centre, setting)
    others = [_Rates.of(*each, setting) for each in beside]
    slopes = [
        dataclasses.replace(own, **{
            each.name: (getattr(other, each.name) - getattr(own, each.name)) / size
            for each in dataclasses.fields(_Rates)
        })
        for other, size in zip(others, sizes, strict=True)
    ]  # fmt: skip
    A, before, after, Q = _over_a_step(own.rates, own.load, own.density, setting.step, slopes)
    moved, ground = before + after, np.array([each.ground for each in slopes])
    noisy = own.ground * moved[0]
    crossed = (ground[:, None] * moved[0] + own.ground * moved[1:])[:, :, None] * noisy
    found = {"A": A[1:], "before": before[1:], "after": after[1:], "Q": Q[1:] + crossed + crossed.swapaxes(1, 2)}
    return found | {name: np.array([getattr(each, name) for each in slopes]) for name in ("H", "direct", "R")}


@dataclass(frozen=True, eq=False)
class _Rates:
    """Continuous state-space model x' = rates x + load p + white noise of this density, or its derivative.

    Parameters
    ----------
    total, through : ndarray, shapes (N, n) and (N,)
        Weights of the state and the excitation in the accelerations.
    ground : float
        Standard deviation of the excitation's sensor; 0 if the base acceleration is estimated.
    """

    rates: Floats
    load: Floats
    density: Floats
    total: Floats
    through: Floats
    H: Floats
    direct: Floats
    R: Floats
    ground: float

    @staticmethod
    def of(model: DampedModel, noise: Noise, setting: Setting) -> _Rates:
        N = len(model.M)
        estimated, n = not setting.base_measured, setting.states
        T = transformation(N)
        restoring = -np.linalg.solve(model.M, np.hstack([model.K, model.C]))
        # Proportional to the motion: a larger motion with smaller gains must give the same model.
        missed = model.input_gain * np.linalg.solve(setting.mass, T * setting.story_force)
        rates = np.zeros((n, n))
        rates[:N, N : 2 * N] = np.eye(N)
        rates[N : 2 * N, : 2 * N] = restoring
        rates[N : 2 * N, 2 * N : 3 * N] = missed
        rates[2 * N : 3 * N, 2 * N : 3 * N] = -setting.corner * np.eye(N)
        load = np.zeros(n)
        total = np.zeros((N, n))
        total[:, : 3 * N] = np.hstack([restoring, missed])
        through = np.zeros(N)
        if estimated:
            rates[N : 2 * N, 3 * N] = -1.0
            rates[3 * N, 3 * N] = -setting.ground_corner
        elif setting.force_floor:
            through = model.input_gain * np.linalg.solve(model.M, np.eye(N)[setting.force_floor - 1])
            load[N : 2 * N] = through
        else:
            load[N : 2 * N] = -model.input_gain
        density = np.zeros(n)
        density[2 * N : 3 * N] = 2 * setting.corner * noise.force**2
        if estimated:
            density[3 * N] = 2 * setting.ground_corner * noise.ground**2
        at = setting.floors - 1
        return _Rates(
            rates, load, density, total, through, total[at] * model.gain[at, None], through[at] * model.gain[at],
            noise.sensors**2, 0.0 if estimated else noise.ground,
        )  # fmt: skip


def outputs_of(model: DampedModel, noise: Noise, setting: Setting) -> Outputs:
    """Return the rows of the reported quantities."""
    own, N = _Rates.of(model, noise, setting), len(model.M)
    total, through = own.total, own.through
    moved = np.eye(N, setting.states)
    above = np.triu(np.ones((N, N)))
    shear, direct = -above @ model.M @ total, -above @ model.M @ through
    if setting.force_floor:
        direct = direct + model.input_gain * above[:, setting.force_floor - 1]
    rows = [total, moved, np.diff(moved, axis=0, prepend=0.0), shear]
    weights = [through, np.zeros(2 * N), direct]
    if model.heights is not None:
        rows.append((model.heights @ shear)[None])
        weights.append(np.atleast_1d(model.heights @ direct))
    if not setting.base_measured:
        rows.append(np.eye(setting.states)[3 * N :])
        weights.append(np.zeros(1))
    return Outputs(np.concatenate(rows), np.concatenate(weights))


def _over_a_step(
    rates: Floats, load: Floats, density: Floats, step: float, slopes: Sequence[_Rates] = ()
) -> tuple[Floats, Floats, Floats, Floats]:
    """Integrate over a step: transition, weights of the excitation at both ends, and covariance of the white noise.

    The excitation is linear within the step. The first entry of each array is the value, the others are derivatives.
    The power series of the rates is summed over a part of the step, which is then doubled repeatedly.
    """
    n, r = len(rates), len(slopes)
    wide, moved = np.zeros((n + 2, n + 2)), np.zeros((r, n, n + 2))
    wide[:n, :n], wide[:n, n], wide[n, n + 1] = rates, load, 1.0 / step
    for each, row in zip(slopes, moved, strict=True):
        row[:, :n], row[:, n] = each.rates, each.load
    rows = np.flatnonzero(np.any(moved, axis=(0, 2)))
    # Only states coupled to the changing rows are computed; the rows of the other states stay as they are.
    near = np.eye(n + 2, dtype=bool)[rows].any(axis=0)
    while (further := near | (wide[:, near] != 0).any(axis=1)).sum() > near.sum():
        near = further
    live = np.flatnonzero(near)
    within = np.searchsorted(live, rows)
    flat = moved[:, rows].reshape(-1, n + 2)
    size = float(linalg.norm(linalg.matrix_balance(wide, permute=False)[0], 1)) * step
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / SUMMED_SIZE))))
    part = step / 2**halvings
    noisy = np.flatnonzero(density)
    power, turned, between = np.eye(n + 2), np.zeros((len(live), r, n + 2)), wide[np.ix_(live, live)]
    powers, noisy_slopes, summed = [power], [turned[..., noisy]], turned
    for k in range(1, SUMMED_POWERS):
        turned = (between @ turned.reshape(len(live), r * (n + 2))).reshape(turned.shape)
        turned[within] += (flat @ power).reshape(r, len(rows), n + 2).swapaxes(0, 1)
        turned *= part / k
        power = wide @ power * (part / k)
        powers.append(power)
        noisy_slopes.append(turned[..., noisy])
        summed = summed + turned
    A, dA = sum(powers[1:], powers[0]), np.zeros((r, n + 2, n + 2))
    dA[:, live] = summed.swapaxes(0, 1)
    # The integral of two powers over the part.
    order = np.repeat(np.arange(SUMMED_POWERS), len(noisy))
    weights = part / (order[:, None] + order + 1.0) * np.tile(np.eye(len(noisy)), (SUMMED_POWERS, SUMMED_POWERS))
    left = np.concatenate([each[:n, noisy] for each in powers], axis=1)
    left_slopes = np.concatenate(noisy_slopes, axis=2)
    spread = weights * np.tile(density[noisy], SUMMED_POWERS) @ left.T
    half = np.zeros((r, n, n))
    half[:, live] = (left_slopes @ spread).swapaxes(0, 1)
    Q, dQ = left @ spread, half + half.swapaxes(1, 2)
    for place, each in enumerate(slopes):
        if np.any(each.density):
            dQ[place] += left @ (weights * np.tile(each.density[noisy], SUMMED_POWERS)) @ left.T
    for _ in range(halvings):
        core, dcore = A[:n, :n], dA[:, :n, :n]
        half = dcore @ (Q @ core.T)
        dQ = dQ + core @ dQ @ core.T + half + half.swapaxes(1, 2)
        Q = Q + core @ Q @ core.T
        A, dA = A @ A, dA @ A + A @ dA
    both, covariances = np.concatenate([A[None], dA]), np.concatenate([Q[None], dQ])
    after = both[:, :n, n + 1]
    return both[:, :n, :n], both[:, :n, n] - after, after, 0.5 * (covariances + covariances.swapaxes(1, 2))


def doubled(A: Floats, Q: Floats) -> Floats:
    """Solve P = A P A' + Q for a stable A and one or several symmetric Q, by doubling the number of steps."""
    P, power = Q, A
    for _ in range(MOST_DOUBLINGS):
        # One large product for all Q: A P A' is the transpose of P A' times A'.
        half = (P.reshape(-1, len(A)) @ power.T).reshape(P.shape).swapaxes(-1, -2)
        P = P + (half.reshape(-1, len(A)) @ power.T).reshape(P.shape)
        power = power @ power
        if np.max(np.abs(power)) <= FORGOTTEN:
            break
    return 0.5 * (P + P.swapaxes(-1, -2))


def settled_covariance(model: Dynamics) -> Floats:
    """Compute the covariance of the predicted state of the settled filter, shape (n, n).

    The doubling method for the Riccati equation (Chu, Fan, Lin and Wang 2004) needs no eigenvalues, so it also works
    for stories without observation.
    """
    n = len(model.A)
    power, G, P = model.A.T, model.H.T @ (model.H / model.R[:, None]), model.Q
    for _ in range(MOST_DOUBLINGS):
        inner = np.linalg.inv(np.eye(n) + G @ P)
        more = power.T @ P @ inner @ power
        G = G + power @ inner @ G @ power.T
        power = power @ inner @ power
        P = P + more
        P, G = 0.5 * (P + P.T), 0.5 * (G + G.T)
        if np.all(np.abs(np.diag(more)) <= SETTLED_RICCATI * np.diag(P)):
            break
    return P


SHORT: np.dtype[Any] = np.dtype(np.float32)
"""Precision of the derivatives of innovations; single precision halves time and memory. Differences of two motions need
double precision: at 200 Hz, rounding would be as large as the change by a standard deviation of the frame."""

LONG = 256
"""Least number of samples (four blocks) for products of large matrices; below, a loop over the samples is faster."""

BLOCK = 64
"""Samples per block of a linear recursion: about the square root of the samples of a long record."""


def recursion(F: Floats, B: Floats, signals: Floats, start: Floats) -> Floats:
    """Compute x_0 = start, x_(t+1) = F x_t + B' s_t, by products of large matrices if there are many samples.

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
    block = BLOCK if samples >= LONG else 1
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
        if j + 1 < block:
            states = states @ turned
            states += cut[:, j] @ B
    return result.reshape(-1, n)[:samples]
