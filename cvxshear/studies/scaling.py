"""How the cost of an identification grows with the number of stories."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.methods import identify
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.util.typing import Floats

SPREAD = 0.3
"""Masses and stiffnesses lie within this part of their mean."""


@dataclass(frozen=True)
class Cost:
    """One identification from exact modes.

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


def exact_experiment(stories: int, seed: int = 0) -> tuple[Experiment, Floats, Floats]:
    """A frame of uneven masses and stiffnesses with its exact modes, its floor masses and its story stiffnesses.

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


def cost(stories: int, method: str, *, repeats: int = 3, accelerate: bool = False, rows: bool | None = None) -> Cost:
    """Identify one exact frame of so many stories.

    Parameters
    ----------
    stories : int
    method : str
        "two-stage" or "one-shot".
    repeats : int, optional
    accelerate, rows : optional
        As for `identify`.
    """
    of, mass, stiffness = exact_experiment(stories)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        part = identify(of, method, accelerate=accelerate, rows=rows).parts[0]
        seconds.append(time.perf_counter() - began)
    return Cost(
        stories,
        min(seconds),
        part.iterations,
        float(np.max(np.abs(part.frame.floor_mass / mass - 1))),
        float(np.max(np.abs(part.frame.story_stiffness / stiffness - 1))),
    )


def exponent(costs: Sequence[Cost]) -> float:
    """The p of seconds ~ stories^p, by least squares in logarithms."""
    stories, seconds = (np.log([getattr(each, name) for each in costs]) for name in ("stories", "seconds"))
    return float(np.polyfit(stories, seconds, 1)[0])
