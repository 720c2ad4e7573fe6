"""Measure the cost of closing the loop, and the share of the open classes: `python -m tests.studies loops`.

The frame has three tests: bare, with known added mass, and with 15 % less stiffness in the second story. Each test
measures shapes at every floor.
"""

import time

import numpy as np

from cvxshear import Experiment
from cvxshear.loop.close import search_for_effects
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from tests.studies.timing import table

SIZES = (3, 8, 20)
MODES = 8
"""Largest number of measured modes."""
WITHOUT_OPEN = [{"name": "open", "exclude": True}]


def measured(stories: int, seed: int = 1) -> dict:
    """Return a measurement file of three tests, with noise of 0.1 % (frequencies) and 1 % (shapes)."""
    rng = np.random.default_rng(seed)
    mass, stiffness = rng.uniform(9.0, 11.0, stories), np.linspace(1.2, 0.8, stories) * 2e4
    load, softer = np.zeros(stories), stiffness.copy()
    load[[stories // 2, -1]] = 3.0
    softer[1] *= 0.85
    tables = []
    none = np.zeros(stories)
    states = [("bare", "before", none, stiffness), ("loaded", "before", load, stiffness)]
    states.append(("after", "after", none, softer))
    for name, state, added, k in states:
        found = modes(mass_matrix(mass + added), stiffness_matrix(k))
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
    return {"frame": {"total_mass": float(mass.sum()), "reference": "before"}, "configuration": tables}


def main() -> None:
    """Print processor seconds with and without the open classes, and the numbers of fitted sets."""
    rows = []
    for stories in SIZES:
        declared = measured(stories)
        costs = []
        for given in (declared | {"effect": WITHOUT_OPEN}, declared):
            began = time.process_time()
            closure = search_for_effects(Experiment.from_dict(given))
            costs.append((time.process_time() - began, closure.fits))
        (plain, fits), (full, all_fits) = costs
        found = ", ".join(item.placed.label for item in closure.effects)
        rows.append([stories, f"{plain:.1f}", fits, f"{full:.1f}", all_fits, f"{full / plain:.2f}", found])
    head = ["stories", "without open classes", "fits", "with them", "fits", "times", "found"]
    table("Closing the loop, processor seconds", head, rows)
