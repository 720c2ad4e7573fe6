"""Draw the probabilities of the effects, the residuals of the models, and the springs between levels."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from cvxshear.data import Deviation
from cvxshear.effects.open_class import STANDS_OUT
from cvxshear.loop import LoopResult
from cvxshear.loop.results import Candidate, by_part
from cvxshear.report.figures import style
from cvxshear.report.figures.drawn_frame import networks
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.quantities import AUTOMATIC, capital, chance, with_std
from cvxshear.util.typing import Floats

MOST_BARS = 14
"""Number of drawn effects, the most probable first; all added effects are drawn."""

LONGEST_LABEL = 44
"""Largest number of letters of an effect's name beside its dots; a telephone shows two lines."""

LEAST_DRAWN = 1e-4
"""Smallest probability on the axis, and smallest distance to 1; an effect beyond them is drawn at the edge."""

HOLLOW: dict[str, Any] = {"ls": "none", "marker": "D", "mfc": "white", "mec": style.BEFORE, "mew": 1.2, "ms": 5.0}
"""Style of the marks for the state before: a hollow diamond."""

TICKS = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999)
"""Probabilities at the ticks of the axis of log odds."""


@figure(
    "ranking",
    LoopResult,
    title="Probabilities of the effects",
    alternative="How probable each effect is before and with the data; the numbers are in the table above.",
    section="candidates",
    applies=lambda result: bool(result.candidates),
    needs="effects that were looked for",
    narrow=True,
)
def ranking(result: LoopResult) -> Figure:
    """Draw the probability of each effect before the data and with them, on an axis of log odds.

    How probable each effect is: before the data (hollow diamonds) and with them (dots). Beyond the dotted line an
    effect is more probable than not.

    The added effects are above, the other candidates below.
    """
    added = {item.placed for item in result.effects}
    mine = [item for item in result.candidates if item.placed in added]
    others = [item for item in result.candidates if item.placed not in added]
    bars = [*mine, *others[: max(MOST_BARS - len(mine), 0)]]
    row, room = (0.36, 1.9) if style.narrow_page() else (0.24, 1.35)
    figure = style.new_figure(style.page_width(), row * max(len(bars), 2) + room)
    axes = figure.subplots()
    axes.axvline(0.0, color="black", ls=":", lw=1.2)
    _dots(axes, bars, len(mine))
    wrap = 30 if style.narrow_page() else 90
    labels = ["\n".join(textwrap.wrap(style.letters(item.placed.label, LONGEST_LABEL), wrap - 6)) for item in bars]
    axes.set_yticks(range(len(bars)), labels)
    for label in axes.get_yticklabels()[: len(mine)]:
        label.set_fontweight("bold")
    axes.set_ylim(max(len(bars), 1) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("\n".join(textwrap.wrap("probability that it is there (scale of the logarithm of the odds)", wrap)))
    axes.xaxis.set_major_locator(FixedLocator(_log_odds(TICKS[::2] if style.narrow_page() else TICKS).tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(_percent))
    edge = float(_log_odds([1.0 - LEAST_DRAWN])[0])
    axes.set_xlim(-1.04 * edge, 1.04 * edge)
    axes.grid(axis="x")
    style.legend(figure, axes, 1 if style.narrow_page() else 3, left=True)
    return figure


def _log_odds(probabilities: list[float] | tuple[float, ...]) -> Floats:
    """Compute log p / (1 - p), limited to the edges of the axis."""
    p = np.clip(np.asarray(probabilities, dtype=float), LEAST_DRAWN, 1.0 - LEAST_DRAWN)
    return np.asarray(np.log(p) - np.log1p(-p))


def _dots(axes: Axes, bars: list[Candidate], added: int) -> None:
    """Draw both probabilities and a line between; added effects have full dots, values beyond the edge arrows."""
    places = np.arange(len(bars))
    before, after = _log_odds([item.prior for item in bars]), _log_odds([item.probability for item in bars])
    axes.hlines(places, before, after, color="#B0B0B0", lw=1.0, zorder=1)
    axes.plot(before, places, label="before the data", **HOLLOW)
    inside = np.array([LEAST_DRAWN <= item.probability <= 1.0 - LEAST_DRAWN for item in bars], dtype=bool)
    for chosen, label, colour in (
        (places < added, "with the data: added", style.AFTER),
        (places >= added, "with the data: not added", style.GREY),
    ):
        for marker, there in (("o", inside), ("<", ~inside & (after < 0)), (">", ~inside & (after > 0))):
            at = np.flatnonzero(chosen & there)
            if len(at):
                named = label if label not in axes.get_legend_handles_labels()[1] else None
                axes.plot(after[at], at, ls="none", marker=marker, color=colour, ms=5.0, label=named)


def _percent(value: float, at: object = None) -> str:
    p = float(1.0 / (1.0 + np.exp(-value)))
    return chance(p).replace(".0 %", " %")


USUAL = 2.0
"""Number of standard deviations that chance rarely exceeds."""

LINEAR = 5.0
"""End of the linear part of the axis in standard deviations, if the largest residual exceeds `COMPRESSED`."""

COMPRESSED = 25.0

MOST_DECADES = 2
"""Largest number of labels on either side of zero."""

ROW, MARGINS = 0.19, 1.5
"""Heights of a row, and of legend and axis together, inch."""

Pair = tuple[Deviation, Deviation]


@figure(
    "residual",
    LoopResult,
    title="Residuals",
    alternative="Residual of each part of the measurement in standard deviations, for the shear model and with "
    "effects; the numbers are in the tables above.",
    section="residual",
    narrow=True,
)
def residual(result: LoopResult) -> Figure:
    """How far the model is from each part of the measurement, in standard deviations, before and after.

    The residual of every part of the measurement for the shear model (hollow diamonds) and with effects (dots),
    both in standard deviations of the final model's noise. Within the grey band it is what noise alone makes.

    Both residuals are in standard deviations of the final model's noise.

    Each kind of data has one panel.
    """
    pairs = list(zip(by_part(result.before.estimate), by_part(result.estimate), strict=True))
    kinds = list(dict.fromkeys(after.noise for _, after in pairs))
    of_kind = {kind: [pair for pair in pairs if pair[1].noise == kind] for kind in kinds}
    # A telephone shows the kinds of data below one another, each with its own rows.
    listed = [of_kind[kind] for kind in kinds] if style.narrow_page() else [pairs]
    rows = [list(dict.fromkeys((after.configuration, after.place) for _, after in each)) for each in listed]
    heights = [ROW * len(each) + MARGINS for each in rows]
    figure = style.new_figure(style.page_width(), sum(heights))
    columns = 1 if style.narrow_page() else len(kinds)
    drawn = figure.subplots(len(rows), columns, sharey="row", squeeze=False, height_ratios=heights)
    for at, (axes, kind) in enumerate(zip(drawn.ravel(), kinds, strict=True)):
        _residual_panel(axes, rows[at // columns], of_kind[kind])
    for axes, own in zip(drawn[:, 0], rows, strict=True):
        axes.set_yticks(range(len(own)), [_row_label(name, place) for name, place in own])
        axes.set_ylim(len(own) - 0.4, -0.6)
    style.legend(figure, drawn[0, 0], 2)
    return figure


def _row_label(configuration: str, place: str) -> str:
    """Name a part of the measurement, shortened to leave space for the panel; a prior has no configuration."""
    name, statement = (12, 24) if style.narrow_page() else (20, 48)
    return f"{style.letters(configuration, name)}, {place}" if configuration else style.letters(place, statement)


def _residual_panel(axes: Axes, rows: Sequence[tuple[str, str]], pairs: Sequence[Pair]) -> None:
    """Draw one kind of data: single numbers with their sign, or the root mean square of each part."""
    signed = all(after.entries == 1 for _, after in pairs)
    places = np.array([rows.index((after.configuration, after.place)) for _, after in pairs], dtype=float)
    axes.axvspan(-USUAL if signed else 0, USUAL, color="#EFEFEF", zorder=0, lw=0)
    before, after = np.array([[before.deviations, after.deviations] for before, after in pairs]).T
    _dumbbells(axes, places, *((before, after) if signed else (np.abs(before), np.abs(after))))
    what = f"{pairs[0][1].noise.replace('_', ' ')}, {'model less measurement' if signed else 'root mean square'}"
    wrapped = "\n".join(textwrap.wrap(f"{what}, standard deviations", 22))
    axes.set_xlabel(wrapped if style.narrow_page() else f"{what},\nstandard deviations")
    if signed:
        axes.axvline(0, color=style.GREY, lw=0.8)
    else:
        axes.set_xlim(left=0)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _dumbbells(axes: Axes, places: Floats, before: Floats, after: Floats) -> None:
    axes.hlines(places, before, after, color="#B0B0B0", lw=1.0, zorder=1)
    axes.plot(before, places, label="shear model", **HOLLOW)
    axes.plot(after, places, ls="none", marker="o", color=style.AFTER, ms=4.2, label="with effects")
    largest = float(np.nanmax(np.abs([*before, *after, 1.0])))
    if largest > COMPRESSED:
        axes.set_xscale("symlog", linthresh=LINEAR, linscale=1.0)
        axes.xaxis.set_major_locator(FixedLocator(_decades(largest)))
        axes.xaxis.set_major_formatter(FuncFormatter(style.power_of_ten))
        axes.xaxis.set_minor_formatter("")
        axes.set_xlim(-2 * largest, 2 * largest)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        axes.set_xlim(-1.15 * max(largest, USUAL), 1.15 * max(largest, USUAL))


def _decades(largest: float) -> list[float]:
    """List zero and some powers of ten on both sides beyond the linear part, without overlaps of their labels."""
    first, last = int(np.ceil(np.log10(LINEAR))), int(np.floor(np.log10(2 * largest)))
    powers = [10.0**power for power in range(first, last + 1, -(-(last - first + 1) // MOST_DECADES))]
    return [*(-power for power in reversed(powers)), 0.0, *powers]


MOST_LEVELS = 9
"""Largest number of levels for a matrix of springs with numbers in its cells."""


@figure(
    "springs",
    LoopResult,
    title="Springs between levels",
    alternative="Matrix of the springs between all pairs of levels; the largest are named in the table of effects.",
    section="effects",
    applies=lambda result: bool(networks(result)),
    needs="springs between levels that no story joins",
    narrow=True,
)
def springs(result: LoopResult) -> Figure:
    """Fill the matrix of springs between levels of the effect that has them.

    Every symmetric stiffness is a network of springs between levels. Shown is what the stories do not have:
    stiffness and standard deviation of each spring; a heavy outline marks what stands out of its deviation.
    """
    item, places = networks(result)[0]
    values, stds = np.full((2, result.experiment.stories + 1, result.experiment.stories + 1), np.nan)
    for (low, high), name in zip(places, item.parameters, strict=True):
        std = item.std[name]
        values[high, low], stds[high, low] = item.parameters[name], np.nan if std is None else std
    return springs_between_levels(values, stds)


def springs_between_levels(values: Floats, stds: Floats) -> Figure:
    """Draw the matrix of springs between all pairs of levels, and mark the significant springs.

    Colour and number have the same meaning: orange is stiffer than the shear frame, purple softer. A heavy outline
    marks
    a value more than `STANDS_OUT` standard deviations from zero.

    Parameters
    ----------
    values, stds : ndarray, shape (N + 1, N + 1)
        Stiffness of the spring between two levels and its standard deviation, N/m; level 0 is the ground. Only the
        lower triangle is used; nan if a spring does not exist.
    """
    count = len(values)
    lower = np.tril(np.ones((count, count), dtype=bool), -1) & np.isfinite(values)
    factor, unit = AUTOMATIC.of_stiffness(np.where(lower, values, 0.0).ravel().tolist())
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.where(lower, values / stds, np.nan)
    side = style.page_width() if count > MOST_LEVELS // 2 else 4.2
    drawn = style.new_figure(side, 0.55 * side + 0.6)
    axes = drawn.subplots()
    most = max(float(np.nanmax(np.abs(sizes), initial=0.0)), STANDS_OUT)
    image = axes.imshow(sizes[1:, :-1], cmap="PuOr_r", vmin=-most, vmax=most, aspect="auto")
    for row, column in zip(*np.nonzero(lower), strict=True):
        marked = abs(sizes[row, column]) > STANDS_OUT
        if marked:
            axes.add_patch(Rectangle((column - 0.47, row - 1.47), 0.94, 0.94, fc="none", ec="black", lw=2.0, zorder=4))
        if count <= MOST_LEVELS or marked:
            said = with_std(values[row, column], stds[row, column], factor=factor)
            dark = abs(sizes[row, column]) > 0.6 * most
            axes.text(column, row - 1, said.replace(" ± ", "\n± "), ha="center", va="center", fontsize=6.5,
                      color="white" if dark else "#010101", weight="bold" if marked else "normal")  # fmt: skip
    names = ["ground", *(f"floor {floor}" for floor in range(1, count))]
    axes.set_xticks(range(count - 1), names[:-1], rotation=90 if count > MOST_LEVELS else 0)
    axes.set_yticks(range(count - 1), names[1:])
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_title(f"{capital(f'springs between levels, {unit}')}")
    drawn.colorbar(image, ax=axes, label="standard deviations from zero", shrink=0.8)
    return drawn
