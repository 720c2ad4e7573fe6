"""Peaks of many similar frames under one record, such as samples of an uncertain one, by matrix products.

The response z(s, t) of a mode to a given excitation is an entire function of its pole s. Over a disc that holds the
poles of one mode in all frames it is a polynomial of low degree: from its values at m points of the circle,

    z(s, t) = sum over k of w_k(s) z(s_k, t),   w_k = (u^m - 1) u_k / (m (u - u_k)),   u = (s - c) / rho,

so that a handful of filters a mode serve all frames. And only times are looked at that can hold a peak: on the circle
|z(s, t) - z(c, t)| has its maximum over the disc, which bounds how far any frame is from the middle one at any time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.modal.motion import Drive
from cvxshear.response.hold import held
from cvxshear.response.model import DampedModel, response
from cvxshear.response.poles import UNCOUPLED, Complexes
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.typing import Bools, Floats, Ints

FEWEST, MOST = 16, 64
"""Points on each circle."""

ACCURATE = 1e-6
"""Error of the interpolated response at the pole farthest out, relative to its peak; the peaks are as good."""

MARGIN = 1.1
"""On the maximum over the points of a circle, for what lies between them."""

TOPS = 4
"""Times of each quantity's largest values in the middle frame, at which all frames are looked at first."""

CHUNK = 64
"""Frames whose motion is held in memory at once."""


@dataclass(frozen=True, eq=False)
class _Family:
    """Real modes of many frames.

    Parameters
    ----------
    values : ndarray of complex, shape (S, N)
        One pole of each pair.
    table : ndarray of complex, shape (S, 2 N, N)
        Share of each mode's z in the accelerations and then in the drifts.
    """

    values: Complexes
    table: Complexes


def sample_peaks(
    frame: UncertainFrame, drive: Drive, step: float, samples: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Peaks of random frames of an uncertain one under a base motion, by which linear deviations are checked.

    Parameters
    ----------
    frame : UncertainFrame
    drive : Drive
        A base acceleration.
    step : float
        s.
    samples : int
    rng : numpy.random.Generator

    Returns
    -------
    acceleration, drift : ndarray, shape (samples, N)
        m/s2 and m.

    Raises
    ------
    InputError
        Where a frame drawn has no modes.
    """
    centre = frame.at(np.zeros(frame.size))
    drawn = [frame.at(rng.standard_normal(frame.size), centre).model for _ in range(samples)]
    M, C, K = (np.array([getattr(model, name) for model in drawn]) for name in ("M", "C", "K"))
    return batch_peaks(M, C, K, drive, step)


def batch_peaks(M: Floats, C: Floats, K: Floats, drive: Drive, step: float) -> tuple[Floats, Floats]:
    """Largest total accelerations and story drifts of many frames under one base motion.

    Frames whose damping couples their modes, and families too wide for a common polynomial, are taken one by one.

    Parameters
    ----------
    M, C, K : ndarray, shape (S, N, N)
        kg, N s/m, N/m.
    drive : Drive
        A base acceleration.
    step : float
        s.

    Returns
    -------
    acceleration, drift : ndarray, shape (S, N)
        m/s2 and m.
    """
    n = M.shape[1]
    family = _family(M, C, K)
    circles = None if family is None else _circles(family, drive.excitation, step)
    if family is None or circles is None:
        peaks = np.array([_one(*matrices, drive, step) for matrices in zip(M, C, K, strict=True)])
    else:
        peaks = _peaks(family, *circles)
    return peaks[:, :n], peaks[:, n:]


def _one(M: Floats, C: Floats, K: Floats, drive: Drive, step: float) -> Floats:
    found = response(DampedModel(M, C, K, np.ones(len(M))), drive, step)
    return np.concatenate([np.max(np.abs(found.acceleration), axis=0), np.max(np.abs(found.drift), axis=0)])


def _family(M: Floats, C: Floats, K: Floats) -> _Family | None:
    """Modes of all frames at once; None where damping couples or stops one."""
    half = np.linalg.inv(np.linalg.cholesky(M))
    turned = np.swapaxes(half, 1, 2)
    squares, vectors = np.linalg.eigh(half @ K @ turned)
    phi = turned @ vectors
    gamma = np.swapaxes(phi, 1, 2) @ C @ phi
    own = np.diagonal(gamma, axis1=1, axis2=2)
    coupling = np.abs(gamma - own[:, :, None] * np.eye(M.shape[1]))
    damped = squares - (own / 2) ** 2
    if np.any(damped <= 0) or np.any(coupling > UNCOUPLED * np.max(own, axis=1)[:, None, None]):
        return None
    swinging = np.sqrt(damped)
    values = -own / 2 + 1j * swinging
    # u = Re(2 phi (phi' b) / a z) with b = -M 1 and a = 2 i omega_d.
    share = phi * (-(phi * M.sum(axis=2)[:, :, None]).sum(axis=1) / (1j * swinging))[:, None, :]
    drift = np.diff(share, axis=1, prepend=0.0)
    return _Family(values, np.concatenate([share * values[:, None, :] ** 2, drift], axis=1))


def _circles(family: _Family, excitation: Floats, step: float) -> tuple[Complexes, Complexes] | None:
    """Weights of the points for every frame, shape (N, S, m), and their responses, shape (N, m, samples)."""
    s = family.values.T
    real, imaginary = (0.5 * (part.min(axis=1) + part.max(axis=1)) for part in (s.real, s.imag))
    centre = (real + 1j * imaginary)[:, None]
    radius = np.maximum(1.05 * np.abs(s - centre).max(axis=1), 1e-9 * np.abs(centre[:, 0]))[:, None]
    if np.max(centre.real + radius) * step * len(excitation) > 1.0:
        return None
    far = np.argmax(np.abs(s - centre), axis=1)
    modes = np.arange(len(s))
    exact = held(s[modes, far], excitation, step)
    size = np.max(np.abs(exact), axis=1)
    m = FEWEST
    while m <= MOST:
        points = np.exp(2j * np.pi * np.arange(m) / m)
        nodes = held((centre + radius * points).ravel(), excitation, step).reshape(len(s), m, -1)
        u = ((s - centre) / radius)[:, :, None]
        weights = (u**m - 1) * points / (m * (u - points))
        error = np.abs(np.einsum("jk,jkt->jt", weights[modes, far], nodes) - exact)
        if np.all(error.max(axis=1) <= ACCURATE * size):
            return weights, nodes
        m *= 2
    return None


def _peaks(family: _Family, weights: Complexes, nodes: Complexes) -> Floats:
    """The peaks of all frames, shape (S, 2 N)."""
    middle = nodes.mean(axis=1)
    table = family.table.mean(axis=0)
    central = np.abs((table @ middle).real)
    tops = np.unique(np.argpartition(central, -TOPS, axis=1)[:, -TOPS:])
    found = _largest(family, weights, nodes[:, :, tops])
    times = np.setdiff1d(_possible(family, table, middle, nodes, central, found.min(axis=0)), tops)
    return np.maximum(found, _largest(family, weights, nodes[:, :, times])) if times.size else found


def _possible(
    family: _Family, table: Complexes, middle: Complexes, nodes: Complexes, central: Floats, least: Floats
) -> Ints:
    """The samples at which some quantity of some frame can exceed the least of its peaks."""
    away = MARGIN * np.max(np.abs(nodes - middle[:, None, :]), axis=1)
    spread = np.max(np.abs(family.table - table), axis=0)
    bound = central + (np.abs(table) + spread) @ away + spread @ np.abs(middle)
    reached: Bools = np.any(bound >= least[:, None], axis=0)
    return np.flatnonzero(reached)


def _largest(family: _Family, weights: Complexes, nodes: Complexes) -> Floats:
    """Largest size of each quantity of each frame over the samples of `nodes`, shape (S, 2 N)."""
    result = []
    for first in range(0, len(family.values), CHUNK):
        part = slice(first, first + CHUNK)
        z = np.swapaxes(weights[:, part] @ nodes, 0, 1)
        table = family.table[part]
        moved = np.concatenate([table.real, -table.imag], axis=2) @ np.concatenate([z.real, z.imag], axis=1)
        result.append(np.maximum(moved.max(axis=2), -moved.min(axis=2)))
    return np.concatenate(result)
