"""The noise study: how estimates scatter, beside the least that is possible."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cvxshear.paper.scatter import NoiseStudy, Scatter
from cvxshear.report.figures import style
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.errors import InputError

BOX = 0.8
"""Of the distance between two noise levels, what the boxes of all methods take."""


@figure(
    "boxes",
    NoiseStudy,
    title="Scatter of the estimates",
    caption="Boxes hold the middle half of the estimates with the median; whiskers reach 1.5 box lengths at most.",
    alternative="Box plots of the identified masses and stiffnesses at each noise level.",
)
def noise_boxes(study: NoiseStudy, methods: tuple[str, ...] = ()) -> Figure:
    """Box plots of the identified masses and stiffnesses at each noise level (the paper's Fig. 5).

    Parameters
    ----------
    study : NoiseStudy
        Of one frame at one or several noise levels.
    methods : tuple of str, optional
        Those to show; all where empty.

    Returns
    -------
    Figure
        Boxes hold the middle half with the median, whiskers reach 1.5 box lengths at most; points lie beyond.
    """
    groups = _by_method(study, methods)
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


@figure(
    "variation",
    NoiseStudy,
    title="Coefficients of variation",
    caption="Coefficient of variation of each estimate over the noise level, beside the Cramér-Rao bound.",
    alternative="Coefficients of variation of each method beside the Cramér-Rao bound.",
)
def noise_variation(study: NoiseStudy, methods: tuple[str, ...] = ()) -> Figure:
    """Coefficients of variation beside the Cramer-Rao bound (the paper's Fig. 6).

    Parameters
    ----------
    study : NoiseStudy
        Of one frame at one or several noise levels.
    methods : tuple of str, optional
        Those to show; all where empty.

    Returns
    -------
    Figure
        Over the noise level; with one level only, over the masses and stiffnesses.
    """
    groups = _by_method(study, methods)
    if len(next(iter(groups.values()))) == 1:
        return _one_level({method: scatters[0] for method, scatters in groups.items()})
    first = next(iter(groups.values()))
    figure, drawn, levels = _panels_of(first, "coefficient of\nvariation, %")
    for parameter, axes in enumerate(drawn):
        for method, look in _styles(groups).items():
            axes.plot(levels, [100 * each.variation[parameter] for each in groups[method]], label=method, **look)
        bound = [100 * each.relative_bound[parameter] for each in first]
        axes.plot(levels, bound, color="black", lw=2.2, ls=(0, (1, 1)), label="Cramér-Rao bound")
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        axes.set_xticks([0, *levels] if len(levels) <= 6 else axes.get_xticks())
        axes.grid()
    style.legend(figure, drawn[0])
    return figure


def _one_level(scatters: dict[str, Scatter]) -> Figure:
    first = next(iter(scatters.values()))
    names = _names(first)
    figure = style.new_figure(style.PAGE_WIDTH, 3.2)
    axes = figure.subplots()
    places = np.arange(len(names))
    axes.bar(places, 100 * first.relative_bound, width=0.75, fc="#E4E4E4", ec="black", lw=0.8, label="Cramér-Rao bound")
    step = 0.6 / max(len(scatters), 2)
    for i, (method, look) in enumerate(_styles(scatters).items()):
        at = places + (i - (len(scatters) - 1) / 2) * step
        axes.plot(at, 100 * scatters[method].variation, label=method, **{**look, "ls": "none"})
    turned = len(names) > 16
    shown = names if turned else [name.replace(" ", "\n", 1) for name in names]
    axes.set_xticks(places, shown, rotation=90 if turned else 0, fontsize=6.5)
    axes.set_ylabel("coefficient of variation, %")
    axes.set_xlabel(f"parameter (noise of a mode-shape entry: {100 * first.setup.mode_shape_std:g} %)")
    axes.grid(axis="y")
    figure.legend(loc="outside upper center", ncols=len(scatters) + 1)
    return figure


def _by_method(study: NoiseStudy, methods: tuple[str, ...]) -> dict[str, list[Scatter]]:
    """The scatters of each method over the noise levels of one frame."""
    chosen = [each for each in study.scatters if not methods or each.method in methods]
    if not chosen:
        there = sorted({each.method for each in study.scatters})
        raise InputError(f"the study has none of the methods {', '.join(methods)}; it has {', '.join(there)}")
    if len({(each.setup.name, each.setup.stories) for each in chosen}) > 1:
        raise InputError("a figure shows one frame: give a study whose setups differ in their noise alone")
    ordered = sorted(chosen, key=lambda each: [item.method for item in chosen].index(each.method))
    return {method: list(group) for method, group in groupby(ordered, key=lambda each: each.method)}


def _names(scatter: Scatter) -> list[str]:
    numbers = range(1, scatter.setup.stories + 1)
    return [*(f"floor mass {i}" for i in numbers), *(f"story stiffness {i}" for i in numbers)]


def _panels_of(scatters: list[Scatter], label: str) -> tuple[Figure, list[Axes], list[float]]:
    """One panel a mass and a stiffness, masses first; and the noise levels, %."""
    names = _names(scatters[0])
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
    """Colour, marker and line of each method; every other marker is hollow."""
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
    """Colour and hatch of the boxes of a method."""
    return {
        "facecolor": style.COLOURS[place % len(style.COLOURS)], "hatch": style.HATCHES[place % len(style.HATCHES)]
    }  # fmt: skip
