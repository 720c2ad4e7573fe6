"""Folders of many tests, with and without trends: what `cvxshear.history` finds. `python -m tests.studies history`.

Each folder has 21 tests of one frame of four stories with other masses and stiffnesses, over three and a half years.
The temperature follows the seasons with scatter. Half of the folders have a step of 3 % in one story, a slope of 5 % in
another, and a stiffness that falls by 0.1 % per degree; the other half have none of them.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import cvxshear
from cvxshear.io.toml import write_measurement
from tests.frames import configuration

TESTS, STEP_AT = 21, 12
TRENDS = {"step": -0.03, "slope": -0.05, "by_degree": -0.001}
STORIES = {"step": 2, "slope": 3, "temperature": None}
"""Stories of the trends; the influence of temperature is that of all stories."""


def write_folder(path, seed, *, step=0.0, slope=0.0, by_degree=0.0, noise=0.002, stated=True):
    """Write the measurement files of one frame, and return its temperatures."""
    rng = np.random.default_rng(seed)
    mass, stiffness = rng.uniform(8.0, 14.0, 4), rng.uniform(20e3, 40e3, 4)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    temperature = 10.0 + 12.0 * np.sin(np.pi * np.arange(TESTS) / 3 + phase) + 3.0 * rng.standard_normal(TESTS)
    for at in range(TESTS):
        k = stiffness * (1.0 + by_degree * (temperature[at] - 10.0))
        k[STORIES["step"] - 1] *= 1.0 + (step if at >= STEP_AT else 0.0)
        k[STORIES["slope"] - 1] *= 1.0 + slope * at / (TESTS - 1)
        test = configuration(mass, k, rng=rng, shape_noise=5 * noise, frequency_noise=noise)
        stds = {"frequency_std": noise, "mode_shape_std": 5 * noise}
        test = {key: value for key, value in test.items() if key not in stds} | (stds if stated else {})
        test |= {"temperature": float(temperature[at]), "date": f"{2020 + at // 6}-{1 + at % 6 * 2:02d}-15"}
        test["damping_ratios"] = (0.01 * np.exp(0.1 * rng.standard_normal(4))).tolist()
        write_measurement(path / f"{at:02d}.toml", {"frame": {"total_mass": mass.sum()}, "configuration": [test]})
    return temperature


def main():
    """Print what was found in each folder, and the counts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folders", type=int, default=20)
    parser.add_argument("--unstated", action="store_true", help="the files state no standard deviations")
    given = parser.parse_args()
    for trends in (TRENDS, {}):
        named, false = dict.fromkeys(STORIES, 0), 0
        for seed in range(given.folders):
            with tempfile.TemporaryDirectory() as folder:
                write_folder(Path(folder), seed, **trends, stated=not given.unstated)
                found = cvxshear.history(folder)
            print(
                seed, found.loop.verdict, *(f"{each.text} ({each.probability:.3f})" for each in found.changes), sep="; "
            )
            for each in found.changes:
                right = bool(trends) and STORIES.get(each.kind, 0) == each.story
                named[each.kind] = named.get(each.kind, 0) + (right and each.probability >= 0.95)
                false += not right
        print(f"{given.folders} folders, {'with' if trends else 'without'} trends: {named}, {false} others", flush=True)


if __name__ == "__main__":
    main()
