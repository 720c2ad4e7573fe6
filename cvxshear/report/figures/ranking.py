"""How probable each effect is, before the data and with them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from cvxshear.loop import Closure
from cvxshear.loop.results import Candidate
from cvxshear.report.figures.style import AFTER, BEFORE, PAGE_WIDTH, QUIET, letters, new_figure, styled
from cvxshear.util.quantities import chance
from cvxshear.util.typing import Floats

SHOWN = 14
"""Effects that are drawn, the most probable first; those that were added always are."""

LONGEST = 44

LEAST = 1e-4
"""Probability below which, and as far from certainty, an effect is drawn at the edge of the figure."""

TICKS = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999)


@styled
def ranking(result: Closure) -> Figure:
    """The probability of each effect before the data and with them, on an axis of log odds.

    Parameters
    ----------
    result : Closure

    Returns
    -------
    Figure
        What was added above, what else was looked for below.
    """
    added = {item.placed for item in result.effects}
    mine = [item for item in result.candidates if item.placed in added]
    others = [item for item in result.candidates if item.placed not in added]
    bars = [*mine, *others[: max(SHOWN - len(mine), 0)]]
    figure = new_figure(PAGE_WIDTH, 0.24 * max(len(bars), 2) + 1.35)
    axes = figure.subplots()
    axes.axvline(0.0, color="black", ls=":", lw=1.2)
    _arrows(axes, bars)
    _dots(axes, bars, len(mine))
    axes.set_yticks(range(len(bars)), [letters(item.placed.label, LONGEST) for item in bars])
    for label in axes.get_yticklabels()[: len(mine)]:
        label.set_fontweight("bold")
    axes.set_ylim(max(len(bars), 1) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("probability that it is there (scale of the logarithm of the odds)")
    axes.xaxis.set_major_locator(FixedLocator(_log_odds(TICKS).tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(_percent))
    edge = float(_log_odds([1.0 - LEAST])[0])
    axes.set_xlim(-1.04 * edge, 1.04 * edge)
    axes.grid(axis="x")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3)
    return figure


def _log_odds(probabilities: list[float] | tuple[float, ...]) -> Floats:
    """log p / (1 - p), what is beyond the edges at them."""
    p = np.clip(np.asarray(probabilities, dtype=float), LEAST, 1.0 - LEAST)
    odds: Floats = np.log(p) - np.log1p(-p)
    return odds


def _arrows(axes: Axes, bars: list[Candidate]) -> None:
    before, after = _log_odds([item.prior for item in bars]), _log_odds([item.probability for item in bars])
    axes.hlines(range(len(bars)), before, after, color="#B0B0B0", lw=1.0, zorder=1)
    style: dict[str, Any] = {"ls": "none", "marker": "D", "mfc": "white", "mec": BEFORE, "mew": 1.2, "ms": 5.0}
    axes.plot(before, range(len(bars)), label="before the data", **style)


def _dots(axes: Axes, bars: list[Candidate], added: int) -> None:
    """With the data: full where added, and pointing outwards where the number lies beyond the edge."""
    after = _log_odds([item.probability for item in bars])
    inside = np.array([LEAST <= item.probability <= 1.0 - LEAST for item in bars], dtype=bool)
    mine = np.arange(len(bars)) < added
    for chosen, label, face, colour in (
        (mine, "with the data: added", AFTER, AFTER),
        (~mine, "with the data: not added", QUIET, QUIET),
    ):
        for marker, there in (("o", inside), ("<", ~inside & (after < 0)), (">", ~inside & (after > 0))):
            at = np.flatnonzero(chosen & there)
            if len(at):
                named = label if label not in axes.get_legend_handles_labels()[1] else None
                axes.plot(after[at], at, ls="none", marker=marker, mfc=face, mec=colour, ms=5.0, label=named)


def _percent(value: float, at: object = None) -> str:
    p = float(1.0 / (1.0 + np.exp(-value)))
    return chance(p).replace(".0 %", " %")
