"""Draw charts: histories over many tests, and scatter under noise."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cvxshear.paper.scatter import NoiseStudy, Scatter
from cvxshear.report.figures import style
from cvxshear.screening import History
from cvxshear.util.errors import InputError


@style.figure("history", History, title="Frequencies, stiffnesses and damping over the tests", section="changes")
def changes_over_time(result: History) -> Figure:
    """Change of each frequency, story stiffness and damping ratio over the tests; the numbers are in the table below.

    Dots: each test alone, relative to the mean over the tests, with one standard deviation. Lines: stiffnesses with
    the changes that were found.

    Parameters
    ----------
    result : History

    Returns
    -------
    Figure
    """
    tests = result.loop.experiment.configurations
    dated = all(each.date is not None for each in tests)
    at = np.array([each.date for each in tests], dtype="datetime64[s]") if dated else np.arange(1, len(tests) + 1)
    every = (
        ("frequency", "mode", result.by_mode("frequencies")),
        ("story stiffness", "story", dict(enumerate(result.story_stiffness.T, 1))),
        ("damping ratio", "mode", result.by_mode("damping_ratios")),
    )
    groups = [(label, word, list(lines.items())[: len(style.MARKERS) - 1]) for label, word, lines in every if lines]
    figure, drawn = style.panels(len(groups), 1, 1.75, 0.5, sharex=True)
    for axes, (label, word, lines) in zip(drawn, groups, strict=True):
        for (number, values), look in zip(lines, style.looks(len(lines)), strict=True):
            mean, std = float(np.nanmean(values)), None
            if word == "story":
                std = 100 * result.story_stiffness_std[:, number - 1] / mean
                axes.plot(at, 100 * (result.fitted[:, number - 1] / mean - 1.0), color=look["color"], lw=1.0)
            dots = {**look, "ls": "none", "ms": 3.5, "lw": 0.7, "label": f"{word} {number}"}
            axes.errorbar(at, 100 * (values / mean - 1.0), yerr=std, **dots)
        axes.set_ylabel(f"{label},\nchange in %")
        axes.grid(visible=True, axis="y")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7)
    if dated:
        axes.xaxis.set_major_formatter(ConciseDateFormatter(axes.xaxis.get_major_locator()))  # type: ignore[no-untyped-call]
    axes.set_xlabel("date" if dated else "test")
    return figure


@style.figure("variation", NoiseStudy, title="Coefficients of variation")
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
    figure, drawn, levels, groups = _panels(study, "coefficient of\nvariation, %")
    for parameter, axes in enumerate(drawn):
        for place, ((method, scatters), look) in enumerate(zip(groups.items(), style.looks(len(groups)), strict=True)):
            values = [100 * each.variation[parameter] for each in scatters]
            # Every other marker is hollow.
            axes.plot(levels, values, label=method, mfc="white" if place % 2 else look["color"], **look)
        bound = [100 * each.relative_bound[parameter] for each in next(iter(groups.values()))]
        # A single level has no line: a dash marks its bound.
        axes.plot(levels, bound, color="black", lw=2.2, ls=(0, (1, 1)), marker="_", ms=9.0, label="Cramér-Rao bound")
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        axes.set_xticks([0, *levels] if len(levels) <= 6 else axes.get_xticks())
        axes.grid()
    style.legend(figure)
    return figure


@style.figure("boxes", NoiseStudy, title="Scatter of the estimates")
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
    figure, drawn, levels, groups = _panels(study, "error, %")
    # The gap between two noise levels is as wide as a box.
    width = 1 / (len(groups) + 1)
    for parameter, axes in enumerate(drawn):
        axes.axhline(0, color="black", lw=0.7)
        for place, scatters in enumerate(groups.values()):
            at = np.arange(len(levels)) + (place - (len(groups) - 1) / 2) * width
            boxes = axes.boxplot(
                [100 * each.errors[:, parameter] for each in scatters], positions=at, widths=0.85 * width,
                patch_artist=True, manage_ticks=False,
                medianprops={"color": "black", "lw": 1.2}, whiskerprops={"lw": 0.7}, capprops={"lw": 0.7},
                flierprops={"marker": ".", "ms": 1.5, "mec": "#555555", "alpha": 0.5},
            )  # fmt: skip
            for box in boxes["boxes"]:
                box.set(alpha=0.8, linewidth=0.7, **_filling(place))
        axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
        axes.set_xlim(-0.6, len(levels) - 0.4)
        axes.grid(axis="y")
    handles = [Patch(ec="black", alpha=0.8, label=name, **_filling(i)) for i, name in enumerate(groups)]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _panels(study: NoiseStudy, label: str) -> tuple[Figure, list[Axes], list[float], dict[str, list[Scatter]]]:
    """Make one panel for each mass and stiffness, masses first; return the noise levels, %, and each method's scatters.

    The study has one frame.
    """
    if len({(each.setup.name, each.setup.stories) for each in study.scatters}) > 1:
        raise InputError("a figure shows one frame: give a study whose setups differ in their noise alone")
    groups: dict[str, list[Scatter]] = {}
    for each in study.scatters:
        groups.setdefault(each.method, []).append(each)
    setups = [each.setup for each in next(iter(groups.values()))]
    numbers = range(1, setups[0].stories + 1)
    names = [f"{quantity} {number}" for quantity in ("floor mass", "story stiffness") for number in numbers]
    columns = 3 if setups[0].stories % 4 else 4
    figure, drawn = style.panels(len(names), columns, 1.75, 0.8, sharex=True)
    for place, (axes, name) in enumerate(zip(drawn, names, strict=True)):
        axes.set_title(name)
        if place % columns == 0:
            axes.set_ylabel(label)
    figure.supxlabel("standard deviation of a mode-shape entry, %", fontsize=8.5)
    return figure, drawn, [100 * each.mode_shape_std for each in setups], groups


def _filling(place: int) -> dict[str, Any]:
    """Choose colour and hatch of the boxes of a method."""
    colour, hatch = (each[place % len(each)] for each in (style.COLOURS, style.HATCHES))
    return {"facecolor": colour, "hatch": hatch}
