"""The springs between all pairs of levels, as a matrix."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cvxshear.effects.open_class import STANDS_OUT
from cvxshear.loop import Closure
from cvxshear.report.figures import style
from cvxshear.report.figures.drawn_frame import networks
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.quantities import AUTOMATIC, capital, with_std
from cvxshear.util.typing import Floats

MOST_LEVELS = 9
"""Levels up to which a matrix of springs has its numbers written in."""


@figure(
    "springs",
    Closure,
    title="Springs between levels",
    caption="Every symmetric stiffness is a network of springs between levels. Shown is what the stories do not have: "
    "stiffness and standard deviation of each spring; a heavy outline marks what stands out of its deviation.",
    alternative="Matrix of the springs between all pairs of levels; the largest are named in the table of effects.",
    section="effects",
    applies=lambda result: bool(networks(result)),
    needs="springs between levels that no story joins",
    narrow=True,
)
def springs(result: Closure) -> Figure:
    """Fill the matrix of springs between levels of the effect that has them."""
    item, places = networks(result)[0]
    values, stds = np.full((2, result.experiment.stories + 1, result.experiment.stories + 1), np.nan)
    for (low, high), name in zip(places, item.parameters, strict=True):
        std = item.std[name]
        values[high, low], stds[high, low] = item.parameters[name], np.nan if std is None else std
    return springs_between_levels(values, stds)


def springs_between_levels(values: Floats, stds: Floats) -> Figure:
    """Draw the matrix of springs between all pairs of levels, those marked that stand out of their deviations.

    Colour and number say the same: orange is stiffer than the shear frame has it, purple softer; a heavy outline marks
    what is more than `STANDS_OUT` standard deviations from zero.

    Parameters
    ----------
    values, stds : ndarray, shape (N + 1, N + 1)
        Stiffness of the spring between two levels and its standard deviation, N/m; level 0 is the ground. The lower
        triangle is read; nan where there is no such spring.
    """
    count = len(values)
    lower = np.tril(np.ones((count, count), dtype=bool), -1) & np.isfinite(values)
    factor, unit = AUTOMATIC.of_stiffness(np.where(lower, values, 0.0).ravel().tolist())
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.where(lower, values / stds, np.nan)
    side = style.page_width() if count > MOST_LEVELS // 2 else 4.2
    drawn = style.new_figure(side, 0.55 * side + 0.6)
    axes = drawn.subplots()
    most = max(float(np.nanmax(np.abs(sizes), initial=0.0)), STANDS_OUT)
    image = axes.imshow(sizes[1:, :-1], cmap="PuOr_r", vmin=-most, vmax=most, aspect="auto")
    for row, column in zip(*np.nonzero(lower), strict=True):
        marked = abs(sizes[row, column]) > STANDS_OUT
        if marked:
            axes.add_patch(Rectangle((column - 0.47, row - 1.47), 0.94, 0.94, fc="none", ec="black", lw=2.0, zorder=4))
        if count <= MOST_LEVELS or marked:
            said = with_std(values[row, column], stds[row, column], factor=factor)
            dark = abs(sizes[row, column]) > 0.6 * most
            axes.text(column, row - 1, said.replace(" ± ", "\n± "), ha="center", va="center", fontsize=6.5,
                      color="white" if dark else "#010101", weight="bold" if marked else "normal")  # fmt: skip
    names = ["ground", *(f"floor {floor}" for floor in range(1, count))]
    axes.set_xticks(range(count - 1), names[:-1], rotation=90 if count > MOST_LEVELS else 0)
    axes.set_yticks(range(count - 1), names[1:])
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_title(f"{capital(f'springs between levels, {unit}')}")
    drawn.colorbar(image, ax=axes, label="standard deviations from zero", shrink=0.8)
    return drawn
