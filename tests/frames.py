"""Make exact and noisy experiments on shear frames with an eigenvalue solver alone."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"


def _measured(path: Path) -> bool:
    return "configuration" in tomllib.loads(path.read_text(encoding="utf-8"))


MEASURED = [path for path in sorted(EXAMPLES.glob("*.toml")) if _measured(path)]
"""Examples that are measurement files: they have a [[configuration]]."""

DESIGNS = [path for path in sorted(EXAMPLES.glob("*.toml")) if not _measured(path)]
"""Other examples: design values, before any test."""


def shared(*parts: str) -> Path:
    """Return a file or folder of the measured data beside the project; skip the test if it is missing."""
    folder = Path(os.environ.get("CVXSHEAR_SHARED", ROOT.parent / "shared")).joinpath(*parts)
    if not folder.exists():
        pytest.skip(f"measured data beside the project (CVXSHEAR_SHARED): {Path(*parts)} is not there")
    return folder


def chain(mass, stiffness):
    """Return mass and stiffness matrices of a chain of masses on springs, entry by entry."""
    n = len(mass)
    K = np.zeros((n, n))
    for i in range(n):
        K[i, i] = stiffness[i] + (stiffness[i + 1] if i + 1 < n else 0.0)
        if i + 1 < n:
            K[i, i + 1] = K[i + 1, i] = -stiffness[i + 1]
    return np.diag(np.asarray(mass, dtype=float)), K


def modes_of(mass, stiffness):
    """Return frequencies in Hz, and shapes with one row per mode, largest entry 1."""
    M, K = chain(mass, stiffness)
    eigenvalues, shapes = linalg.eigh(K, M)
    rows = shapes.T
    rows = rows / rows[np.arange(len(rows)), np.argmax(np.abs(rows), axis=1)][:, None]
    return np.sqrt(eigenvalues) / (2 * np.pi), rows


def configuration(mass, stiffness, added=None, *, rng=None, shape_noise=0.0, frequency_noise=0.0, **keys):
    """Return a [[configuration]] table: exact, or with additive shape noise and relative frequency noise."""
    added = np.zeros(len(mass)) if added is None else np.asarray(added, dtype=float)
    frequencies, shapes = modes_of(np.asarray(mass) + added, stiffness)
    if rng is not None:
        frequencies = frequencies * (1 + frequency_noise * rng.standard_normal(len(frequencies)))
        shapes = shapes + shape_noise * rng.standard_normal(shapes.shape)
    modes = keys.pop("modes", list(range(1, len(mass) + 1)))
    floors = keys.pop("measured_floors", list(range(1, len(mass) + 1)))
    at = np.ix_(np.array(modes) - 1, np.array(floors) - 1)
    return {
        "added_mass": added.tolist(),
        "frequencies": frequencies[np.array(modes) - 1].tolist(),
        "modes": list(modes),
        "measured_floors": list(floors),
        "mode_shapes": shapes[at].tolist(),
        "frequency_std": 0.001,
        "mode_shape_std": 0.01,
        **keys,
    }


def experiment(mass, stiffness, *configurations, frame=None, prior=()):
    """Return the dict of a measurement file; the total mass is declared unless `frame` replaces it."""
    table = {"total_mass": float(np.sum(mass))} if frame is None else frame
    named = [
        {"name": f"test {i}", **each} for i, each in enumerate(configurations or [configuration(mass, stiffness)], 1)
    ]
    return {"frame": {"stories": len(mass), **table}, "configuration": named, "prior": list(prior)}
