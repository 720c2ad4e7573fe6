"""State-space model of a damped frame, its motion, the filter that predicts its sensors, and the smoother.

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

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from cvxshear.model import transformation
from cvxshear.records.motion import DrivenRun
from cvxshear.response.damping import DampedModel
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

ROUNDING = float(np.finfo(np.float64).eps)
"""Relative rounding error of a number."""

MOST_DOUBLINGS = 60
"""Maximum number of doublings of the step: 2^60 samples exceed any record."""

BLOCK = 64
"""Samples per block of a linear recursion: about the square root of the samples of a long record."""

SPIKE = 5.0
"""Minimum residual of a spike, in standard deviations; Gaussian noise has one in two million samples."""

MOST_REWEIGHTINGS = 12
"""Maximum number of rounds of reweighting; each needs one sweep."""

SAME_WEIGHT = 0.02
"""Maximum change of a weight at convergence: a fiftieth of the sample's influence."""

NEAR_LIMIT = 0.05
"""Relative difference of variances from their limits, a `BLOCK` or more after a change of the weights, at which the
limits replace them. The replacement saves time and memory."""


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

    def without(self, channel: int) -> Setting:
        """Return the setting with one channel fewer."""
        return dataclasses.replace(self, floors=np.delete(self.floors, channel))


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
        result: Floats = states @ self.rows.T + np.outer(excitation[:, 1], self.direct)
        return result


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

    def seen_by(self, channels: Bools) -> Dynamics:
        """Return the model with a subset of its sensors; the mask has shape (m,)."""
        return dataclasses.replace(self, H=self.H[channels], direct=self.direct[channels], R=self.R[channels])

    def weighted(self, weights: Floats) -> Dynamics:
        """Return the model with a weight for each sensor, shape (m,); a sensor with the weight zero shows nothing."""
        seen = weights > 0
        return dataclasses.replace(self, H=self.H * seen[:, None], R=self.R / np.where(seen, weights, 1.0))

    def driven(self, excitation: Floats) -> Floats:
        """Return the excitation's change of the state in each step, shape (samples, n); the last row is unused."""
        driven: Floats = steps_of(excitation) @ [self.before, self.after]
        return driven

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
    outputs = _outputs(model, total, through, setting)
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


def _outputs(model: DampedModel, total: Floats, through: Floats, setting: Setting) -> StateOutputs:
    """Return the rows of the reported quantities from the rows of the total accelerations."""
    N = len(model.M)
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
    """Solve P = A P A' + Q for a stable A and one or several symmetric Q, by doubling the number of steps."""
    P, power = Q, A
    for _ in range(MOST_DOUBLINGS):
        # One large product for all Q: A P A' is the transpose of P A' times A'.
        half = (P.reshape(-1, len(A)) @ power.T).reshape(P.shape).swapaxes(-1, -2)
        P = P + (half.reshape(-1, len(A)) @ power.T).reshape(P.shape)
        power = power @ power
        if np.max(np.abs(power)) <= ROUNDING:
            break
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
class Filter:
    """One step of the Kalman filter.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the predicted state.
    S : ndarray, shape (m, m)
        Covariance of the innovations.
    K : ndarray, shape (n, m)
        Gain.
    """

    model: Dynamics
    P: Floats
    S: Floats
    K: Floats

    @staticmethod
    def at(model: Dynamics, P: Floats) -> Filter:
        """Return the filter for a covariance of the predicted state."""
        PH = P @ model.H.T
        S: Floats = model.H @ PH + np.diag(model.R)
        return Filter(model, P, S, np.asarray(np.linalg.solve(S, (model.A @ PH).T).T))

    @staticmethod
    def settled(model: Dynamics) -> Filter:
        """Return the filter whose covariance no longer changes.

        The doubling method for the Riccati equation (Chu, Fan, Lin and Wang 2004) needs no eigenvalues, so it also
        works for stories without observation, for which `scipy.linalg.solve_discrete_are` fails.
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
            # Each round doubles the number of correct digits.
            if np.all(np.diag(more) ** 2 <= ROUNDING * np.diag(P) ** 2):
                break
        return Filter.at(model, P)

    @property
    def F(self) -> Floats:  # noqa: N802
        """A - K H, shape (n, n)."""
        result: Floats = self.model.A - self.K @ self.model.H
        return result

    @property
    def pull(self) -> Floats:
        """S^-1 H, shape (m, n)."""
        return np.asarray(np.linalg.solve(self.S, self.model.H))

    @property
    def following(self) -> Floats:
        """Covariance of the next predicted state, shape (n, n)."""
        P: Floats = self.F @ self.P @ self.model.A.T + self.model.Q
        return 0.5 * (P + P.T)

    def predicted(self, excitation: Floats, y: Floats, start: Floats) -> tuple[Floats, Floats]:
        """Compute the states predicted from the past, shape (samples, n), and the innovations, shape (samples, m)."""
        seen = y - self.model.shown(excitation)
        B = np.vstack([self.K.T, self.model.before, self.model.after])
        x = recursion(self.F, B, np.hstack([seen, steps_of(excitation)]), start)
        return x, seen - x @ self.model.H.T

    def slopes(self, rates: dict[str, Floats]) -> tuple[Floats, Floats]:
        """Differentiate the gain, shape (r, n, m), and S, shape (r, m, m), of a settled filter.

        The derivative of P solves dP = F dP F' + G. The gain counts as constant there, because it is optimal.
        """
        model, K, F, P = self.model, self.K, self.F, self.P
        dA, dH, dR = rates["A"], rates["H"], rates["R"]
        turned = (dA - K @ dH) @ P @ F.T
        dP = doubled(F, turned + turned.swapaxes(1, 2) + (K * dR[:, None]) @ K.T + rates["Q"])
        crossed, across = dH @ P @ model.H.T, dP @ model.H.T
        dS = crossed + crossed.swapaxes(1, 2) + model.H @ across + dR[:, None] * np.eye(len(self.S))
        dK = dA @ P @ model.H.T + model.A @ (across + P @ dH.swapaxes(1, 2)) - K @ dS
        return dK @ np.linalg.inv(self.S), dS


@dataclass(frozen=True, eq=False)
class Observed:
    """One run's excitation and measured accelerations.

    Parameters
    ----------
    excitation : ndarray, shape (samples, 2)
        As in `Dynamics`; zeros if the excitation was not measured.
    measured : ndarray, shape (samples, m)
        m/s2; nan for missing samples.
    start_scale : float
        Factor on the standard deviation of the state at the start.
    """

    excitation: Floats
    measured: Floats
    start_scale: float = 1.0

    @property
    def present(self) -> Bools:
        """Mask of the measured samples, shape (samples, m)."""
        return np.isfinite(self.measured)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The states of a run and their uncertainty.

    Parameters
    ----------
    states : ndarray, shape (samples, n)
    innovations : ndarray, shape (samples, m)
        Innovations of the filter, divided by their standard deviations; nan for missing samples.
    weights : ndarray, shape (samples, m)
        Weights of the samples: 1, less for a spike, 0 if missing.
    output_std : ndarray, shape (samples, outputs)
        Standard deviations of the requested outputs, given the frame.
    completed : ndarray, shape (samples, m)
        The measured accelerations, spikes cut to Huber's limit and missing samples estimated. An ordinary
        smoother finds the same motion from them.
    """

    states: Floats
    innovations: Floats
    weights: Floats
    output_std: Floats
    completed: Floats


Stretch = tuple[int, int, Filter]
"""First sample of a segment, the sample after its end, and its filter."""


def smooth(model: Dynamics, run: Observed, rows: Floats) -> Smoothed:
    """Find the most probable motion, and standard deviations of rows times the states.

    Over the states x_0, x_1, ... of `Dynamics`, the motion minimizes

        |P0^(-1/2) x_0|^2 + sum |Q^(-1/2) (x_(t+1) - A x_t - B p_t)|^2 + sum w_tj (y_tj - H_j x_t - D_j p_t)^2 / R_j.

    The normal matrix is block tridiagonal. It is eliminated forward (the Kalman filter) and back (the smoother of
    Bryson and Frazier 1963, which needs no inverse of a covariance). A missing sample has the weight zero. Iterative
    reweighting minimizes Huber's loss, which grows linearly beyond `SPIKE` standard deviations and limits the influence
    of spikes.
    """
    weights = run.present.astype(np.float64)
    shown, measured = model.shown(run.excitation), np.nan_to_num(run.measured)
    for _ in range(MOST_REWEIGHTINGS):
        stretches = _stretches(model, run, weights)
        states, innovations = _swept(stretches, run.excitation, measured, np.zeros(len(model.A)))
        fitted = states @ model.H.T + shown
        size = np.abs(measured - fitted) / np.sqrt(model.R)
        found = np.where(run.present, np.minimum(1.0, SPIKE / np.maximum(size, SPIKE)), 0.0)
        if np.max(np.abs(found - weights), initial=0.0) <= SAME_WEIGHT:
            break
        weights = found
    completed = fitted + weights * (measured - fitted)
    std = _deviations(rows, stretches, len(states))
    return Smoothed(states, np.where(weights > 0, innovations, np.nan), weights, std, completed)


def _stretches(model: Dynamics, run: Observed, weights: Floats) -> list[Stretch]:
    """Split a run into segments with one filter: a filter that settles has one sample per segment."""
    edges = [0, *(np.flatnonzero(np.any(np.diff(weights, axis=0), axis=1)) + 1).tolist(), len(weights)]
    P, found = run.start_scale**2 * model.P0, []
    for first, last in pairwise(edges):
        own = model.weighted(weights[first])
        limit = Filter.settled(own) if last - first > BLOCK else None
        t = first
        while t < last:
            settled = limit if limit and t - first >= BLOCK and _near(P, limit.P) else None
            here, until = (Filter.at(own, P), t + 1) if settled is None else (settled, last)
            found.append((t, until, here))
            t, P = until, here.following
    return found


def _near(covariance: Floats, limit: Floats) -> bool:
    """Return whether all variances are close to their limits."""
    variances, limits = covariance.diagonal(), limit.diagonal()
    return bool(np.all(np.abs(variances - limits) <= NEAR_LIMIT * limits))


def _swept(stretches: Sequence[Stretch], excitation: Floats, y: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Compute smoothed states and innovations in standard deviations: one sweep forward, one back."""
    states, e = np.empty((len(y), len(start))), np.empty_like(y)
    innovations = np.empty_like(y)
    for first, last, here in stretches:
        # The filter predicts the first sample of the next segment, too.
        reached = slice(first, last + 1)
        own = np.where(here.model.H.any(axis=1), y[reached], here.model.shown(excitation[reached]))
        predicted, left = here.predicted(excitation[reached], own, start)
        if last == len(y):
            predicted, left = np.vstack([predicted, start]), np.vstack([left, left[-1]])
        states[first:last], start = predicted[: last - first], predicted[last - first]
        e[first:last] = left[: last - first]
        innovations[first:last] = e[first:last] / np.sqrt(here.S.diagonal())
    # The backward sweep adds the information of later samples: r_(t-1) = H' S^-1 e_t + F' r_t.
    r = np.zeros(len(start))
    for first, last, here in reversed(stretches):
        ahead = np.concatenate([e[first:last][::-1], np.zeros((1, e.shape[1]))])
        pulls = recursion(here.F.T, here.pull, ahead, r)[:0:-1]
        states[first:last] += pulls @ here.P
        r = pulls[0]
    return states, innovations


def _deviations(rows: Floats, stretches: Sequence[Stretch], samples: int) -> Floats:
    """Compute standard deviations of smoothed outputs: P - P N P with N = H' S^-1 H + F' N F, backward."""
    N: Floats = np.zeros_like(stretches[0][2].P)
    result = np.empty((samples, len(rows)))
    for first, last, here in reversed(stretches if len(rows) else ()):
        F, own, spread = here.F, here.model.H.T @ here.pull, rows @ here.P
        plain = np.sum(spread * rows, axis=1)
        limit = doubled(F.T, own) if last - first > BLOCK else None
        for t in range(last - 1, first - 1, -1):
            N = own + F.T @ N @ F
            N = 0.5 * (N + N.T)
            settled = limit is not None and last - t > BLOCK and _near(N, limit)
            N = limit if limit is not None and settled else N
            variance = plain - np.sum((spread @ N) * spread, axis=1)
            result[first if settled else t : t + 1] = np.sqrt(np.maximum(variance, 0.0))
            if settled:
                break
    return result


Piece = tuple[slice, Bools]
"""A part of a run, and the mask of the m sensors that recorded in it, shape (m,)."""


def settled_states(model: Dynamics, excitation: Floats, y: Floats, start: Floats, pieces: Sequence[Piece]) -> Floats:
    """Compute smoothed states with filters that are settled from the beginning of each piece, shape (samples, n).

    Parameters
    ----------
    excitation : ndarray, shape (samples, 2)
    y : ndarray, shape (samples, m)
        Accelerations without missing samples.
    start : ndarray, shape (n,)
    pieces : sequence of Piece
        Consecutive pieces from the first to the last sample.
    """
    filters = {each.tobytes(): Filter.settled(model.weighted(each.astype(np.float64))) for _, each in pieces}
    stretches = [(part.start, part.stop, filters[each.tobytes()]) for part, each in pieces]
    return _swept(stretches, excitation, y, start)[0]


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
    n, p = len(model.M), run.excitation
    if run.floor > n:
        raise InputError(f"the force acts on floor {run.floor} of a frame of {n} stories")
    rates, load, through = _motion(model, run.floor)
    A, before, after, _ = discretized(rates, load, np.zeros_like(rates), step)
    lines = p if run.between is None else run.between
    states = recursion(A, np.array([before, after]), steps_of(lines[:, None]), np.zeros(2 * n))
    acceleration = states @ rates[n:].T + np.outer(p, through)
    forces = np.zeros((len(p), n))
    if run.floor:
        forces[:, run.floor - 1] = model.input_gain * p
    unbalanced = forces - acceleration @ model.M
    time = step * np.arange(len(p), dtype=np.float64)
    story_force = np.cumsum(unbalanced[:, ::-1], axis=1)[:, ::-1]
    return Response(time, acceleration, states[:, :n], story_force, model.heights, model.mass_known)
