"""z' = s z + p from rest, exact where p is a straight line between samples.

Over one step the solution is z(t + h) = e^(s h) z(t) + (f1 - f2) p(t) + f2 p(t + h) with

    f1 = (e^(s h) - 1) / s,   f2 = (e^(s h) - 1 - s h) / (s^2 h),

the first-order hold (for one oscillator: Nigam and Jennings, 1969): a linear filter of one pole.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

from cvxshear.response.poles import Complexes
from cvxshear.util.typing import Floats, Ints

SMALL = 0.1
"""|s h| below which the differences are taken from their series, before they cancel."""

TERMS = 12

LEAP = 32
"""Samples that `held_at` leaps over at once."""


def hold(s: Complexes, step: float) -> tuple[Complexes, Complexes, Complexes]:
    """e^(s h), and the weights of the sample now and of the one before.

    Parameters
    ----------
    s : ndarray of complex, any shape
        rad/s.
    step : float
        h, s.
    """
    x: Complexes = np.asarray(s * step, dtype=np.complex128)
    E: Complexes = np.exp(x)
    small = np.abs(x) < SMALL
    safe: Complexes = np.where(small, np.complex128(1.0), x)
    first: Complexes = (E - 1) / safe
    second: Complexes = (first - 1) / safe
    first[small], second[small] = _series(x[small], 1), _series(x[small], 2)
    now: Complexes = step * second
    before: Complexes = step * first - now
    return E, now, before


def _series(x: Complexes, order: int) -> Complexes:
    """(e^x - its Taylor polynomial below `order`) / x^order = sum of x^k / (k + order)!."""
    result = np.zeros_like(x)
    for k in reversed(range(TERMS)):
        # Horner: the coefficient of x^(k+1) is that of x^k over k + 1 + order.
        result = 1.0 + x / (k + 1 + order) * result
    return result / float(np.prod(np.arange(1, order + 1)))


def held(s: Complexes, p: Floats, step: float) -> Complexes:
    """z at every sample, for every pole.

    Parameters
    ----------
    s : ndarray of complex, shape (p,)
    p : ndarray, shape (samples,)
        A straight line between samples.
    step : float
        s.

    Returns
    -------
    ndarray of complex, shape (p, samples)
        Zero at the first sample.
    """
    E, now, before = hold(np.asarray(s), step)
    z = np.empty((len(E), len(p)), dtype=np.complex128)
    for row in range(len(E)):
        # The state before the first sample is such that the first output is zero: the frame is at rest.
        z[row], _ = signal.lfilter(
            [now[row], before[row]], [1.0, -E[row]], p, zi=np.array([-now[row] * p[0]])
        )  # fmt: skip
    return z


def held_at(s: Complexes, p: Floats, step: float, instants: Ints) -> Complexes:
    """z at a few samples, for many poles.

    With x = z - f2 p, x(t + h) = E x(t) + g p(t) and g = E f2 + f1 - f2, so that a leap of L samples takes x / g to
    E^L x / g plus the sum of E^(k-1) p(t - k h): one matrix product for all leaps of all poles.

    Parameters
    ----------
    s : ndarray of complex, shape (p,)
    p : ndarray, shape (samples,)
        A straight line between samples.
    step : float
        s.
    instants : ndarray of int, shape (n,)
        Ascending.

    Returns
    -------
    ndarray of complex, shape (n, p)
    """
    E, now, before = hold(np.asarray(s), step)
    gain = E * now + before
    powers = _powers(E, LEAP)
    block, inside = np.divmod(instants, LEAP)
    blocks = int(block[-1])
    ends = np.concatenate([LEAP * np.arange(1, blocks + 1), instants])
    lengths = np.concatenate([np.full(blocks, LEAP), inside])
    lags = np.arange(1, LEAP + 1)
    past = np.where(lags <= lengths[:, None], p[np.maximum(ends[:, None] - lags, 0)], 0.0)
    # What leads from x / g to z / g where z is wanted.
    present = np.concatenate([np.zeros(blocks), p[instants]])
    weights = np.vstack([powers[:LEAP], now / gain])
    # Real times complex: the parts of a complex number lie side by side.
    driven = (np.column_stack([past, present]) @ weights.view(np.float64)).view(np.complex128)
    x = np.empty((blocks + 1, len(E)), dtype=np.complex128)
    x[0] = -now / gain * p[0]
    for k in range(blocks):
        np.multiply(powers[LEAP], x[k], out=x[k + 1])
        x[k + 1] += driven[k]
    z = driven[blocks:]
    for i, k in enumerate(block):
        z[i] += powers[inside[i]] * x[k]
        z[i] *= gain
    return z


def _powers(E: Complexes, last: int) -> Complexes:
    """E^0 to E^last, shape (last + 1, p), by doubling."""
    result = np.ones((last + 1, len(E)), dtype=np.complex128)
    k = 1
    while k <= last:
        end = min(2 * k, last + 1)
        np.multiply(result[: end - k], result[k - 1] * E, out=result[k:end])
        k = end
    return result
