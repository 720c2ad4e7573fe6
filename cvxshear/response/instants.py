"""At which samples of a record the peaks of many similar frames can be.

The response z(s, t) of a mode is an entire function of its pole s. Around the middle of the poles of one mode in all
frames, with u = (s - c) / rho, it is c_0(t) + c_1(t) u + c_2(t) u^2 and so on, and on the circle |u| = 1 the rest of
the series is largest (the maximum principle). So a few filters a mode bound how far any frame is from the middle one at
any time, which leaves few samples for a peak of each quantity; and at these, a few terms tell a peak of each frame but
for a small known error, which leaves hardly more samples than there are peaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cvxshear.response.family import Family
from cvxshear.response.hold import held
from cvxshear.response.poles import Complexes
from cvxshear.util.typing import Floats, Ints

Singles = NDArray[np.float32]

TERMS = 4
"""Of the series, the constant one included, on narrow circles; twice as many on wide ones. Points: twice the terms."""

WIDE = 0.5
"""Radius of a circle over its distance from the imaginary axis, beyond which responses do not die away."""

MARGIN = 1.1
"""On the maximum over the points of a circle, for what lies between them."""

TOPS = 4
"""Samples of each quantity's largest values in the middle frame, at which all frames are looked at first."""

NEGLIGIBLE = 2e-4
"""Of a quantity's peak: terms that are counted as error."""

ROUNDING = 1e-5
"""Relative error of sums in single precision."""


@dataclass(frozen=True, eq=False)
class _Circles:
    """Modal responses around the middle of all frames.

    Parameters
    ----------
    u : ndarray of complex, shape (S, N)
        Place of each frame's pole within the circle.
    terms : int
    nodes : ndarray of complex, shape (N, m, samples)
        Responses of the points of the circles.
    middle : ndarray of complex, shape (N, samples)
    reach : ndarray, shape (N, samples)
        Largest difference of any frame from the middle.
    """

    u: Complexes
    terms: int
    nodes: Complexes
    middle: Complexes
    reach: Floats

    @property
    def mode(self) -> Ints:
        """Of each term of the series, real parts and imaginary ones, shape (N 2 terms,)."""
        return np.repeat(np.arange(len(self.middle)), 2 * self.terms)

    @cached_property
    def inside(self) -> Floats:
        """Bound of the rest of the series for each frame over that on the circle (Schwarz's lemma), shape (S,)."""
        largest: Floats = np.abs(self.u).max(axis=1)
        return largest**self.terms


@dataclass(frozen=True, eq=False)
class _Share:
    """Size of each mode in each quantity over all frames, shape (2 N, N): the middle, and how far any is from it."""

    middle: Complexes
    spread: Floats

    @property
    def largest(self) -> Floats:
        return np.abs(self.middle) + self.spread


def possible_instants(family: Family, excitation: Floats, step: float) -> list[Ints] | None:
    """The samples at which some frame can have its peak, for each quantity.

    Parameters
    ----------
    family : Family
    excitation : ndarray, shape (samples,)
        Base acceleration, m/s2.
    step : float
        s.

    Returns
    -------
    list of ndarray of int, or None
        One a quantity, ascending. None where the frames are too far apart for a common series.
    """
    circles = _circles(family.values, excitation, step)
    if circles is None:
        return None
    share = _share(family)
    parts = np.hstack([share.middle.real, -share.middle.imag])
    central = parts @ np.vstack([circles.middle.real, circles.middle.imag])
    away = share.largest @ circles.reach + share.spread @ np.abs(circles.middle)
    size = np.abs(central)
    tops = np.argpartition(size, -TOPS, axis=1)[:, -TOPS:]
    series = _Series.of(family, circles, share, np.unique(tops), size.max(axis=1))
    least = np.array([np.min(series.at_least(j, row)) for j, row in enumerate(tops)])
    up, down = central + away >= least[:, None], away - central >= least[:, None]
    series = series.moved(np.flatnonzero(np.any(up | down, axis=0)))
    return [series.peaks(j, np.flatnonzero(up[j]), np.flatnonzero(down[j])) for j in range(len(central))]


def _circles(s: Complexes, excitation: Floats, step: float) -> _Circles | None:
    """None where a response grows along the record at some point of a circle."""
    real, imaginary = (0.5 * (part.min(axis=0) + part.max(axis=0)) for part in (s.real, s.imag))
    centre: Complexes = real + 1j * imaginary
    radius = np.maximum(1.05 * np.abs(s - centre).max(axis=0), 1e-9 * np.abs(centre))
    if np.max(real + radius) * step * len(excitation) > 1.0:
        return None
    n, samples = s.shape[1], len(excitation)
    terms = TERMS if np.all(radius < -WIDE * real) else 2 * TERMS
    points = _points(2 * terms)
    nodes = np.empty((n, len(points), samples), dtype=np.complex128)
    middle, reach = np.empty((n, samples), dtype=np.complex128), np.empty((n, samples))
    # One mode after the other, so that what is at hand stays in the processor's cache.
    for mode in range(n):
        own = held(centre[mode] + radius[mode] * points, excitation, step)
        nodes[mode] = own
        middle[mode] = own.mean(axis=0)
        reach[mode] = _largest(own - middle[mode])
    return _Circles((s - centre) / radius, terms, nodes, middle, reach)


def _points(count: int) -> Complexes:
    angles = 2 * np.pi * np.arange(count) / count
    return np.cos(angles) + 1j * np.sin(angles)


def _largest(differences: Complexes) -> Floats:
    """Largest size over the points, with the margin; shape (..., m, n) to (..., n)."""
    squares: Floats = differences.real**2 + differences.imag**2
    largest: Floats = np.max(squares, axis=-2)
    return MARGIN * np.sqrt(largest)


def _share(family: Family) -> _Share:
    n = family.stories
    shape = family.shapes.mean(axis=1)
    shape_spread = np.maximum(family.shapes.max(axis=1) - shape, shape - family.shapes.min(axis=1))
    factor = family.factors.mean(axis=1)
    factor_spread = np.abs(family.factors - factor[:, None]).max(axis=1)
    factor, factor_spread = np.repeat(factor, n, axis=0), np.repeat(factor_spread, n, axis=0)
    spread = shape_spread * (np.abs(factor) + factor_spread) + np.abs(shape) * factor_spread
    return _Share(shape * factor, spread)


@dataclass(frozen=True, eq=False)
class _Series:
    """Quantities of all frames by a few terms of the series, in single precision, at some samples.

    Parameters
    ----------
    circles : _Circles
    share : _Share
    instants : ndarray of int, shape (n,)
    terms : ndarray, shape (N 2 terms, n)
        Real and negative imaginary parts of the coefficients, by mode.
    error : ndarray, shape (2 N, n)
        Of the missing terms.
    kept : list of ndarray of int
        Terms that count, one array a quantity.
    weights : list of ndarray, shape (kept, S)
        What the frames make of them.
    """

    circles: _Circles
    share: _Share
    instants: Ints
    terms: Singles
    error: Floats
    kept: list[Ints]
    weights: list[Singles]

    @staticmethod
    def of(family: Family, circles: _Circles, share: _Share, instants: Ints, size: Floats) -> _Series:
        """At given samples, for quantities whose peaks are about `size`."""
        terms, error = _terms(circles, share, instants)
        mode = circles.mode
        shapes = np.ascontiguousarray(np.swapaxes(family.shapes, 1, 2), dtype=np.float32)
        powers = [_weights(factor, circles) for factor in family.factors]
        kept, weights = [], []
        for j, sizes in enumerate(_sizes(circles, share, terms)):
            which = np.flatnonzero(sizes > NEGLIGIBLE * size[j])
            kept.append(which)
            weights.append(powers[j // family.stories][which] * shapes[j][mode[which]])
        return _Series(circles, share, instants, terms, error, kept, weights)

    def moved(self, instants: Ints) -> _Series:
        """The same at other samples."""
        terms, error = _terms(self.circles, self.share, instants)
        return _Series(self.circles, self.share, instants, terms, error, self.kept, self.weights)

    def at_least(self, j: int, instants: Ints) -> Floats:
        """What the peak of quantity j of each frame is at least, shape (S,)."""
        columns = np.searchsorted(self.instants, instants)
        values = np.abs(self.terms[np.ix_(self.kept[j], columns)].T @ self.weights[j]).max(axis=0)
        found: Floats = values * (1 - ROUNDING) - self._error(j, columns)
        return found

    def peaks(self, j: int, up: Ints, down: Ints) -> Ints:
        """The samples at which some frame can have its largest (among `up`) or least (`down`) value of quantity j."""
        columns = np.searchsorted(self.instants, np.concatenate([up, down]))
        terms = self.terms[np.ix_(self.kept[j], columns)]
        terms[:, len(up) :] *= -1
        values = terms.T @ self.weights[j]
        bound = values.max(axis=0) * (1 - 2 * ROUNDING) - 2 * self._error(j, columns)
        return np.unique(self.instants[columns[np.any(values >= bound, axis=1)]])

    def _error(self, j: int, columns: Ints) -> Singles:
        """Of the sum of the kept terms for each frame, shape (S,)."""
        return np.asarray(self.error[j, columns].max() * self.circles.inside + self._skipped[j], dtype=np.float32)

    @cached_property
    def _skipped(self) -> Floats:
        """Most that the terms not kept add up to, shape (2 N,)."""
        sizes = _sizes(self.circles, self.share, self.terms)
        for j, which in enumerate(self.kept):
            sizes[j, which] = 0.0
        total: Floats = sizes.sum(axis=1)
        return total


def _sizes(circles: _Circles, share: _Share, terms: Singles) -> Floats:
    """Largest size of each term in each quantity, shape (2 N, N 2 terms)."""
    sizes: Floats = share.largest[:, circles.mode] * np.abs(terms).max(axis=1)
    return sizes


def _terms(circles: _Circles, share: _Share, instants: Ints) -> tuple[Singles, Floats]:
    nodes = circles.nodes[:, :, instants]
    points = _points(nodes.shape[1])
    powers = points[:, None] ** np.arange(circles.terms)
    coefficients = powers.conj().T / len(points) @ nodes
    error = share.largest @ _largest(nodes - powers @ coefficients)
    parts = np.concatenate([coefficients.real, -coefficients.imag], axis=1)
    return parts.reshape(-1, len(instants)).astype(np.float32), error


def _weights(factor: Complexes, circles: _Circles) -> Singles:
    """Real and imaginary parts of factor u^k, shape (N 2 terms, S)."""
    u = circles.u.T
    parts = np.empty((len(u), 2, circles.terms, u.shape[1]), dtype=np.float32)
    power = factor.T
    for k in range(circles.terms):
        parts[:, 0, k], parts[:, 1, k] = power.real, power.imag
        power = power * u
    return parts.reshape(-1, u.shape[1])
