"""Draw figures of studies: the scatter under noise, the steps of the mass iteration, the comparison of backends."""

from collections.abc import Iterable
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from cvxshear.backends import Comparison
from cvxshear.fit.results import Identification, SingleIdentification
from cvxshear.paper.scatter import NoiseStudy, Scatter
from cvxshear.report.figures import style
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

BOX = 0.8
"""Width of the boxes of all methods together, as a fraction of the distance between two noise levels."""


@figure("boxes", NoiseStudy, title="Scatter of the estimates")
def noise_boxes(study: NoiseStudy) -> Figure:
    """Box plots of the identified masses and stiffnesses at each noise level (the paper's Fig. 5).

    Boxes hold the middle half of the estimates with the median; whiskers reach 1.5 box lengths at most.

    Parameters
    ----------
    study : NoiseStudy
        Of one frame at one or several noise levels.

    Returns
    -------
    Figure
        Boxes hold the middle half with the median, whiskers reach 1.5 box lengths at most; points lie beyond.
    """
    groups = _by_method(study)
    first = next(iter(groups.values()))
    figure, drawn, levels = _panels_of(first, "error, %")
    width = BOX / len(groups)
    for parameter, axes in enumerate(drawn):
        axes.axhline(0, color="black", lw=0.7)
        for place, scatters in enumerate(groups.values()):
            at = np.arange(len(levels)) + (place - (len(groups) - 1) / 2) * width
            _boxes(axes, [100 * each.errors[:, parameter] for each in scatters], at, width, place)
        axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
        axes.set_xlim(-0.6, len(levels) - 0.4)
        axes.grid(axis="y")
    handles = [Patch(ec="black", alpha=0.8, label=name, **_filling(i)) for i, name in enumerate(groups)]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


@figure("variation", NoiseStudy, title="Coefficients of variation")
def noise_variation(study: NoiseStudy) -> Figure:
    """Coefficients of variation beside the Cramer-Rao bound (the paper's Fig. 6).

    Coefficient of variation of each estimate over the noise level, beside the Cramér-Rao bound.

    Parameters
    ----------
    study : NoiseStudy
        Of one frame at one or several noise levels.

    Returns
    -------
    Figure
        One panel for each mass and stiffness, over the noise level.
    """
    groups = _by_method(study)
    first = next(iter(groups.values()))
    figure, drawn, levels = _panels_of(first, "coefficient of\nvariation, %")
    for parameter, axes in enumerate(drawn):
        for method, look in _styles(groups).items():
            axes.plot(levels, [100 * each.variation[parameter] for each in groups[method]], label=method, **look)
        bound = [100 * each.relative_bound[parameter] for each in first]
        # A single level has no line: a dash marks its bound.
        axes.plot(levels, bound, color="black", lw=2.2, ls=(0, (1, 1)), marker="_", ms=9.0, label="Cramér-Rao bound")
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        axes.set_xticks([0, *levels] if len(levels) <= 6 else axes.get_xticks())
        axes.grid()
    style.legend(figure, drawn[0])
    return figure


def _by_method(study: NoiseStudy) -> dict[str, list[Scatter]]:
    """Select the scatters of each method over the noise levels of one frame."""
    chosen = study.scatters
    if len({(each.setup.name, each.setup.stories) for each in chosen}) > 1:
        raise InputError("a figure shows one frame: give a study whose setups differ in their noise alone")
    ordered = sorted(chosen, key=lambda each: [item.method for item in chosen].index(each.method))
    return {method: list(group) for method, group in groupby(ordered, key=lambda each: each.method)}


def _panels_of(scatters: list[Scatter], label: str) -> tuple[Figure, list[Axes], list[float]]:
    """Make one panel for each mass and stiffness, masses first, and return the noise levels, %."""
    numbers = range(1, scatters[0].setup.stories + 1)
    names = [f"{quantity} {number}" for quantity in ("floor mass", "story stiffness") for number in numbers]
    rows, columns = style.grid_of(len(names), 3 if scatters[0].setup.stories % 4 else 4)
    figure = style.new_figure(style.PAGE_WIDTH, 1.75 * rows + 0.8)
    drawn = style.panels(figure, len(names), columns, sharex=True)
    for place, (axes, name) in enumerate(zip(drawn, names, strict=True)):
        axes.set_title(name)
        if place % columns == 0:
            axes.set_ylabel(label)
    figure.supxlabel("standard deviation of a mode-shape entry, %", fontsize=8.5)
    return figure, drawn, [100 * each.setup.mode_shape_std for each in scatters]


def _styles(methods: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Choose colour, marker and line of each method; every other marker is hollow."""
    names = list(methods)
    every = zip(names, style.looks(len(names)), strict=True)
    return {name: {**look, "mfc": "white" if i % 2 else look["color"]} for i, (name, look) in enumerate(every)}


def _boxes(axes: Axes, samples: list[np.ndarray], at: np.ndarray, width: float, place: int) -> None:
    boxes = axes.boxplot(
        samples, positions=at, widths=0.85 * width, patch_artist=True, manage_ticks=False,
        medianprops={"color": "black", "lw": 1.2}, whiskerprops={"lw": 0.7}, capprops={"lw": 0.7},
        flierprops={"marker": ".", "ms": 1.5, "mec": "#555555", "alpha": 0.5},
    )  # fmt: skip
    for box in boxes["boxes"]:
        box.set(alpha=0.8, linewidth=0.7, **_filling(place))


def _filling(place: int) -> dict[str, Any]:
    """Choose colour and hatch of the boxes of a method."""
    return {
        "facecolor": style.COLOURS[place % len(style.COLOURS)], "hatch": style.HATCHES[place % len(style.HATCHES)]
    }  # fmt: skip


MOST_LINES = 6
"""Largest number of floors with one line each; for more floors, the largest and the median are drawn."""


@figure(
    "convergence",
    Identification,
    title="The mass iteration",
    applies=lambda *results: bool(_iterated(*results)),
    needs="a method that iterates on the masses: two-stage",
)
def convergence(*results: Identification, true_mass: Floats | None = None) -> Figure:
    """Error of each floor mass over the iterations of the two-stage method (the paper's Fig. 4).

    Error of each floor mass over the iterations of the two-stage method.

    Parameters
    ----------
    *results : Identification
        Results of a method that iterates on the masses; one panel for each configuration.
    true_mass : ndarray, shape (N,), optional
        Reference masses of the errors, kg. Default: the final masses of the iteration, without its last point.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If no result has an iteration.
    """
    parts = _iterated(*results)
    rows, columns = style.grid_of(len(parts), 2 if len(parts) in (2, 4) else 3)
    figure = style.new_figure(max(style.PAGE_WIDTH * columns / 3, 5.0), 2.6 * rows + 0.6)
    drawn = style.panels(figure, len(parts), columns, sharey=True)
    for place, (axes, part) in enumerate(zip(drawn, parts, strict=True)):
        _panel(axes, part, true_mass)
        title = style.letters(part.name, 20)
        if sum(item.name == part.name for item in parts) > 1 and part.history is not None:
            started = ", ".join(f"{mass:.3g}" for mass in part.history[0, :4])
            title += f"\nfrom {started}{', …' if part.history.shape[1] > 4 else ''} kg"
        axes.set_title(title, fontsize=8.5)
        if place % columns == 0:
            axes.set_ylabel("error of the mass, relative" if true_mass is not None else "mass still to go, relative")
    style.legend(figure, drawn[0], min(len(drawn[0].get_lines()), 6))
    return figure


def _iterated(*results: Identification) -> list[SingleIdentification]:
    """List the parts with more than one step of the mass iteration."""
    return [part for result in results for part in result.parts if part.history is not None and len(part.history) > 1]


def _panel(axes: Axes, part: SingleIdentification, true_mass: Floats | None) -> None:
    assert part.history is not None
    final = part.history[-1] if true_mass is None else np.asarray(true_mass, dtype=float)
    history = part.history[:-1] if true_mass is None else part.history
    errors = np.abs(history / final - 1.0)
    # A logarithmic axis cannot show an error of zero.
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
"""Drawn difference of an answer without difference: below the resolution of 64-bit numbers."""


@figure(
    "backends",
    Comparison,
    title="Agreement of the backends",
    alternative="Differences between the backends and their times; the numbers are in the table that follows.",
    section="worst",
    narrow=True,
)
def backend_differences(comparison: Comparison) -> Figure:
    """Each backend's largest difference from the reference, and its time over that of the closed form.

    Left: how far each backend's answer is from the closed form (from the median of all where a bound is active).
    Right: its time over that of the closed form, on this machine.

    Each backend has one row, each kind of program one marker; a program that a backend cannot solve has no marker.
    """
    names = list(dict.fromkeys(row.backend for row in comparison.rows))
    kinds = list(dict.fromkeys(row.kind for row in comparison.rows))
    stacked = 2 if style.narrow_page() else 1
    figure = style.new_figure(style.page_width(), stacked * (0.27 * len(names) + 1.7))
    # The space keeps the last label of one axis apart from the first label of the other.
    left, right = figure.subplots(stacked, 2 // stacked, sharey=True, gridspec_kw={"wspace": 0.08})
    offsets = np.linspace(-0.28, 0.28, len(kinds)) if len(kinds) > 1 else np.zeros(1)
    for place, (kind, mark) in enumerate(zip(kinds, style.looks(len(kinds)), strict=True)):
        rows = [row for row in comparison.rows if row.kind == kind and not row.failure]
        at = [names.index(row.backend) + offsets[place] for row in rows]
        # Every other kind is hollow: the markers differ without their colours too.
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
