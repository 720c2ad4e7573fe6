"""Mode shapes as drawings that a small script of the page can set in motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.loop import Closure
from cvxshear.measurement.experiment import Experiment
from cvxshear.methods import Prediction

WIDTH, HEIGHT = 120.0, 170.0
"""Of one drawing, in its own units."""

MARGIN = 12.0
HALF = 15.0
"""Half the width of the drawn frame."""

SWAY = 34.0
"""Of the largest entry of a shape."""

MOST_MODES = 6
"""Modes of a configuration that are drawn, from the lowest."""


@dataclass(frozen=True)
class Drawing:
    """One mode of one configuration.

    Parameters
    ----------
    label : str
    sway : tuple of float
        From the ground up, largest 1 in size.
    heights : tuple of float
        Of the ground and the floors in the drawing, from its top.
    left, right : str
        Points of the columns at full sway, as a polyline has them.
    floors : tuple of (float, float, float)
        Both ends and the height of each floor at full sway.
    """

    label: str
    sway: tuple[float, ...]
    heights: tuple[float, ...]
    left: str
    right: str
    floors: tuple[tuple[float, float, float], ...]


def drawings(result: Closure) -> list[tuple[str, list[Drawing]]]:
    """The lowest modes of the final model, by configuration."""
    return [
        (each.configuration, [_drawing(result.experiment, each, mode) for mode in range(_count(result.experiment))])
        for each in result.estimate.predictions
    ]


def _count(experiment: Experiment) -> int:
    return min(experiment.stories, MOST_MODES)


def _drawing(experiment: Experiment, prediction: Prediction, mode: int) -> Drawing:
    declared = experiment.frame.elevations
    z = np.arange(1.0, experiment.stories + 1) if declared is None else declared
    heights = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * np.concatenate([[0.0], z]) / z[-1]
    sway = np.concatenate([[0.0], prediction.mode_shapes[mode]])
    centre = WIDTH / 2 + SWAY * sway
    return Drawing(
        f"mode {mode + 1}: {prediction.frequencies[mode]:.4g} Hz",
        tuple(round(float(value), 4) for value in sway),
        tuple(round(float(value), 2) for value in heights),
        _points(centre - HALF, heights),
        _points(centre + HALF, heights),
        tuple(
            (round(float(x - HALF), 2), round(float(x + HALF), 2), round(float(y), 2))
            for x, y in zip(centre[1:], heights[1:], strict=True)
        ),
    )


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x, y, strict=True))
