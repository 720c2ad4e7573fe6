"""The filter that predicts the sensors of a damped frame, and the smoother that finds its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cvxshear.response import state_space
from cvxshear.response.state_space import BLOCK, Dynamics
from cvxshear.util.typing import Bools, Floats

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
        for _ in range(state_space.MOST_DOUBLINGS):
            inner = np.linalg.inv(np.eye(n) + G @ P)
            more = power.T @ P @ inner @ power
            G = G + power @ inner @ G @ power.T
            power = power @ inner @ power
            P = P + more
            P, G = 0.5 * (P + P.T), 0.5 * (G + G.T)
            # Each round doubles the number of correct digits.
            if np.all(np.diag(more) ** 2 <= state_space.ROUNDING * np.diag(P) ** 2):
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
        x = state_space.recursion(self.F, B, np.hstack([seen, state_space.steps_of(excitation)]), start)
        return x, seen - x @ self.model.H.T

    def slopes(self, rates: dict[str, Floats]) -> tuple[Floats, Floats]:
        """Differentiate the gain, shape (r, n, m), and S, shape (r, m, m), of a settled filter.

        The derivative of P solves dP = F dP F' + G. The gain counts as constant there, because it is optimal.
        """
        model, K, F, P = self.model, self.K, self.F, self.P
        dA, dH, dR = rates["A"], rates["H"], rates["R"]
        turned = (dA - K @ dH) @ P @ F.T
        dP = state_space.doubled(F, turned + turned.swapaxes(1, 2) + (K * dR[:, None]) @ K.T + rates["Q"])
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
        As in `Dynamics`.
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
    weights : ndarray, shape (samples, m)
        Weights of the samples: 1, less for a spike, 0 if missing.
    output_std : ndarray, shape (samples, outputs)
        Standard deviations of the requested outputs, given the frame.
    completed : ndarray, shape (samples, m)
        The measured accelerations, spikes cut to Huber's limit and missing samples estimated. An ordinary
        smoother finds the same motion from them.
    """

    states: Floats
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
        states = _swept(stretches, run.excitation, measured, np.zeros(len(model.A)))
        fitted = states @ model.H.T + shown
        size = np.abs(measured - fitted) / np.sqrt(model.R)
        found = np.where(run.present, np.minimum(1.0, SPIKE / np.maximum(size, SPIKE)), 0.0)
        if np.max(np.abs(found - weights), initial=0.0) <= SAME_WEIGHT:
            break
        weights = found
    completed = fitted + weights * (measured - fitted)
    std = _deviations(rows, stretches, len(states))
    return Smoothed(states, weights, std, completed)


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


def _swept(stretches: Sequence[Stretch], excitation: Floats, y: Floats, start: Floats) -> Floats:
    """Compute the smoothed states: one sweep forward, one back."""
    states, e = np.empty((len(y), len(start))), np.empty_like(y)
    for first, last, here in stretches:
        # The filter predicts the first sample of the next segment, too.
        reached = slice(first, last + 1)
        own = np.where(here.model.H.any(axis=1), y[reached], here.model.shown(excitation[reached]))
        predicted, left = here.predicted(excitation[reached], own, start)
        if last == len(y):
            predicted, left = np.vstack([predicted, start]), np.vstack([left, left[-1]])
        states[first:last], start = predicted[: last - first], predicted[last - first]
        e[first:last] = left[: last - first]
    # The backward sweep adds the information of later samples: r_(t-1) = H' S^-1 e_t + F' r_t.
    r = np.zeros(len(start))
    for first, last, here in reversed(stretches):
        ahead = np.concatenate([e[first:last][::-1], np.zeros((1, e.shape[1]))])
        pulls = state_space.recursion(here.F.T, here.pull, ahead, r)[:0:-1]
        states[first:last] += pulls @ here.P
        r = pulls[0]
    return states


def _deviations(rows: Floats, stretches: Sequence[Stretch], samples: int) -> Floats:
    """Compute standard deviations of smoothed outputs: P - P N P with N = H' S^-1 H + F' N F, backward."""
    N: Floats = np.zeros_like(stretches[0][2].P)
    result = np.empty((samples, len(rows)))
    for first, last, here in reversed(stretches if len(rows) else ()):
        F, own, spread = here.F, here.model.H.T @ here.pull, rows @ here.P
        plain = np.sum(spread * rows, axis=1)
        limit = state_space.doubled(F.T, own) if last - first > BLOCK else None
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
    return _swept(stretches, excitation, y, start)
