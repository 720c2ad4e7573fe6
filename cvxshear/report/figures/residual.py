"""The residual part by part, in standard deviations, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from cvxshear.data import Deviation
from cvxshear.loop import Closure
from cvxshear.loop.residual import by_part
from cvxshear.report.figures.style import AFTER, BEFORE, PAGE_WIDTH, QUIET, letters, new_figure, power_of_ten, styled
from cvxshear.util.typing import Floats

USUAL = 2.0
"""Standard deviations that chance rarely exceeds."""

LINEAR = 5.0
"""Standard deviations up to which the axis stays linear where the largest is beyond `COMPRESSED`."""

COMPRESSED = 25.0

MOST_DECADES = 2
"""Labels on either side of zero."""

ROW, ROOM = 0.19, 1.5
"""inch, of a row, and of legend and axis."""

Pair = tuple[Deviation, Deviation]


@styled
def residual(result: Closure) -> Figure:
    """How far the model is from each part of the measurement, in standard deviations, before and after.

    Both are counted in the noise of the final model.

    Parameters
    ----------
    result : Closure

    Returns
    -------
    Figure
        One panel a kind of data.
    """
    pairs = list(zip(by_part(result.before.estimate), by_part(result.estimate), strict=True))
    kinds = list(dict.fromkeys(after.noise for _, after in pairs))
    rows = list(dict.fromkeys((after.configuration, after.place) for _, after in pairs))
    figure = new_figure(PAGE_WIDTH, ROW * len(rows) + ROOM)
    drawn = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    for axes, kind in zip(drawn, kinds, strict=True):
        _panel(axes, rows, [pair for pair in pairs if pair[1].noise == kind])
    drawn[0].set_yticks(range(len(rows)), [f"{letters(name, 20)}, {place}" for name, place in rows])
    drawn[0].set_ylim(len(rows) - 0.4, -0.6)
    handles, labels = drawn[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure


def _panel(axes: Axes, rows: Sequence[tuple[str, str]], pairs: Sequence[Pair]) -> None:
    """One kind of data: with their sign where they are single numbers, else the root mean square of each part."""
    signed = all(after.entries == 1 for _, after in pairs)
    places = np.array([rows.index((after.configuration, after.place)) for _, after in pairs], dtype=float)
    axes.axvspan(-USUAL if signed else 0, USUAL, color="#EFEFEF", zorder=0, lw=0)
    _dumbbells(axes, places, [before.deviations for before, _ in pairs], [after.deviations for _, after in pairs])
    what = pairs[0][1].noise.replace("_", " ")
    if signed:
        axes.axvline(0, color=QUIET, lw=0.8)
        axes.set_xlabel(f"{what}, model less measurement,\nstandard deviations")
    else:
        axes.set_xlabel(f"{what}, root mean square,\nstandard deviations")
        axes.set_xlim(left=0)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _dumbbells(axes: Axes, places: Floats, before: Sequence[float], after: Sequence[float]) -> None:
    axes.hlines(places, before, after, color="#B0B0B0", lw=1.0, zorder=1)
    axes.plot(before, places, ls="none", marker="D", mfc="white", mec=BEFORE, mew=1.2, ms=5.0, label="before")
    axes.plot(after, places, ls="none", marker="o", color=AFTER, ms=4.2, label="after")
    largest = float(np.nanmax(np.abs([*before, *after, 1.0])))
    if largest > COMPRESSED:
        axes.set_xscale("symlog", linthresh=LINEAR, linscale=1.0)
        axes.xaxis.set_major_locator(FixedLocator(_decades(largest)))
        axes.xaxis.set_major_formatter(FuncFormatter(power_of_ten))
        axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, at: ""))
        axes.set_xlim(-2 * largest, 2 * largest)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        axes.set_xlim(-1.15 * max(largest, USUAL), 1.15 * max(largest, USUAL))


def _decades(largest: float) -> list[float]:
    """Zero and powers of ten beyond the linear part on both sides, so few that their labels stay apart."""
    first, last = int(np.ceil(np.log10(LINEAR))), int(np.floor(np.log10(2 * largest)))
    powers = [10.0**power for power in range(first, last + 1, -(-(last - first + 1) // MOST_DECADES))]
    return [*(-power for power in reversed(powers)), 0.0, *powers]
