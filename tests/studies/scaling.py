"""Measure the growth of an identification's cost with the number of stories: time, iterations, digits, peak memory."""

import os
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from cvxshear import Experiment, identify
from cvxshear.measurement.experiment import Configuration, Frame
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.util.writing import json_text, write_file
from tests.studies.timing import fastest, shown, table

SIZES = (3, 10, 30, 100, 300, 1000)
RUNS = {"one-shot": {"method": "one-shot"}, "two-stage": {"method": "two-stage"}}
MEMORY = """
from pathlib import Path
from tests.studies.scaling import cost
cost({stories}, repeats=1, **{keys})
lines = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")))
"""
"""Program that prints Linux's peak memory of a new process; getrusage would include the parent process."""

SPREAD = 0.3
"""Largest relative deviation of masses and stiffnesses from their mean."""


@dataclass(frozen=True)
class Cost:
    """Cost of one identification from exact modes.

    Parameters
    ----------
    stories : int
    seconds : float
        The fastest of the repeats.
    iterations : int
    mass_error, stiffness_error : float
        Largest relative errors.
    """

    stories: int
    seconds: float
    iterations: int
    mass_error: float
    stiffness_error: float


def exact_experiment(stories: int, seed: int = 0) -> tuple[Experiment, np.ndarray, np.ndarray]:
    """Return a frame of uneven masses and stiffnesses with exact modes, its floor masses and its story stiffnesses.

    Parameters
    ----------
    stories : int
    seed : int, optional
    """
    rng = np.random.default_rng(seed)
    mass = 2e4 * rng.uniform(1 - SPREAD, 1 + SPREAD, stories)
    stiffness = 2e7 * stories * rng.uniform(1 - SPREAD, 1 + SPREAD, stories)
    found = modes(mass_matrix(mass), stiffness_matrix(stiffness))
    frame = Frame(stories=stories, total_mass=float(mass.sum()))
    return Experiment(frame, (Configuration(found.frequencies, found.shapes),)), mass, stiffness


def cost(stories: int, method: str, *, repeats: int = 3) -> Cost:
    """Identify one exact frame of this height.

    Parameters
    ----------
    stories : int
    method : str
        "two-stage" or "one-shot".
    repeats : int, optional
    """
    experiment, mass, stiffness = exact_experiment(stories)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        part = identify(experiment, method).parts[0]
        seconds.append(time.perf_counter() - began)
    return Cost(
        stories,
        min(seconds),
        part.iterations,
        float(np.max(np.abs(part.frame.floor_mass / mass - 1))),
        float(np.max(np.abs(part.frame.story_stiffness / stiffness - 1))),
    )


def exponent(costs: list[Cost]) -> float:
    """Return p of seconds ~ stories^p, by least squares in logarithms."""
    stories, seconds = (np.log([getattr(each, name) for each in costs]) for name in ("stories", "seconds"))
    return float(np.polyfit(stories, seconds, 1)[0])


def main():
    rows = []
    for name, keys in RUNS.items():
        costs = [cost(n, repeats=1 if n > 300 else 3, **keys) for n in SIZES]
        tall = [one for one in costs if one.stories >= 100]
        for one in costs:
            run = MEMORY.format(stories=one.stories, keys=keys)
            peak = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True).stdout
            rows.append(
                [name, one.stories, shown(one.seconds), one.iterations, f"{one.mass_error:.0e}",
                 f"{one.stiffness_error:.0e}", f"{float(peak):.0f} MB", f"N^{exponent(tall):.1f}"]
            )  # fmt: skip
    head = ["method", "stories", "`identify`", "iterations", "mass error", "stiffness error", "peak of the process"]
    table("Tall frames, exact modes", [*head, "from 100 stories on"], rows)
    table(
        "One-shot beside the eigenproblem K phi = M phi lambda (scipy.linalg.eigh), processor time",
        ["stories", "eigenproblem", "`identify`", "`to_dict`", "the JSON file"],
        [_beside(n) for n in (300, 1000)],
    )


def _beside(stories):
    """Return processor times of an identification and of its file over the time of the generalized eigenproblem."""
    experiment, mass, stiffness = exact_experiment(stories)
    M, K = mass_matrix(mass), stiffness_matrix(stiffness)
    eigenproblem, _ = fastest(lambda: eigh(K, M), 3, time.process_time)
    whole, found = fastest(lambda: identify(experiment, "one-shot"), 3, time.process_time)
    as_dict, _ = fastest(found.to_dict, 3, time.process_time)
    written, _ = fastest(lambda: write_file(os.devnull, json_text(found.to_dict())), 3, time.process_time)
    return [stories, shown(eigenproblem), *(f"{each / eigenproblem:.1f}" for each in (whole, as_dict, written))]
