"""The backends on the same programs: how far apart their answers are, and how long they took."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cvxshear.backends import Comparison
from cvxshear.report.figures.style import (
    COLOURS,
    MARKERS,
    PAGE_WIDTH,
    assorted,
    logarithmic,
    new_figure,
    power_of_ten,
    styled,
)

SAME = 1e-17
"""Where an answer without any difference is drawn: below what a number of 64 bits can tell."""


@styled
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
    figure = new_figure(PAGE_WIDTH, 0.27 * len(names) + 1.7)
    # Room for the last number of one axis beside the first of the other.
    left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.08})
    marks = zip(kinds, assorted(COLOURS, len(kinds)), assorted(MARKERS, len(kinds)), strict=True)
    offsets = np.linspace(-0.28, 0.28, len(kinds)) if len(kinds) > 1 else np.zeros(1)
    for place, (kind, colour, marker) in enumerate(marks):
        rows = [row for row in comparison.rows if row.kind == kind and not row.failure]
        at = [names.index(row.backend) + offsets[place] for row in rows]
        # Every other kind is hollow, so that the markers part without their colours too.
        style = {"ls": "none", "marker": marker, "mec": colour, "mfc": "white" if place % 2 else colour, "ms": 4.0}
        left.plot([max(row.difference or 0.0, SAME) for row in rows], at, label=kind, **style)
        right.plot([row.relative_time or np.nan for row in rows], at, **style)
    left.set_xscale("log")
    right.set_xscale("log")
    left.set_xlabel(f"largest relative difference\n(none at all is drawn at {power_of_ten(SAME)})")
    right.set_xlabel("time / time of the closed form")
    left.set_xlim(left=SAME / 3)
    for axes in (left, right):
        logarithmic(axes.xaxis, most=6)
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
        for edge in np.arange(len(names) - 1) + 0.5:
            axes.axhline(edge, color="#E6E6E6", lw=0.5, zorder=0)
    left.set_yticks(range(len(names)), names)
    left.set_ylim(len(names) - 0.4, -0.6)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4))
    return figure
