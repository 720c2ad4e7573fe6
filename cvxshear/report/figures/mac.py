"""The modal assurance criterion of every measured mode with every modelled one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cvxshear.identification import Identification
from cvxshear.loop import Closure
from cvxshear.report.figures.style import PAGE_WIDTH, grid_of, letters, new_figure, panels, styled
from cvxshear.report.shapes import mac_tables
from cvxshear.typing import Floats

NUMBERED = 8
"""Modes up to which the cells hold their numbers."""


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
        image = each.imshow(table, vmin=0, vmax=1, cmap="cividis", aspect="auto")
        each.set_title(letters(name))
        configuration = next(item for item in result.experiment.configurations if item.name == name)
        _ticks(each, configuration.modes.tolist(), stories)
        if stories <= NUMBERED:
            _numbers(each, table)
    figure.colorbar(image, ax=axes, label="MAC (1: the same shape)", shrink=0.8)
    return figure


def _ticks(axes: Axes, measured: list[int], stories: int) -> None:
    step = 1 if stories <= 10 else 2
    axes.set_xticks(range(0, stories, step), [str(mode) for mode in range(1, stories + 1, step)])
    axes.set_yticks(range(0, len(measured), step), [str(mode) for mode in measured[::step]])
    axes.set_xlabel("mode of the model")
    axes.set_ylabel("measured mode")
    axes.tick_params(length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def _numbers(axes: Axes, table: Floats) -> None:
    digits = 4 if table.shape[1] <= 4 else 2
    for (row, column), value in np.ndenumerate(table):
        if not np.isnan(value):
            # Cut, not rounded: 1 stands for two shapes that are the same.
            shown = np.floor(value * 10**digits + 1e-9) / 10**digits
            colour = "black" if value > 0.5 else "white"
            axes.text(column, row, f"{shown:.{digits}f}", ha="center", va="center", color=colour, fontsize=6.5)
