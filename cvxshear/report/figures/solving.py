"""How the solution is computed: the mass iteration step by step, and all backends on the same programs."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cvxshear.backends import Comparison
from cvxshear.methods import Identification, SingleIdentification
from cvxshear.report.figures import style
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

MOST_LINES = 6
"""Floors that have a line each; with more, the largest and the median are drawn."""


@figure(
    "convergence",
    Identification,
    title="The mass iteration",
    caption="Error of each floor mass over the iterations of the two-stage method.",
    alternative="Error of each floor mass over the iterations.",
    applies=lambda *results: any(
        part.history is not None and len(part.history) > 1 for result in results for part in result.parts
    ),
    needs="a method that iterates on the masses: two-stage",
)
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
    rows, columns = style.grid_of(len(parts), 2 if len(parts) in (2, 4) else 3)
    figure = style.new_figure(max(style.PAGE_WIDTH * columns / 3, 5.0), 2.6 * rows + 0.6)
    drawn = style.panels(figure, len(parts), columns, sharey=True)
    for place, (axes, part) in enumerate(zip(drawn, parts, strict=True)):
        _panel(axes, part, true_mass)
        several = sum(item.name == part.name for item in parts) > 1
        axes.set_title(f"{style.letters(part.name, 20)}{_start(part) if several else ''}", fontsize=8.5)
        if place % columns == 0:
            axes.set_ylabel("error of the mass, relative" if true_mass is not None else "mass still to go, relative")
    style.legend(figure, drawn[0], min(len(drawn[0].get_lines()), 6))
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
    for values, name, look in zip(errors.T, names, style.looks(len(names)), strict=True):
        axes.plot(values, ms=3.5, lw=1.0, label=name, **look)
    axes.set_yscale("log")
    style.logarithmic(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_xlabel("iteration")
    axes.grid(axis="y")


DRAWN_AS_NOTHING = 1e-17
"""Where an answer without any difference is drawn: below what a number of 64 bits can tell."""


@figure(
    "backends",
    Comparison,
    title="Agreement of the backends",
    caption="Left: how far each backend's answer is from the closed form (from the median of all where a bound is "
    "active). Right: its time over that of the closed form, on this machine.",
    alternative="Differences between the backends and their times; the numbers are in the table that follows.",
    section="worst",
    narrow=True,
)
def backend_differences(comparison: Comparison) -> Figure:
    """Each backend's largest difference from the reference, and its time over that of the closed form.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    Figure
        One row a backend, one marker a kind of program; a program that a backend does not take has none.
    """
    names = list(dict.fromkeys(row.backend for row in comparison.rows))
    kinds = list(dict.fromkeys(row.kind for row in comparison.rows))
    stacked = 2 if style.narrow_page() else 1
    figure = style.new_figure(style.page_width(), stacked * (0.27 * len(names) + 1.7))
    # Room for the last number of one axis beside the first of the other.
    left, right = figure.subplots(stacked, 2 // stacked, sharey=True, gridspec_kw={"wspace": 0.08})
    offsets = np.linspace(-0.28, 0.28, len(kinds)) if len(kinds) > 1 else np.zeros(1)
    for place, (kind, mark) in enumerate(zip(kinds, style.looks(len(kinds)), strict=True)):
        rows = [row for row in comparison.rows if row.kind == kind and not row.failure]
        at = [names.index(row.backend) + offsets[place] for row in rows]
        # Every other kind is hollow, so that the markers part without their colours too.
        colour = mark["color"]
        look = {**mark, "ls": "none", "mec": colour, "mfc": "white" if place % 2 else colour, "ms": 4.0}
        left.plot([max(row.difference or 0.0, DRAWN_AS_NOTHING) for row in rows], at, label=kind, **look)
        right.plot([row.relative_time or np.nan for row in rows], at, **look)
    left.set_xscale("log")
    right.set_xscale("log")
    left.set_xlabel(f"largest relative difference\n(none at all is drawn at {style.power_of_ten(DRAWN_AS_NOTHING)})")
    right.set_xlabel("time / time of the closed form")
    left.set_xlim(left=DRAWN_AS_NOTHING / 3)
    for axes in (left, right):
        style.logarithmic(axes.xaxis, most=6)
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
        for edge in np.arange(len(names) - 1) + 0.5:
            axes.axhline(edge, color="#E6E6E6", lw=0.5, zorder=0)
    left.set_yticks(range(len(names)), names)
    left.set_ylim(len(names) - 0.4, -0.6)
    style.legend(figure, left, min(len(kinds), 2 if style.narrow_page() else 4))
    return figure
