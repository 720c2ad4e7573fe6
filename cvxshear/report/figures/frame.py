"""The identified frame, drawn to scale."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cvxshear.loop import Closure
from cvxshear.measurement.experiment import Experiment
from cvxshear.methods import Identification, IdentifiedFrame
from cvxshear.report.describe.frame import in_one_unit
from cvxshear.report.figures.style import AFTER, PALE, QUIET, grid_of, letters, new_figure, panels, spread, styled
from cvxshear.util.quantities import AUTOMATIC
from cvxshear.util.typing import Floats

LINE = 0.17
"""inch, what a line of text needs."""

SLAB = 0.3
"""Thickness of the heaviest floor, of the lowest story height."""

PANEL_WIDTH = 6.8
"""inch; room for the widest label on either side."""

LEFT, RIGHT, GAP = 0.46, 0.57, 0.07
"""The columns, and the distance of the labels from them, as parts of a panel's width."""

SMALLEST = 1e-300
THINNEST, THICKEST = 1.0, 7.0
"""points, columns of a vanishing and of the largest story stiffness."""


@styled
def frame(result: Closure | Identification) -> Figure:
    """The identified frame: heights to scale, slabs as thick as floors are heavy, columns as wide as stories are stiff.

    Parameters
    ----------
    result : Closure or Identification
        Of an identification of each configuration by itself every one has its panel.

    Returns
    -------
    Figure
    """
    frames = _frames(result)
    stories = result.experiment.stories
    rows, columns = grid_of(len(frames), 2)
    height = float(np.clip(stories * 2 * LINE, 2.2, 8.0))
    figure = new_figure(PANEL_WIDTH * columns, rows * (height + 0.75))
    for axes, (title, found) in zip(panels(figure, len(frames), columns), frames, strict=True):
        _draw(axes, result.experiment, found, title, height)
    return figure


def _frames(result: Closure | Identification) -> list[tuple[str, IdentifiedFrame]]:
    if isinstance(result, Closure):
        return [("", result.frame)]
    return [(letters(part.name) if len(result.parts) > 1 else "", part.frame) for part in result.parts]


def elevations(experiment: Experiment) -> tuple[Floats, str]:
    """Elevations of the floors, shape (N,), and what they are called; equal stories where no heights are declared."""
    declared = experiment.frame.elevations
    if declared is None:
        return np.arange(1.0, experiment.stories + 1), "floor (no story heights declared)"
    return declared, "elevation, m"


def _draw(axes: Axes, experiment: Experiment, found: IdentifiedFrame, title: str, inches: float) -> None:
    z, label = elevations(experiment)
    heights = np.diff(z, prepend=0.0)
    total = float(z[-1])
    mass, stiffness = (np.nan_to_num(values) for values in (found.floor_mass, found.story_stiffness))
    slabs = SLAB * float(heights.min()) * mass / max(float(mass.max()), SMALLEST)
    strokes = THINNEST + (THICKEST - THINNEST) * stiffness / max(float(stiffness.max()), SMALLEST)
    ground = Rectangle(
        (LEFT - 0.04, -0.04 * total), RIGHT - LEFT + 0.08, 0.04 * total, fc="none", ec=QUIET, hatch="////", lw=0
    )
    axes.add_patch(ground)
    axes.plot([LEFT - 0.04, RIGHT + 0.04], [0, 0], color="black", lw=1.0)
    for low, high, stroke in zip(z - heights, z, strokes, strict=True):
        for side in (LEFT, RIGHT):
            axes.plot([side, side], [low, high], color=AFTER, lw=stroke, solid_capstyle="butt")
    for at, slab in zip(z, slabs, strict=True):
        slab_there = Rectangle((LEFT - 0.02, at - slab / 2), RIGHT - LEFT + 0.04, slab, fc=PALE, ec="black", lw=0.8)
        slab_there.set_zorder(3)
        axes.add_patch(slab_there)
    _labels(axes, found, z, heights, total * LINE / inches)
    axes.set_xlim(0, 1)
    axes.set_ylim(-0.045 * total, total + float(slabs.max()))
    axes.set_ylabel(label)
    axes.set_xticks([])
    axes.spines["bottom"].set_visible(False)
    for x, text, std, align in (
        (LEFT - GAP, "story stiffness", found.story_stiffness_std, "right"),
        (RIGHT + GAP, "floor mass", found.floor_mass_std, "left"),
    ):
        # A value that a bound holds has no deviation of its own.
        heading = text if std is None or not np.isfinite(std).any() else f"{text} ± std"
        axes.text(x, 1.02, heading, ha=align, va="bottom", weight="bold", transform=axes.transAxes)
    if title:
        axes.set_title(title, pad=20)


def _labels(axes: Axes, found: IdentifiedFrame, z: Floats, heights: Floats, gap: float) -> None:
    """Stiffnesses to the left at the stories, masses to the right at the floors, apart from one another."""
    stiffnesses, unit = in_one_unit(found.story_stiffness, found.story_stiffness_std, AUTOMATIC.of_stiffness)
    masses, mass_unit = in_one_unit(found.floor_mass, found.floor_mass_std, AUTOMATIC.of_mass)
    top = float(z[-1])
    middle = z - heights / 2
    for i, (at, shown) in enumerate(zip(middle, spread(middle, gap, 0.0, top), strict=True)):
        _leader(axes, (LEFT, at), (LEFT - GAP + 0.01, shown))
        axes.text(LEFT - GAP, shown, f"story {i + 1}:  {stiffnesses[i]} {unit}", ha="right", va="center")
    for i, (at, shown) in enumerate(zip(z, spread(z, gap, 0.0, top), strict=True)):
        _leader(axes, (RIGHT + 0.02, at), (RIGHT + GAP - 0.01, shown))
        axes.text(RIGHT + GAP, shown, f"floor {i + 1}:  {masses[i]} {mass_unit}", ha="left", va="center")


def _leader(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.plot(*zip(start, end, strict=True), color=QUIET, lw=0.5)
