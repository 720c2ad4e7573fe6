"""Measure the cost of closing the loop: `python -m tests.studies loops [NAME ...]`.

A drawn frame has three tests: bare, with known added mass, and as found later. Each test measures shapes at every
floor. In the later state the second story has 15 % less stiffness, except in sound frames. Frames with a wall have a
flexural cantilever beside them, and the later state is as before. Times are processor times, in units of 60 symmetric
eigenproblems of size 200 in the same run. Each frame has a process of its own, so the peak of memory is its own.
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear import close_loop
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.util import errors
from tests.studies.timing import fastest, table

MODES = 8
"""Largest number of measured modes."""

HEIGHT = 3.0
"""Height of a story, m."""

CASES = {
    "3 stories": {"stories": 3},
    "8 stories": {"stories": 8},
    "8 stories, wall": {"stories": 8, "change": 0.0, "wall": True},
    "20 stories, sound": {"stories": 20, "change": 0.0},
    "20 stories": {"stories": 20},
    "20 stories, wall": {"stories": 20, "change": 0.0, "wall": True},
    "40 stories": {"stories": 40},
    "80 stories": {"stories": 80},
    "2,000 stories": {"stories": 2000},
    "Los Alamos": "los-alamos",
}


def measured(stories: int, seed: int = 1, *, change: float = 0.15, wall: bool = False) -> dict:
    """Return a measurement file of three tests, with noise of 0.1 % (frequencies) and 1 % (shapes)."""
    rng = np.random.default_rng(seed)
    mass, stiffness = rng.uniform(9.0, 11.0, stories), np.linspace(1.2, 0.8, stories) * 2e4
    load, softer = np.zeros(stories), stiffness.copy()
    load[[stories // 2, -1]] = 3.0
    softer[1] *= 1.0 - change
    beside = cantilever(stiffness) if wall else 0.0
    tables = []
    none = np.zeros(stories)
    states = [("bare", "before", none, stiffness), ("loaded", "before", load, stiffness)]
    states.append(("after", "after", none, softer))
    for name, state, added, k in states:
        found = modes(mass_matrix(mass + added), stiffness_matrix(k) + beside)
        count = min(stories, MODES)
        shapes = found.shapes[:count] / np.max(np.abs(found.shapes[:count]), axis=1, keepdims=True)
        tables.append(
            {
                "name": name,
                "state": state,
                "added_mass": added.tolist(),
                "frequencies": (found.frequencies[:count] * np.exp(0.001 * rng.standard_normal(count))).tolist(),
                "mode_shapes": (shapes + 0.01 * rng.standard_normal(shapes.shape)).tolist(),
                "frequency_std": 0.001,
                "mode_shape_std": 0.01,
            }
        )
    frame = {"total_mass": float(mass.sum()), "reference": "before"}
    return {"frame": frame | ({"story_heights": HEIGHT} if wall else {}), "configuration": tables}


def cantilever(stiffness: np.ndarray) -> np.ndarray:
    """Return the stiffness matrix of a wall of lambda H = 3 beside these stories."""
    z = HEIGHT * np.arange(1, len(stiffness) + 1)
    low, high = np.minimum.outer(z, z), np.maximum.outer(z, z)
    bending = np.mean(stiffness * HEIGHT) * (z[-1] / 3.0) ** 2
    return bending * np.linalg.inv(low**2 * (3.0 * high - low) / 6.0)


def run(name: str) -> None:
    """Print the processor seconds, peak memory and outcome of one frame, separated by tabs."""
    case = CASES[name]
    given = case if isinstance(case, str) else measured(**case)
    began = time.process_time()
    try:
        found = close_loop(given)
    except errors.InputError as error:
        outcome = f"refused: {error}"
    else:
        said = ", ".join(f"{item.placed.label} ({item.probability:.1%})" for item in found.effects)
        outcome = f"{found.fits}\t{found.verdict}: {said or 'nothing added'}"
    seconds = time.process_time() - began
    lines = Path("/proc/self/status").read_text().splitlines()
    peak = next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
    print(seconds, peak, outcome, sep="\t")


def main(names: Sequence[str] = ()) -> None:
    """Print the processor time in units and the peak memory of these cases; by default of all."""
    matrices = np.random.default_rng(0).standard_normal((60, 200, 200))
    unit, _ = fastest(lambda: np.linalg.eigh(matrices + matrices.swapaxes(1, 2)), 3, time.process_time)
    rows = []
    for name in names or CASES:
        program = f"from tests.studies.loops import run; run({name!r})"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
        seconds, peak, *outcome = done.strip().split("\t")
        rows.append([name, f"{float(seconds) / unit:.1f}", f"{float(peak):.0f} MB", *outcome])
    table(f"Closing the loop; the unit is {unit:.2f} s", ["frame", "units", "memory", "fits", "outcome"], rows)


if __name__ == "__main__":
    main(sys.argv[1:])
