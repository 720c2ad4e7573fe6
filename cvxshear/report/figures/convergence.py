"""The mass iteration on its way."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cvxshear.methods import Identification, SingleIdentification
from cvxshear.report.figures.style import (
    COLOURS,
    LINES,
    MARKERS,
    PAGE_WIDTH,
    assorted,
    grid_of,
    letters,
    logarithmic,
    new_figure,
    panels,
    styled,
)
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

MOST_LINES = 6
"""Floors that have a line each; with more, the largest and the median are drawn."""


@styled
def convergence(*results: Identification, true_mass: Floats | None = None) -> Figure:
    """The error of each floor mass over the iterations of the two-stage method (the paper's Fig. 4).

    Parameters
    ----------
    *results : Identification
        By a method that iterates on the masses; one panel a configuration of each, in order.
    true_mass : ndarray, shape (N,), optional
        kg; what the errors are counted from. Where not given, the masses that the iteration ends with, and its
        last point is then left out.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        Where no result has an iteration to show.
    """
    parts = [part for result in results for part in result.parts if part.history is not None and len(part.history) > 1]
    if not parts:
        raise InputError("there is no mass iteration to show: identify with the method two-stage")
    rows, columns = grid_of(len(parts), 2 if len(parts) in (2, 4) else 3)
    figure = new_figure(max(PAGE_WIDTH * columns / 3, 5.0), 2.6 * rows + 0.6)
    drawn = panels(figure, len(parts), columns, sharey=True)
    for place, (axes, part) in enumerate(zip(drawn, parts, strict=True)):
        _panel(axes, part, true_mass)
        several = sum(item.name == part.name for item in parts) > 1
        axes.set_title(f"{letters(part.name, 20)}{_start(part) if several else ''}", fontsize=8.5)
        if place % columns == 0:
            axes.set_ylabel("error of the mass, relative" if true_mass is not None else "mass still to go, relative")
    handles, labels = drawn[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 6))
    return figure


def _start(part: SingleIdentification) -> str:
    assert part.history is not None
    started = ", ".join(f"{mass:.3g}" for mass in part.history[0, :4])
    return f"\nfrom {started}{', …' if part.history.shape[1] > 4 else ''} kg"


def _panel(axes: Axes, part: SingleIdentification, true_mass: Floats | None) -> None:
    assert part.history is not None
    final = part.history[-1] if true_mass is None else np.asarray(true_mass, dtype=float)
    history = part.history[:-1] if true_mass is None else part.history
    errors = np.abs(history / final - 1.0)
    # A logarithmic axis has no place for an error of nothing at all.
    errors = np.where(errors > 0, errors, np.nan)
    names = [f"floor {i + 1}" for i in range(errors.shape[1])]
    if errors.shape[1] > MOST_LINES:
        errors = np.column_stack([np.nanmax(errors, axis=1), np.nanmedian(errors, axis=1)])
        names = ["largest of all floors", "median of all floors"]
    marks = zip(assorted(COLOURS, len(names)), assorted(MARKERS, len(names)), assorted(LINES, len(names)), strict=True)
    for values, name, (colour, marker, line) in zip(errors.T, names, marks, strict=True):
        axes.plot(values, color=colour, marker=marker, ls=line, ms=3.5, lw=1.0, label=name)
    axes.set_yscale("log")
    logarithmic(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_xlabel("iteration")
    axes.grid(axis="y")
