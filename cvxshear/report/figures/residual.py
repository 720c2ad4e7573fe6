"""The residual by configuration and mode, in standard deviations, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from cvxshear.identification.efficient import Estimate
from cvxshear.loop import Closure
from cvxshear.loop.residual import ModeResidual, by_mode
from cvxshear.report.figures.style import AFTER, BEFORE, PAGE_WIDTH, QUIET, letters, new_figure, power_of_ten, styled
from cvxshear.typing import Floats

USUAL = 2.0
"""Standard deviations that chance rarely exceeds."""

LINEAR = 5.0
"""Standard deviations up to which the axis stays linear where the largest is beyond `COMPRESSED`."""

COMPRESSED = 25.0

MOST_DECADES = 2
"""Labels on either side of zero."""


@styled
def residual(result: Closure) -> Figure:
    """How far the model is from each measured frequency and shape, in standard deviations, before and after.

    Both are counted in the noise of the final model: where it is estimated, the first model's own residual would
    pass for noise otherwise.

    Parameters
    ----------
    result : Closure

    Returns
    -------
    Figure
    """
    before, after = by_mode(result.before.estimate), by_mode(result.estimate)
    figure = new_figure(PAGE_WIDTH, 0.19 * len(after) + 1.5)
    left, right = figure.subplots(1, 2, sharey=True)
    ratio = common_scale(result)
    places = np.arange(len(after), dtype=float)
    _dumbbells(
        left,
        places,
        [ratio * item.frequency_deviation for item in before],
        [item.frequency_deviation for item in after],
    )
    shapes = [_or_nan(item.shape_deviation) for item in after]
    _dumbbells(right, places, [ratio * _or_nan(item.shape_deviation) for item in before], shapes)
    left.axvspan(-USUAL, USUAL, color="#EFEFEF", zorder=0, lw=0)
    right.axvspan(0, USUAL, color="#EFEFEF", zorder=0, lw=0)
    left.axvline(0, color=QUIET, lw=0.8)
    left.set_xlabel("frequency, model less measurement,\nstandard deviations")
    right.set_xlabel("mode shape, rms over the floors,\nstandard deviations")
    right.set_xlim(left=0)
    left.set_yticks(places, [_named(item) for item in after])
    left.set_ylim(len(after) - 0.4, -0.6)
    for axes in (left, right):
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure


def common_scale(result: Closure) -> float:
    """What turns the first model's standard deviations into those of the final model."""
    first, last = _scale(result.before.estimate), _scale(result.estimate)
    return first / last


def _scale(estimate: Estimate) -> float:
    scale = estimate.noise_scale
    return scale if np.isfinite(scale) and scale > 0 else 1.0


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def _named(item: ModeResidual) -> str:
    return f"{letters(item.configuration, 20)}, mode {item.mode}"


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
        axes.set_xlim(-1.15 * max(largest, USUAL), 1.15 * max(largest, USUAL))


def _decades(largest: float) -> list[float]:
    """Zero and powers of ten beyond the linear part on both sides, so few that their labels stay apart."""
    first, last = int(np.ceil(np.log10(LINEAR))), int(np.floor(np.log10(2 * largest)))
    powers = [10.0**power for power in range(first, last + 1, -(-(last - first + 1) // MOST_DECADES))]
    return [*(-power for power in reversed(powers)), 0.0, *powers]
