"""The candidates of the last step beside what was added."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from cvxshear.loop import Closure
from cvxshear.loop.significance import FAMILY_LEVEL
from cvxshear.report.figures.style import AFTER, PAGE_WIDTH, letters, new_figure, styled

SHOWN = 12
"""Candidates that are drawn, best first."""

LONGEST = 44
LEAST = 330.0
"""Powers of ten below which a probability is no number any more; what lies beyond is drawn there."""

COMPRESSED = 30.0
"""Powers of ten of the evidence beyond which the axis is logarithmic."""


@styled
def ranking(result: Closure) -> Figure:
    """How improbable each effect's gain would be by chance, with the level that it takes to be added.

    Parameters
    ----------
    result : Closure

    Returns
    -------
    Figure
        Effects in the model above, the candidates of the last step below.
    """
    added = [(found.placed.label, found.log_p) for found in result.effects]
    admissible = [item for item in result.candidates if item.admissible]
    left = [(item.placed.label, item.log_p) for item in admissible if item.placed.label not in dict(added)][:SHOWN]
    bars = [*added, *left]
    # Where the residual called for nothing more, the last step is the one that chose what was added.
    chosen = any(item.placed.label in dict(added) for item in admissible)
    others = "candidate of the same step, not chosen" if chosen else "candidate on top of the model, not added"
    figure = new_figure(PAGE_WIDTH, 0.24 * max(len(bars), 2) + 1.35)
    axes = figure.subplots()
    evidence = np.minimum([-log_p / np.log(10) for _, log_p in bars], LEAST)
    places = np.arange(len(bars))
    mine, theirs = slice(0, len(added)), slice(len(added), None)
    if added:
        axes.barh(places[mine], evidence[mine], height=0.62, color=AFTER, label="added to the model")
    if left:
        axes.barh(places[theirs], evidence[theirs], height=0.62, fc="white", ec="#333333", hatch="////", label=others)
    needed = -np.log10(FAMILY_LEVEL / max(len(admissible), 1))
    axes.axvline(
        needed, color="black", ls=":", lw=1.4, label=f"needed to be added: {100 * FAMILY_LEVEL:g} % over all candidates"
    )
    axes.set_yticks(places, [letters(name, LONGEST) for name, _ in bars])
    axes.set_ylim(max(len(bars), 1) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("probability of such a gain by chance, less likely to the right")
    _evidence_axis(axes, max(float(evidence.max(initial=0.0)), needed))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def _evidence_axis(axes: Axes, largest: float) -> None:
    """Ticks that name the probability, not its logarithm."""
    if largest > COMPRESSED:
        axes.set_xscale("symlog", linthresh=2.0)
        ticks = [0.0, 2.0, 10.0, 100.0, 1000.0, 10000.0]
        axes.set_xticks([tick for tick in ticks if tick < 2 * largest])
        axes.xaxis.set_minor_locator(MaxNLocator(1))
        axes.set_xlim(0, 1.4 * largest)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
        axes.set_xlim(0, 1.08 * largest)
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, at: ""))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, at: _probability(value)))


def _probability(evidence: float) -> str:
    """10 to the power of minus so much."""
    return "1" if evidence == 0 else f"10{str(-round(evidence)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
