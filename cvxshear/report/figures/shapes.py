"""Mode shapes measured and modelled, before and after, as displaced frames."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cvxshear.loop import Closure
from cvxshear.report.figures.frame import elevations
from cvxshear.report.figures.style import (
    AFTER,
    BEFORE,
    MEASURED,
    PAGE_WIDTH,
    QUIET,
    even_columns,
    letters,
    new_figure,
    panels_by_group,
    styled,
)
from cvxshear.report.shapes import ModeShape, mode_shapes
from cvxshear.util.typing import Floats

MOST_COLUMNS = 5
ABOVE, BELOW, TITLE = 0.3, 0.55, 0.5
"""inch, for the legend, the common label, and the two lines of title of a panel."""

HALF_WIDTH = 0.16
"""Of the drawn frame, where the largest entry of a shape is 1."""


@styled
def shapes(result: Closure) -> Figure:
    """Every measured mode with its error bars, the final model's as a displaced frame, and the first model's as a line.

    Parameters
    ----------
    result : Closure

    Returns
    -------
    Figure
        One panel a configuration and measured mode.
    """
    before, after = mode_shapes(result.before.estimate), mode_shapes(result.estimate)
    most = max(len(each.frequencies) for each in result.experiment.configurations)
    columns = even_columns(most, MOST_COLUMNS)
    stories = result.experiment.stories
    tall = float(np.clip(0.16 * stories, 1.6, 3.0))
    counts = [len(each.frequencies) for each in result.experiment.configurations]
    rows = sum(-(-count // columns) for count in counts)
    width, height = max(PAGE_WIDTH * columns / MOST_COLUMNS, 5.6), rows * (tall + TITLE) + ABOVE + BELOW
    # Panels of one size need no search for a layout, which takes long for many of them.
    figure = new_figure(width, height, fixed=True)
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.12 / width, bottom=BELOW / height, top=1 - (ABOVE + TITLE) / height,
        hspace=TITLE / tall, wspace=0.08,
    )  # fmt: skip
    z, label = elevations(result.experiment)
    groups = panels_by_group(figure, counts, columns, sharex=True, sharey=True)
    drawn = [(axes, place) for group in groups for place, axes in enumerate(group)]
    for (axes, place), first, last in zip(drawn, before, after, strict=True):
        _panel(axes, z, first, last)
        if place % columns == 0:
            axes.set_ylabel(label)
    figure.text(0.5, 0.08 / height, "sway (largest measured entry = 1)", ha="center", va="bottom")
    figure.legend(handles=_legend(changed=len(result.steps) > 1), loc="upper center", ncols=3)
    return figure


def _panel(axes: Axes, z: Floats, before: ModeShape, after: ModeShape) -> None:
    base = np.concatenate([[0.0], z])
    sway = np.concatenate([[0.0], after.modelled])
    axes.axvline(0, color="#C8C8C8", lw=0.5)
    for side in (-HALF_WIDTH, HALF_WIDTH):
        axes.plot(sway + side, base, color=AFTER, lw=1.0)
    axes.hlines(z, after.modelled - HALF_WIDTH, after.modelled + HALF_WIDTH, color=AFTER, lw=1.6)
    axes.plot(
        np.concatenate([[0.0], before.modelled]), base, color=BEFORE, ls="--", marker="D", mfc="white", ms=3.6, lw=1.0
    )
    axes.errorbar(
        after.measured,
        z[after.floors - 1],
        xerr=after.std,
        fmt="o",
        color=MEASURED,
        ms=3.0,
        capsize=2.0,
        lw=0.9,
        zorder=5,
    )
    axes.axhline(0, color=QUIET, lw=0.8)
    axes.set_xlim(-1.45, 1.45)
    axes.set_xticks([-1, 0, 1])
    axes.set_ylim(0, 1.07 * float(z[-1]))
    axes.set_title(
        f"{letters(after.configuration, 16)}\nmode {after.mode}: {after.measured_frequency:#.4g} Hz", fontsize=7.5
    )


def _legend(*, changed: bool) -> list[Line2D]:
    first = "first model (before)" if changed else "the same model"
    return [
        Line2D([], [], color=MEASURED, marker="o", ms=3.0, lw=0.9, label="measured ± one std"),
        Line2D([], [], color=BEFORE, ls="--", marker="D", mfc="white", ms=3.6, lw=1.0, label=first),
        Line2D([], [], color=AFTER, lw=1.6, label="final model (after)"),
    ]
