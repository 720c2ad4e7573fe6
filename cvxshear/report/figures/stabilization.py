"""The stabilization diagram: poles over model order, on top of what the record itself shows over frequency."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cvxshear.modal import ModalResult
from cvxshear.modal.picking import Sweep
from cvxshear.report.describe.modal import method_in_words
from cvxshear.report.figures.style import AFTER, BEFORE, PAGE_WIDTH, QUIET, letters, new_figure, panels, spread, styled
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

LABEL = 0.14
"""inch, what a label standing on end needs in width."""
BAND = 0.42
"""Of the orders' height: the room for the labels above them."""
HIGHEST = 1.3
"""Times the highest natural frequency: where the axis ends."""
POLES: dict[str, dict[str, Any]] = {
    "pole": {"marker": ".", "color": "#B5B5B5", "ms": 3.0},
    "stable": {"marker": "+", "color": BEFORE, "ms": 4.5, "mew": 0.8},
    "of a mode": {"marker": "o", "color": AFTER, "ms": 3.4},
}


@styled
def stabilization(*results: ModalResult) -> Figure:
    """Poles over model order: all of them, the stable ones, and those the modes rest on.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes`; a panel each. With `functions` kept, the mode indicator function stands behind the poles.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        Where a result holds no order sweep.
    """
    most = max(len(result.frequencies) for result in results)
    figure = new_figure(max(PAGE_WIDTH, LABEL * most + 1.4), 3.4 * len(results) + 0.5)
    for axes, result in zip(panels(figure, len(results), 1), results, strict=True):
        if result.sweep is None:
            raise InputError(f"{result.name}: not identified from a record here, so there is no order sweep to draw")
        if result.functions is not None:
            _indicator(axes, result)
        _poles(axes, result.sweep)
        top = max(poles.order for poles in result.sweep.poles)
        axes.set_xlim(0.0, HIGHEST * float(result.frequencies[-1]))
        axes.set_ylim(0, (1 + BAND) * top)
        axes.set_yticks(range(0, top + 1, max(2, top // 6 // 2 * 2)))
        _labels(axes, result, top, figure.get_figwidth() - 1.0)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel("model order (states)", y=0.5 / (1 + BAND))
        axes.set_title(f"{letters(result.name)}: {method_in_words(result)}")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _poles(axes: Axes, sweep: Sweep) -> None:
    chosen = {place for item in sweep.chosen for place in item.members}
    points: dict[str, list[tuple[float, int]]] = {label: [] for label in POLES}
    for i, poles in enumerate(sweep.poles):
        stable = set(sweep.stable[i])
        for j, frequency in enumerate(poles.frequencies):
            kind = "of a mode" if (i, j) in chosen else "stable" if j in stable else "pole"
            points[kind].append((float(frequency), poles.order))
    for label, look in POLES.items():
        frequencies, orders = [x for x, _ in points[label]], [y for _, y in points[label]]
        axes.plot(frequencies, orders, ls="none", label=label, **look)


def _indicator(axes: Axes, result: ModalResult) -> None:
    """The singular values of the functions, logarithmic, over the height of the orders; their size does not matter."""
    assert result.functions is not None
    behind = axes.twinx()
    lines = result.functions.frequencies
    values = result.functions.indicator[:, :2]
    shown = (lines > 0.2 * result.frequencies[0]) & (lines < HIGHEST * result.frequencies[-1])
    for place, column in enumerate(values.T):
        behind.plot(lines[shown], column[shown], color=QUIET, lw=0.9, ls=":" if place else "-", alpha=0.8)
    behind.set_yscale("log")
    low, high = float(values[shown, 0].min()), float(values[shown, 0].max())
    behind.set_ylim(low, low * (high / low) ** (1 + BAND))
    behind.yaxis.set_visible(False)
    behind.spines["right"].set_visible(False)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.plot([], [], color=QUIET, lw=0.9, alpha=0.8, label="mode indicator function")


def _labels(axes: Axes, result: ModalResult, top: int, inches: float) -> None:
    """Mode and frequency on end above the poles, apart from one another, each with a line to its pole."""
    frequencies: Floats = result.frequencies
    end = axes.get_xlim()[1]
    gap = end * LABEL / inches
    for mode, frequency, x in zip(
        result.modes, frequencies, spread(frequencies, gap, gap / 2, end - gap / 2), strict=True
    ):
        axes.plot([frequency, frequency, x], [0, 1.03 * top, 1.1 * top], color=AFTER, lw=0.6, alpha=0.6)
        axes.text(x, 1.12 * top, f"{mode}: {frequency:#.4g} Hz", rotation=90, ha="center", va="bottom", fontsize=7)
