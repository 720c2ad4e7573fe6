"""Two-stage and one-shot methods in closed form for many complete measurements at once, one sample per row.

Both methods use normal matrices, which do not need one row per pair of modes (`programs.orthogonality`). A normal
matrix has the squared condition number; this costs no visible accuracy for frames of a few stories. `identify` keeps
the rows.
"""

from dataclasses import dataclass

import numpy as np

from cvxshear.fit.paper_methods import MOST_ITERATIONS, TOLERANCE
from cvxshear.model import transformation
from cvxshear.programs.pair_rows import pair_normal
from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Batch:
    """Floor masses and story stiffnesses of S samples.

    Parameters
    ----------
    floor_mass, story_stiffness : ndarray, shape (S, N)
        kg and N/m; nan for samples that are not `positive`.
    iterations : ndarray of int, shape (S,)
    positive : ndarray of bool, shape (S,)
        Whether all masses, in each iteration, and all stiffnesses are positive. Otherwise a bound is active in
        `identify`, and the closed form differs from its answer.
    """

    floor_mass: Floats
    story_stiffness: Floats
    iterations: Ints
    positive: Bools


def two_stage_batch(
    mode_shapes: Floats, frequencies: Floats, total_mass: float, initial_mass: Floats | None = None
) -> Batch:
    """Apply the paper's method (Eqs. 3-15 and 20-24) to S complete measurements of one configuration.

    Parameters
    ----------
    mode_shapes : ndarray, shape (S, N, N)
        One row per mode, of any scale.
    frequencies : ndarray, shape (S, N)
        Hz.
    total_mass : float
        kg.
    initial_mass : ndarray, shape (N,), optional
        By default, the total spread evenly.
    """
    samples, n, _ = mode_shapes.shape
    shapes = mode_shapes.transpose(0, 2, 1)
    start = np.full(n, total_mass / n) if initial_mass is None else np.asarray(initial_mass, dtype=float)
    mass = np.tile(start, (samples, 1))
    iterations = np.zeros(samples, dtype=np.int64)
    going = np.arange(samples)
    for _ in range(MOST_ITERATIONS):
        dm = _corrections(shapes[going], mass[going], total_mass)
        mass[going] += dm
        iterations[going] += 1
        settled = np.max(np.abs(dm), axis=1) < TOLERANCE * np.max(np.abs(mass[going]), axis=1)
        # Eq. 3 needs positive masses: samples with other masses are given up.
        going = going[~settled & (mass[going] > 0).all(axis=1)]
        if not len(going):
            break
    return _finished(shapes, frequencies, mass, iterations)


def one_shot_batch(mode_shapes: Floats, frequencies: Floats, total_mass: float) -> Batch:
    """Compute masses from the modes' orthogonality and the total, stiffnesses from Eq. 24, on S measurements.

    Parameters
    ----------
    mode_shapes : ndarray, shape (S, N, N)
        One row per mode, of any scale.
    frequencies : ndarray, shape (S, N)
        Hz.
    total_mass : float
        kg.
    """
    shapes = mode_shapes.transpose(0, 2, 1)
    unit = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    normal = pair_normal(unit, diagonal=False)
    mass = _held_to_sum(normal, np.zeros(normal.shape[:2]), total_mass)
    return _finished(shapes, frequencies, mass, np.ones(len(shapes), dtype=np.int64))


def _normalized(shapes: Floats, mass: Floats) -> Floats:
    """Normalize the shapes by Eq. 3, shape (S, N, N)."""
    return np.asarray(shapes / np.sqrt(np.sum(shapes**2 * mass[:, :, None], axis=1, keepdims=True)))


def _corrections(shapes: Floats, mass: Floats, total: float) -> Floats:
    """Compute dm of Eq. 14, shape (S, N)."""
    P = _normalized(shapes, mass)
    normal = pair_normal(P)
    side = np.sum(P**2, axis=2) - (normal @ mass[:, :, None])[:, :, 0]
    return _held_to_sum(normal, side, total - mass.sum(axis=1))


def _held_to_sum(normal: Floats, side: Floats, total: float | Floats) -> Floats:
    """Minimize x' normal x / 2 - side' x with sum x = total: the system of Eq. 14, shape (S, N)."""
    samples, n, _ = normal.shape
    # The row of ones is scaled to the matrix, so that it does not determine the pivots.
    scale = np.trace(normal, axis1=1, axis2=2) / n
    system = np.zeros((samples, n + 1, n + 1))
    system[:, :n, :n] = normal
    system[:, :n, n] = system[:, n, :n] = scale[:, None]
    right = np.concatenate([side, (scale * total)[:, None]], axis=1)
    return np.asarray(np.linalg.solve(system, right[:, :, None])[:, :n, 0])


def _finished(shapes: Floats, frequencies: Floats, mass: Floats, iterations: Ints) -> Batch:
    """Apply Eq. 24 to the samples with positive masses."""
    stiffness = np.full(mass.shape, np.nan)
    positive: Bools = np.asarray((mass > 0).all(axis=1))
    X = transformation(mass.shape[1]).T @ _normalized(shapes[positive], mass[positive])
    side = np.sum(X**2 * ((2 * np.pi * frequencies[positive]) ** 2)[:, None, :], axis=2)
    stiffness[positive] = np.linalg.solve(pair_normal(X), side[:, :, None])[:, :, 0]
    positive &= (stiffness > 0).all(axis=1)
    return Batch(
        np.where(positive[:, None], mass, np.nan), np.where(positive[:, None], stiffness, np.nan), iterations, positive
    )
