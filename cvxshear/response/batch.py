"""Peaks of many similar frames under one record, such as samples of an uncertain one, by matrix products."""

from __future__ import annotations

import numpy as np

from cvxshear.records.motion import Drive
from cvxshear.response.family import Family
from cvxshear.response.hold import held_at
from cvxshear.response.instants import possible_instants
from cvxshear.response.model import DampedModel, response
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.util.typing import Floats, Ints

CHUNK = 64
"""Frames whose motion is held in memory at once."""


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

    Frames whose damping couples their modes, and those too far apart for a common series, are taken one by one.

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
    family = Family.of(M, C, K)
    instants = None if family is None else possible_instants(family, drive.excitation, step)
    if family is None or instants is None:
        peaks = np.array([_one(*matrices, drive, step) for matrices in zip(M, C, K, strict=True)])
    else:
        peaks = _peaks(family, drive.excitation, step, instants)
    return peaks[:, :n], peaks[:, n:]


def _one(M: Floats, C: Floats, K: Floats, drive: Drive, step: float) -> Floats:
    found = response(DampedModel(M, C, K, np.ones(len(M))), drive, step)
    return np.concatenate([np.max(np.abs(found.acceleration), axis=0), np.max(np.abs(found.drift), axis=0)])


def _peaks(family: Family, excitation: Floats, step: float, instants: list[Ints]) -> Floats:
    """Largest size of each quantity of each frame over its samples, shape (S, 2 N)."""
    n, every = family.stories, np.unique(np.concatenate(instants))
    places = [np.searchsorted(every, own) for own in instants]
    result = np.empty((len(family.values), 2 * n))
    for first in range(0, len(result), CHUNK):
        part = slice(first, first + CHUNK)
        z = held_at(family.values[part].ravel(), excitation, step, every)
        # Re(c z) is the scalar product of the parts of the conjugate of c with those of z.
        z_parts = z.view(np.float64).reshape(len(every), -1, 2 * n)
        table = family.shapes[:, part] * np.repeat(family.factors[:, part].conj(), n, axis=0)
        for j, (place, own) in enumerate(zip(places, table.view(np.float64), strict=True)):
            moved = np.einsum("tsm,sm->ts", z_parts[place], own)
            result[part, j] = np.abs(moved).max(axis=0)
    return result
