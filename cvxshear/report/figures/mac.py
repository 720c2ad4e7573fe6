"""The modal assurance criterion of every measured mode with every modelled one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from cvxshear.loop import Closure
from cvxshear.methods import Identification
from cvxshear.report.figures.style import PAGE_WIDTH, grid_of, letters, new_figure, panels, styled
from cvxshear.report.shapes import mac_tables
from cvxshear.util.typing import Floats

NUMBERED = 8
"""Modes up to which the cells hold their numbers."""

SAME = 1e-12
"""What a MAC of two shapes that are the same lacks of 1 by rounding."""


@styled
def mac(result: Closure | Identification) -> Figure:
    """The MAC matrix of each configuration.

    Parameters
    ----------
    result : Closure or Identification

    Returns
    -------
    Figure
        One panel a configuration; dark is 0, light is 1, also in black and white.
    """
    tables = mac_tables(result)
    stories = result.experiment.stories
    most = 3 if stories <= 4 else 2
    rows, columns = grid_of(len(tables), most)
    side = PAGE_WIDTH / most
    figure = new_figure(side * columns + 0.9, rows * (side + 0.3))
    axes = panels(figure, len(tables), columns)
    for each, (name, table) in zip(axes, tables, strict=True):
        configuration = next(item for item in result.experiment.configurations if item.name == name)
        image = draw_matrix(each, table, configuration.modes.tolist(), list(range(1, stories + 1)))
        each.set_title(letters(name))
        each.set_xlabel("mode of the model")
        each.set_ylabel("measured mode")
    figure.colorbar(image, ax=axes, label="MAC (1: the same shape)", shrink=0.8)
    return figure


def draw_matrix(axes: Axes, table: Floats, rows: list[int], columns: list[int]) -> AxesImage:
    """A matrix of MACs with the numbers of its modes, and its values where they can be read."""
    image = axes.imshow(table, vmin=0, vmax=1, cmap="cividis", aspect="auto")
    step = 1 if len(columns) <= 10 else 2
    axes.set_xticks(range(0, len(columns), step), [str(mode) for mode in columns[::step]])
    axes.set_yticks(range(0, len(rows), step), [str(mode) for mode in rows[::step]])
    axes.tick_params(length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    if len(columns) <= NUMBERED:
        _numbers(axes, table)
    return image


def _numbers(axes: Axes, table: Floats) -> None:
    digits = 4 if table.shape[1] <= 4 else 2
    for (row, column), value in np.ndenumerate(table):
        if not np.isnan(value):
            colour = "black" if value > 0.5 else "white"
            axes.text(column, row, written(value, digits), ha="center", va="center", color=colour, fontsize=6.5)


def written(value: float, digits: int) -> str:
    """A MAC with so many decimals, rounded, but for what would round to 1: that stands for shapes that are the same.

    Parameters
    ----------
    value : float
    digits : int
    """
    shown = f"{value:.{digits}f}"
    if float(shown) < 1 or value > 1 - SAME:
        return shown
    return f"> {1 - 10.0**-digits:.{digits}f}"
