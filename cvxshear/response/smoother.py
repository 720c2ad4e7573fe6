"""The motion of a frame from the floors with sensors: a least-squares program solved by one sweep each way.

Over the states x_0, x_1, ... of `Dynamics`, the motion minimizes

    |P0^(-1/2) x_0|^2 + sum |Q^(-1/2) (x_(t+1) - A x_t - B p_t)|^2 + sum w_tj (y_tj - H_j x_t - D_j p_t)^2 / R_j.

The normal matrix is block tridiagonal. `smooth` eliminates the blocks forward (the Kalman filter) and back (the
smoother of Bryson and Frazier 1963, which needs no inverse of a covariance). A missing sample has the weight zero.
Iterative reweighting minimizes Huber's loss, which grows linearly beyond `SPIKE` standard deviations and limits the
influence of spikes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cvxshear.response.state_space import Dynamics, Filter, doubled, recursion
from cvxshear.util.typing import Bools, Floats

SPIKE = 5.0
"""Minimum residual of a spike, in standard deviations; Gaussian noise has one in two million samples."""

MOST_REWEIGHTINGS = 12
"""Maximum number of rounds of reweighting; each needs one sweep."""

SAME_WEIGHT = 0.02
"""Maximum change of a weight at convergence: a fiftieth of the sample's influence."""

TRANSIENT, NEAR_LIMIT = 100, 0.05
"""Samples with their own covariances after a change of the weights, and the relative difference of later variances from
their limits at which the limits replace them. The replacement saves time and memory."""


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


Stretch = tuple[int, int, Filter]
"""First sample of a segment, the sample after its end, and its filter."""


def smooth(model: Dynamics, run: Observed, rows: Floats) -> Smoothed:
    """Find the motion that minimizes this module's program, and standard deviations of rows times the states."""
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
    keys = np.column_stack([weights, run.envelope])
    edges = [0, *(np.flatnonzero(np.any(np.diff(keys, axis=0), axis=1)) + 1).tolist(), len(keys)]
    P, found = run.start_scale**2 * model.P0, []
    for first, last in pairwise(edges):
        own = model.weighted(weights[first], float(run.envelope[first]))
        limit = Filter.settled(own) if last - first > TRANSIENT else None
        t = first
        while t < last:
            settled = limit if limit and t - first >= TRANSIENT and _near(P, limit.P) else None
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
        limit = doubled(F.T, own) if last - first > TRANSIENT else None
        for t in range(last - 1, first - 1, -1):
            N = own + F.T @ N @ F
            N = 0.5 * (N + N.T)
            settled = limit is not None and last - t > TRANSIENT and _near(N, limit)
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
