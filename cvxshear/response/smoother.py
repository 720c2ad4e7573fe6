"""The motion of a frame from the floors with sensors: a least-squares program solved by one sweep each way.

Over the states x_0, x_1, ... of `Dynamics`, the motion minimizes

    |P0^(-1/2) x_0|^2 + sum |Q^(-1/2) (x_(t+1) - A x_t - B p_t)|^2 + sum w_tj (y_tj - H_j x_t - D_j p_t)^2 / R_j.

The normal matrix is block tridiagonal. `smooth` eliminates the blocks forward (the Kalman filter) and back (the
smoother of Bryson and Frazier 1963, which needs no inverse of a covariance). A missing sample has the weight zero.
Iterative reweighting minimizes Huber's loss, which grows linearly beyond `SPIKE` standard deviations and limits the
influence of spikes.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cvxshear.response.dynamics import Dynamics, doubled, recursion, settled_covariance, steps_of
from cvxshear.util.typing import Bools, Floats, Ints

SPIKE = 5.0
"""Minimum residual of a spike, in standard deviations; Gaussian noise has one in two million samples."""

MOST_REWEIGHTINGS = 12
"""Maximum number of rounds of reweighting; each needs one sweep."""

SAME_WEIGHT = 0.02
"""Maximum change of a weight at convergence: a fiftieth of the sample's influence."""

SETTLED = 1e-9
"""Maximum relative change of a settled covariance over one sample. A sampled vibration decays by at least 1e-3 in one
sample, so the motion is exact to about 1e-6."""

LEAST_TRANSIENT = 100
MOST_TRANSIENT = 2_000
"""Minimum and maximum number of samples with their own covariances after a change of the weights. In between, a
covariance near its limit is replaced by the limit, which saves time and memory."""

NEAR_LIMIT = 0.05
"""Relative difference of a variance from its limit for this replacement: 2.5 % of a standard deviation."""


SWEPT_AT_ONCE = 8_192
"""Samples of a sweep in one pass, which limits its memory to some ten megabytes."""


@dataclass(frozen=True, eq=False)
class Observed:
    """One run's excitation and measured accelerations.

    Parameters
    ----------
    excitation : ndarray, shape (samples, 2)
        As in `Dynamics`; zeros if the excitation was not measured.
    measured : ndarray, shape (samples, m)
        m/s2; nan for missing samples.
    envelope : ndarray, shape (samples,)
        Factor on the standard deviation of the missed story forces, piecewise constant; the noise has no such factor.
    start_scale : float
        Factor on the standard deviation of the state at the start.
    """

    excitation: Floats
    measured: Floats
    envelope: Floats
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


@functools.cache
def _places(size: int) -> Ints:
    """Return the index of each entry of a symmetric matrix in its lower triangle, stored by rows."""
    low, high = np.sort(np.indices((size, size)), axis=0)
    return np.asarray(high * (high + 1) // 2 + low)


@dataclass(frozen=True, eq=False)
class _Gain:
    """Matrices of the filter at one sample."""

    A: Floats
    triangle: Floats
    H: Floats
    inverse_S: Floats
    K: Floats
    innovation_std: Floats

    @property
    def P(self) -> Floats:  # noqa: N802
        """Covariance of the predicted state; only half of it is stored, to save memory."""
        result: Floats = self.triangle[_places(len(self.A))]
        return result

    @property
    def transition(self) -> Floats:
        """A - K H; not stored, to save memory."""
        result: Floats = self.A - self.K @ self.H
        return result


def smooth(model: Dynamics, run: Observed, rows: Floats) -> Smoothed:
    """Find the motion that minimizes this module's program, and standard deviations of rows times the states."""
    weights = run.present.astype(np.float64)
    sigma = np.sqrt(model.R)
    gains: list[_Gain] = []
    for _ in range(MOST_REWEIGHTINGS):
        # Release the gains of the last round first, to save memory.
        gains.clear()
        gains, which = _gains(model, run, weights)
        states, innovations = _sweeps(model, run, gains, which, weights)
        residual = run.measured - states @ model.H.T - model.shown(run.excitation)
        size = np.abs(np.nan_to_num(residual)) / sigma
        found = np.where(run.present, np.minimum(1.0, SPIKE / np.maximum(size, SPIKE)), 0.0)
        if np.max(np.abs(found - weights), initial=0.0) <= SAME_WEIGHT:
            break
        weights = found
    fitted = states @ model.H.T + model.shown(run.excitation)
    completed = np.where(run.present, fitted + weights * np.nan_to_num(residual), fitted)
    std = _deviations(rows, gains, which)
    return Smoothed(states, innovations, weights, std, completed)


def _stretches(weights: Floats, envelope: Floats) -> Iterator[tuple[int, int]]:
    """Find the beginning and end of each segment with constant weights and constant process noise."""
    keys = np.column_stack([weights, envelope])
    changes = np.flatnonzero(np.any(keys[1:] != keys[:-1], axis=1)) + 1
    edges = [0, *changes.tolist(), len(keys)]
    yield from pairwise(edges)


def _gains(model: Dynamics, run: Observed, weights: Floats) -> tuple[list[_Gain], Ints]:
    """Compute the distinct gains of the filter, and the index of each sample's gain."""
    A, R = model.A, model.R
    P, lower = run.start_scale**2 * model.P0, np.tril_indices(len(A))
    gains: list[_Gain] = []
    which = np.empty(len(weights), dtype=np.int64)
    for first, last in _stretches(weights, run.envelope):
        Q = run.envelope[first] ** 2 * (model.Q - model.Q_input) + model.Q_input
        weight = weights[first]
        H = model.H * (weight > 0)[:, None]
        noise = R / np.where(weight > 0, weight, 1.0)
        added = np.diag(noise)
        t = first
        while t < last:
            PH = P @ H.T
            S = H @ PH + added
            inverse = np.linalg.inv(S)
            K = A @ PH @ inverse
            F = A - K @ H
            gains.append(_Gain(A, P[lower], H, inverse, K, np.sqrt(S.diagonal())))
            which[t] = len(gains) - 1
            following = F @ P @ A.T + Q
            following = 0.5 * (following + following.T)
            was, now = P.diagonal(), following.diagonal()
            settled = bool(np.all(np.abs(now - was) <= SETTLED * now))
            P = following
            t += 1
            passed = t - first
            if not settled and passed >= LEAST_TRANSIENT and last - t > LEAST_TRANSIENT:
                if passed == LEAST_TRANSIENT:
                    limit = settled_covariance(dataclasses.replace(model, H=H, R=noise, Q=Q))
                if passed == MOST_TRANSIENT or _near(P.diagonal(), limit.diagonal()):
                    # The remaining change is slow and small; the filter is at its limit from here on.
                    P = limit
            elif settled:
                which[t:last] = len(gains) - 1
                t = last
    return gains, which


def _near(variances: Floats, limits: Floats) -> bool:
    """Return whether all variances are close to their limits."""
    return bool(np.all(np.abs(variances - limits) <= NEAR_LIMIT * limits))


def _constant(which: Ints) -> Iterator[tuple[int, int, int]]:
    """Find the beginning, end and gain of each segment with constant gain; long segments are split."""
    edges = {0, *(np.flatnonzero(np.diff(which)) + 1).tolist(), *range(0, len(which), SWEPT_AT_ONCE), len(which)}
    for first, last in pairwise(sorted(edges)):
        yield first, last, int(which[first])


def _sweeps(model: Dynamics, run: Observed, gains: list[_Gain], which: Ints, weights: Floats) -> tuple[Floats, Floats]:
    """Compute smoothed states and innovations in standard deviations: one sweep forward, one back."""
    y = np.nan_to_num(run.measured) - model.shown(run.excitation)
    y = np.where(weights > 0, y, 0.0)
    signals = np.hstack([y, steps_of(run.excitation)])
    # The prediction; the backward sweep adds the information of later samples.
    states, e = np.empty((len(y), len(model.A))), np.empty_like(y)
    innovations = np.empty_like(y)
    stretches = list(_constant(which))
    x = np.zeros(len(model.A))
    for first, last, at in stretches:
        gain, part = gains[at], slice(first, last)
        F, B = gain.transition, np.vstack([gain.K.T, model.before, model.after])
        states[part] = recursion(F, B, signals[part], x)
        x = F @ states[last - 1] + signals[last - 1] @ B
        e[part] = y[part] - states[part] @ gain.H.T
        innovations[part] = e[part] / gain.innovation_std
    r = np.zeros(len(model.A))
    for first, last, at in reversed(stretches):
        gain = gains[at]
        pulls = backward_pass(gain.transition, gain.inverse_S @ gain.H, e[first:last], r)
        states[first:last] += pulls @ gain.P
        r = pulls[0]
    return states, np.where(weights > 0, innovations, np.nan)


def backward_pass(F: Floats, B: Floats, e: Floats, r: Floats) -> Floats:
    """Solve r_(t-1) = H' S^-1 e_t + F' r_t backward over a segment, shape (samples, n).

    Parameters
    ----------
    B : ndarray, shape (m, n)
        S^-1 H.
    r : ndarray, shape (n,)
        Value after the segment.
    """
    return recursion(F.T, B, np.concatenate([e[::-1], np.zeros((1, e.shape[1]))]), r)[:0:-1]


def _deviations(rows: Floats, gains: list[_Gain], which: Ints) -> Floats:
    """Compute standard deviations of smoothed outputs: P - P N P with N = H' S^-1 H + F' N F, backward."""
    n = len(gains[0].A)
    N = np.zeros((n, n))
    result = np.empty((len(which), len(rows)))
    if not len(rows):
        return result
    for first, last, at in reversed(list(_constant(which))):
        gain = gains[at]
        F = gain.transition
        own = gain.H.T @ gain.inverse_S @ gain.H
        P = gain.P
        spread = rows @ P
        plain = np.sum(spread * rows, axis=1)
        scale = np.sqrt(np.maximum(np.diag(P), 1e-300))
        t, limit = last - 1, None
        while t >= first:
            following = own + F.T @ N @ F
            change = np.max(np.abs(following.diagonal() - N.diagonal()) * scale**2)
            N = 0.5 * (following + following.T)
            variance = plain - np.sum((spread @ N) * spread, axis=1)
            result[t] = np.sqrt(np.maximum(variance, 0.0))
            t -= 1
            passed = last - 1 - t
            if passed == LEAST_TRANSIENT and t - first > LEAST_TRANSIENT:
                limit = doubled(F.T, own)
            if limit is not None and (passed == MOST_TRANSIENT or _near(N.diagonal(), limit.diagonal())):
                # The covariance is settled from here back to the beginning of the segment.
                N, change = limit, 0.0
                variance = plain - np.sum((spread @ N) * spread, axis=1)
                result[t + 1] = np.sqrt(np.maximum(variance, 0.0))
            if change <= SETTLED:
                result[first : t + 1] = result[t + 1]
                t = first - 1
    return result


@dataclass(frozen=True, eq=False)
class Steady:
    """The smoother of a model with constant noise and sensors; it is exact except near the ends of a record.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the predicted state.
    S : ndarray, shape (m, m)
        Covariance of the innovations.
    K, F : ndarray, shapes (n, m) and (n, n)
        Gain, and A - K H.
    """

    model: Dynamics
    P: Floats
    S: Floats
    K: Floats
    F: Floats

    @staticmethod
    def of(model: Dynamics) -> Steady:
        """Settle the filter of a model."""
        P = settled_covariance(model)
        PH = P @ model.H.T
        S = model.H @ PH + np.diag(model.R)
        K = np.linalg.solve(S, (model.A @ PH).T).T
        F: Floats = model.A - K @ model.H
        return Steady(model, P, np.asarray(S), np.asarray(K, dtype=np.float64), F)

    @property
    def pull(self) -> Floats:
        """Matrix S^-1 H, shape (m, n)."""
        return np.asarray(np.linalg.solve(self.S, self.model.H), dtype=np.float64)

    def predicted(self, excitation: Floats, y: Floats, start: Floats) -> tuple[Floats, Floats]:
        """Compute the states predicted from the past, shape (samples, n), and the innovations, shape (samples, m)."""
        model = self.model
        seen = y - model.shown(excitation)
        B = np.vstack([self.K.T, model.before, model.after])
        x = recursion(self.F, B, np.hstack([seen, steps_of(excitation)]), start)
        return x, seen - x @ model.H.T


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
    pieces = [
        (slice(first, min(first + SWEPT_AT_ONCE, part.stop)), channels)
        for part, channels in pieces
        for first in range(part.start, part.stop, SWEPT_AT_ONCE)
    ]
    filters = {channels.tobytes(): Steady.of(model.seen_by(channels)) for _, channels in pieces}
    x = np.empty((len(y), len(model.A)))
    left = []
    for part, channels in pieces:
        # This filter predicts the first sample of the next piece.
        reached = slice(part.start, part.stop + 1)
        states, e = filters[channels.tobytes()].predicted(excitation[reached], y[reached][:, channels], start)
        length = part.stop - part.start
        x[part], start = states[:length], states[-1]
        left.append(e[:length])
    r = np.zeros(len(model.A))
    for (part, channels), e in zip(reversed(pieces), reversed(left), strict=True):
        own = filters[channels.tobytes()]
        pulls = backward_pass(own.F, own.pull, e, r)
        x[part] += pulls @ own.P
        r = pulls[0]
    return x


def settled_slopes(
    own: Steady, rates: Mapping[str, Floats], excitation: Floats, y: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Compute the smoothed states of a settled filter, and their derivatives along some directions of the model.

    States x and multipliers r solve x+ = A x + driven + Q r+ and r = A' r+ + H' R^-1 (y - D p - H x). This system is
    linear in both, so their derivatives solve the same system with other right-hand sides and the same gain.

    Parameters
    ----------
    rates : mapping of str to ndarray
        Derivatives of the matrices by their names, for the sensors that recorded; R stays constant.
    excitation, y, start
        As for `settled_states`, for the sensors that recorded.

    Returns
    -------
    ndarray, shape (samples, n)
    ndarray, shape (samples, directions, n)
    """
    model, F, steps = own.model, own.F, steps_of(excitation)
    x, e = own.predicted(excitation, y, start)
    B = own.pull
    multipliers = np.concatenate([backward_pass(F, B, e, np.zeros(len(F))), np.zeros((1, len(F)))])
    x += multipliers[:-1] @ own.P
    r = multipliers[1:]
    left = (y - model.shown(excitation) - x @ model.H.T) / model.R
    dA, dH, direct = rates["A"], rates["H"], rates["direct"]
    weighted, shape = model.H / model.R[:, None], (len(x), len(dA), len(F))
    forward = [dA.swapaxes(1, 2), rates["Q"], rates["before"][:, None], rates["after"][:, None]]
    dx = np.hstack([x, r, steps]) @ np.concatenate(forward, axis=1).swapaxes(0, 1).reshape(-1, len(dA) * len(F))
    back = [dA, dH, -dH.swapaxes(1, 2) @ weighted, -direct[:, None] @ weighted]
    signals = np.hstack([r, left, x, excitation[:, 1:]])
    dr = signals @ np.concatenate(back, axis=1).swapaxes(0, 1).reshape(-1, len(dA) * len(F))
    # Forward over the samples, then back, all directions in parallel.
    dx, dr = dx.reshape(-1, len(F)), dr.reshape(-1, len(F))
    dx += dr @ (F @ own.P).T
    dr -= dr @ own.P @ model.H.T @ B
    state = np.zeros(shape[1:])
    for row in dx.reshape(shape):
        state, row[...] = state @ F.T + row, state
    dr -= dx @ model.H.T @ B
    state = np.zeros_like(state)
    for row in dr.reshape(shape)[::-1]:
        state = state @ F + row
        row[...] = state
    dx += dr @ own.P
    return x, dx.reshape(shape)
