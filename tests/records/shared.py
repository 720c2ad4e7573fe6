"""Provide records for the tests: locations of the measured records, and small synthetic ones."""

import os
from pathlib import Path

import numpy as np
import pytest

DATA = Path(os.environ.get("CVXSHEAR_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "data"
SEEDS = int(os.environ.get("CVXSHEAR_SEEDS", "2"))
"""Number of simulated records per test; `python -m tests.studies records` uses twenty."""

needs_mini_table = pytest.mark.skipif(
    not (DATA / "mini-shake-table").is_dir(),
    reason="measured data beside the project (CVXSHEAR_SHARED): no records here",
)
needs_southampton = pytest.mark.skipif(
    not (DATA / "southampton").is_dir(), reason="measured data beside the project (CVXSHEAR_SHARED): no functions here"
)


def channels(*columns: str, first: int = 1) -> str:
    """Return the tables of a record file's channels, one on each floor from `first` up."""
    return "".join(
        f'\n[[channel]]\ncolumn = "{column}"\nfloor = {floor}\n' for floor, column in enumerate(columns, first)
    )


MINI_TABLE = """
[record]
name = "{name}"
input = "base"
file = "{file}"
""" + channels("ground_x", "floor1_x", "floor2_x", "floor3_x", first=0)

SOUTHAMPTON = """
[record]
name = "southampton"
kind = "frf"
{more}
""" + channels("floor1", "floor2", "floor3") + "".join(
    f'\n[[run]]\nfile = "{{folder}}/set-{floor}.csv"\ninput_floor = {floor}\n' for floor in (1, 2, 3)
)  # fmt: skip

# Masses 2, 1 kg; stiffnesses 4000, 1500 N/m. K = [[5500, -1500], [-1500, 1500]], M = diag(2, 1):
# det(K - w2 M) = 2 w2^2 - 8500 w2 + 6e6 = 0.
TWO_STORY_SQUARES = np.array([8500 - np.sqrt(8500**2 - 48e6), 8500 + np.sqrt(8500**2 - 48e6)]) / 4
TWO_STORY_FREQUENCIES = np.sqrt(TWO_STORY_SQUARES) / (2 * np.pi)
TWO_STORY_RATIOS = (1500 - TWO_STORY_SQUARES) / 1500
"""Ratios phi_1 / phi_2 of each mode, from the second row."""


def mini_table(folder: Path, name: str) -> Path:
    """Write a record file for one of the mini table's records."""
    path = folder / f"{name}.toml"
    source = (DATA / "mini-shake-table" / f"{name}.csv").resolve()
    path.write_text(MINI_TABLE.format(name=name, file=source))
    return path


def southampton(folder: Path, more: str = "") -> Path:
    """Write a record file for the three measured sets of functions."""
    path = folder / "southampton.toml"
    path.write_text(SOUTHAMPTON.format(folder=(DATA / "southampton").resolve(), more=more))
    return path


def two_story_frf(frequencies: np.ndarray, damping: float, floor: int) -> np.ndarray:
    """Return the two-story frame's accelerance from its dynamic stiffness, without modes, shape (lines, 2)."""
    mass = np.diag([2.0, 1.0])
    stiffness = np.array([[5500.0, -1500.0], [-1500.0, 1500.0]])
    # At resonance, hysteretic damping equals viscous damping of half the loss factor.
    complex_stiffness = stiffness * (1 + 2j * damping)
    force = np.eye(2)[floor - 1]
    omega = 2 * np.pi * frequencies
    return np.array([-(w**2) * np.linalg.solve(complex_stiffness - w**2 * mass, force) for w in omega])


def csv(path: Path, names: list[str], values: np.ndarray) -> Path:
    """Write columns as delimited text."""
    np.savetxt(path, values, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path
