"""Identified modes by themselves: their shapes with error bars, and how alike they are."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cvxshear.modal import ModalResult
from cvxshear.records.shapes import mac, scaled_to_one
from cvxshear.report.figures.mac import draw_matrix
from cvxshear.report.figures.style import (
    AFTER,
    MEASURED,
    PAGE_WIDTH,
    QUIET,
    even_columns,
    grid_of,
    letters,
    new_figure,
    panels,
    panels_by_group,
    styled,
)
from cvxshear.util.quantities import percents
from cvxshear.util.typing import Floats

MOST_COLUMNS = 5


@styled
def modal_shapes(*results: ModalResult) -> Figure:
    """The shapes of identified modes, one panel a record and mode, with one standard deviation on either side.

    Parameters
    ----------
    *results : ModalResult

    Returns
    -------
    Figure
        Largest entry 1; a mode that several records hold faces one way in all of them.
    """
    most = max(len(result.frequencies) for result in results)
    columns = even_columns(most, MOST_COLUMNS)
    counts = [len(result.frequencies) for result in results]
    rows = sum(-(-count // columns) for count in counts)
    stories = max(result.stories for result in results)
    tall = float(np.clip(0.16 * stories, 1.5, 3.0))
    figure = new_figure(max(PAGE_WIDTH * columns / MOST_COLUMNS, 4.0), rows * (tall + 0.65) + 0.4)
    groups = panels_by_group(figure, counts, columns, sharex=True, sharey=True)
    facing: dict[int, tuple[ModalResult, Floats]] = {}
    for result, drawn in zip(results, groups, strict=True):
        for row, (axes, mode) in enumerate(zip(drawn, result.modes, strict=True)):
            shape = _facing(result, scaled_to_one(result.mode_shapes[row]), facing, int(mode))
            _panel(axes, result, row, shape, stories)
            if row % columns == 0:
                axes.set_ylabel("floor")
    figure.supxlabel("sway (largest entry = 1)", fontsize=8.5)
    return figure


@styled
def modal_mac(*results: ModalResult) -> Figure:
    """The modal assurance criterion of the modes of each record with one another.

    Parameters
    ----------
    *results : ModalResult

    Returns
    -------
    Figure
        One panel a record; beside the diagonal it is near 0 where the sensors tell the modes apart.
    """
    columns = min(len(results), 3)
    rows, columns = grid_of(len(results), columns)
    side = PAGE_WIDTH / 3
    figure = new_figure(side * columns + 0.9, rows * (side + 0.3))
    drawn = panels(figure, len(results), columns)
    for axes, result in zip(drawn, results, strict=True):
        table = np.array([[mac(one, other) for other in result.mode_shapes] for one in result.mode_shapes])
        image = draw_matrix(axes, table, result.modes.tolist(), result.modes.tolist())
        axes.set_title(letters(result.name))
        axes.set_xlabel("mode")
        axes.set_ylabel("mode")
    figure.colorbar(image, ax=drawn, label="MAC (1: the same shape)", shrink=0.8)
    return figure


def _facing(result: ModalResult, shape: Floats, facing: dict[int, tuple[ModalResult, Floats]], mode: int) -> Floats:
    """The shape with the sign that the mode had in the first record, by the floors that both measured."""
    first, before = facing.setdefault(mode, (result, shape))
    _, mine, theirs = np.intersect1d(result.floors, first.floors, return_indices=True)
    return -shape if shape[mine] @ before[theirs] < 0 else shape


def _panel(axes: Axes, result: ModalResult, row: int, shape: Floats, stories: int) -> None:
    heights = np.concatenate([[0], result.floors])
    axes.axvline(0, color="#C8C8C8", lw=0.5)
    axes.plot(np.concatenate([[0.0], shape]), heights, color=AFTER, lw=1.2)
    known = "assumed" not in result.uncertainty
    axes.errorbar(
        shape,
        result.floors,
        xerr=result.mode_shape_std[row] if known else None,
        fmt="o",
        color=MEASURED,
        ms=3.0,
        capsize=2.0,
        lw=0.9,
    )
    axes.axhline(0, color=QUIET, lw=0.8)
    axes.set_xlim(-1.3, 1.3)
    axes.set_xticks([-1, 0, 1])
    axes.set_ylim(0, 1.07 * stories)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    std = f" ± {percents([float(result.frequency_std[row])])[0]}" if known else ""
    title = f"{letters(result.name, 18)}\nmode {result.modes[row]}\n{result.frequencies[row]:#.4g} Hz{std}"
    axes.set_title(title, fontsize=7)
