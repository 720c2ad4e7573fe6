"""Draw predicted and measured responses: histories with a band, peaks over height, transfer functions."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cvxshear.report.figures import style
from cvxshear.report.figures.style import figure
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.response.compare import seen
from cvxshear.response.predicted import RESPONSES
from cvxshear.util import ranking
from cvxshear.util.quantities import NORMAL_95, listed, scaled
from cvxshear.util.typing import Floats, Ints

#: Number of periods of the first mode in a time history; more periods would blur the lines.
PERIODS = 16

#: Quantities with peaks that are drawn over the height.
PROFILES = ("floor_acceleration", "story_drift", "story_shear")


def _spread(places: Ints, largest: int) -> Ints:
    """Choose floors or stories to draw, the top first: spread over the height, and including the largest peak."""
    chosen = places[np.unique(np.linspace(0, len(places) - 1, min(style.MOST_PANELS, len(places))).round().astype(int))]
    if largest not in chosen:
        nearest = int(np.argmin(np.abs(chosen - largest)))
        chosen = np.sort(np.concatenate([np.delete(chosen, nearest), [largest]]))
    return np.asarray(chosen[::-1], dtype=np.int64)


def _left_out(shown: int, total: int, word: str, where: str) -> str:
    """State the number of floors or stories without a panel, and where all are listed; empty if all are drawn."""
    if shown >= total:
        return ""
    verb = "is" if total - shown == 1 else "are"
    return f" {total - shown} of {total} {word} {verb} not drawn, but never that of the largest peak; {where}."


def _floors(result: RecordPrediction) -> Ints:
    """Choose the floors to draw: the measured floors if any, and the floor with the largest acceleration."""
    peaks = result.peaks.values["floor_acceleration"]
    measured = result.after.comparison
    places = np.arange(1, len(peaks) + 1) if measured is None else measured.floors
    return _spread(places, ranking.first_largest(peaks) + 1)


def _floors_left_out(result: RecordPrediction) -> str:
    total = len(result.peaks.values["floor_acceleration"])
    return _left_out(len(_floors(result)), total, "floors", "the table of peaks has all")


@figure(
    "history",
    RecordPrediction,
    title="Accelerations over time",
    caption=lambda result: (
        "Total accelerations of the floors around the strongest motion: predicted (dashed), with "
        "the band that holds 95\N{NO-BREAK SPACE}% by the deviations of masses, stiffnesses, effects and damping, and, "
        f"where the record has them, measured.{_floors_left_out(result)}"
    ),
    section="peaks",
)
def response_histories(result: RecordPrediction) -> Figure:
    """Accelerations of the floors over time around the strongest, predicted with a 95 % band, and measured."""
    floors = _floors(result)
    model = result.after.damped.model
    sizes = [np.abs(item.acceleration) for item in result.after.responses]
    run, window = _strongest(sizes, model.modes.frequencies[0], result.motion.sampling_rate)
    driven = result.motion.runs[run]
    time = result.after.responses[run].time[window]
    figure = style.new_figure(style.PAGE_WIDTH, 1.35 * len(floors) + 0.9)
    for axes, floor in zip(style.panels(figure, len(floors), 1, sharex=True, sharey=True), floors, strict=True):
        own = np.array([floor])
        if driven.responses is not None and floor in result.motion.floors:
            column = int(np.flatnonzero(result.motion.floors == floor)[0])
            axes.plot(time, driven.responses[window, column], color=style.MEASURED, lw=1.8, label="measured")
        after = seen(model, result.after.responses[run], own)[window, 0]
        band = NORMAL_95 * np.abs(model.gain[floor - 1]) * result.std[run]["floor_acceleration"][window, floor - 1]
        _band(axes, time, after, band, ls="--", label="predicted")
        axes.set(title=f"floor {floor}", ylabel="m/s²")
    axes.set_xlabel("time, s")
    style.legend(figure, axes, left=True)
    return figure


def _strongest(sizes: list[Floats], first_mode: float, rate: float) -> tuple[int, slice]:
    """Find the run with the largest of these sizes over time, and the samples around it."""
    largest = [each.max(axis=1) for each in sizes]
    run = int(np.argmax([each.max() for each in largest]))
    half = int(PERIODS / 2 / first_mode * rate)
    first = max(0, int(np.argmax(largest[run])) - half)
    return run, slice(first, min(len(largest[run]), first + 2 * half + 1))


def _band(axes: Axes, time: Floats, value: Floats, half: Floats, **look: Any) -> None:
    """Draw a history with its 95 % band, if known."""
    if np.isfinite(half).all():
        axes.fill_between(time, value - half, value + half, color=style.AFTER, alpha=0.25, lw=0, label="95 % band")
    axes.plot(time, value, color=style.AFTER, lw=1.0, **look)
    axes.grid(visible=True, axis="y")


@figure(
    "peaks",
    RecordPrediction,
    title="Peaks",
    caption="Peaks over the height with error bars that hold 95\N{NO-BREAK SPACE}%; circles are measured.",
    alternative="Peaks over the height; the numbers are in the table above.",
    section="peaks",
)
def response_peaks(result: RecordPrediction) -> Figure:
    """Peaks of acceleration, drift and, where masses have a scale, shear over the height, with 95 % error bars."""
    shown = [each for each in PROFILES if each in result.peaks.values]
    n = len(result.after.damped.model.M)
    figure = style.new_figure(style.PAGE_WIDTH, min(1.6 + 0.32 * n, 6.0))
    every = style.panels(figure, len(shown), len(shown), sharey=True)
    for axes, name in zip(every, shown, strict=True):
        values, std, unit = result.peaks.values[name], result.peaks.std[name], RESPONSES[name].unit
        factor, label = (1e-3, "mm") if unit == "m" else scaled(values.tolist(), unit)
        _profile(axes, values / factor, std / factor)
        if name == "floor_acceleration":
            _measured_peaks(axes, result)
        axes.set_xlabel(f"{RESPONSES[name].word}, {label}")
        axes.set_xlim(left=0)
        axes.grid(visible=True, axis="x")
    every[0].set_ylabel("floor / story")
    every[0].yaxis.set_major_locator(MaxNLocator(min(n, 12), integer=True))
    every[0].set_ylim(0.5, n + 0.5)
    style.legend(figure, every[0], left=True)
    return figure


def _profile(axes: Axes, values: Floats, std: Floats) -> None:
    floors = np.arange(1, len(values) + 1)
    known = np.isfinite(std).all()
    axes.errorbar(
        values, floors, xerr=NORMAL_95 * std if known else None, color=style.AFTER, marker="s", ls="-", lw=1.0,
        capsize=2.5, label="predicted, 95 %" if known else "predicted",
    )  # fmt: skip


def _measured_peaks(axes: Axes, result: RecordPrediction) -> None:
    runs = [driven.responses for driven in result.motion.runs if driven.responses is not None]
    if runs:
        top = np.max([np.max(np.abs(each), axis=0) for each in runs], axis=0)
        axes.plot(top, result.motion.floors, color=style.MEASURED, marker="o", mfc="white", ls="none", label="measured")


@figure(
    "drifts",
    Reconstruction,
    title="Drift of every story",
    caption=lambda result: (
        f"Peak drift of each story with bars that hold 95\N{NO-BREAK SPACE}%, the prediction that looks at no sensor, "
        f"and the limits; {_changes(result)}. Triangles mark the floors with sensors."
    ),
    alternative=lambda result: (
        f"Peak drift of each story over the height; {_changes(result)}. The numbers are in the table of the stories."
    ),
    section="findings",
)
def story_drifts(result: Reconstruction) -> Figure:
    """Draw the peak drift of each story with 95 % bars, the prediction, the limits and the sensors."""
    name = "story_drift_ratio" if "story_drift_ratio" in result.peaks.values else "story_drift"
    factor, unit = (100.0, "% of height") if name == "story_drift_ratio" else (1000.0, "mm")
    peaks, std = (factor * each[name] for each in (result.peaks.values, result.peaks.std))
    heights = result.model.heights if result.model.heights is not None else np.ones(len(peaks))
    levels = np.concatenate([[0.0], np.cumsum(heights)])
    middle = 0.5 * (levels[1:] + levels[:-1])
    figure = style.new_figure(style.PAGE_WIDTH, style.LINE * (2 * min(len(peaks), 24) + 8))
    axes = figure.subplots()
    for level in levels:
        axes.axhline(level, color=style.GREY, lw=0.8, zorder=0)
    axes.errorbar(
        peaks, middle, xerr=NORMAL_95 * std, fmt="o", color=style.AFTER, ms=4, capsize=2, label="reconstructed"
    )
    axes.plot(factor * result.predicted_peaks.values[name], middle, "x", color=style.BEFORE, ms=5, label="predicted")
    for story in result.changed:
        at = peaks[story - 1], middle[story - 1]
        axes.annotate(_change(result, story), at, (0, 4), textcoords="offset points", fontsize=7)
    sensors = levels[np.asarray(result.recording.floors)]
    axes.plot(
        np.zeros(len(sensors)), sensors, ls="none", marker=">", color=style.MEASURED, clip_on=False, label="sensor"
    )
    if result.limits is not None and result.passed is not None:
        for word, limit in zip(result.limits.names, result.limits.story_drift, strict=True):
            if 100 * limit < 2 * float(np.max(peaks + NORMAL_95 * std)):
                axes.axvline(100 * limit, color=style.GREY, ls=":", lw=1)
                axes.text(100 * limit, levels[-1], style.letters(word), rotation=90, va="top", ha="right", fontsize=7)
    axes.set_xlim(left=0)
    axes.set_xlabel(f"peak drift, {unit}")
    axes.set_ylabel("elevation, m" if result.model.heights is not None else "story (no heights declared)")
    style.legend(figure, axes, left=True)
    return figure


@figure(
    "histories",
    Reconstruction,
    title="Drifts over time",
    caption=lambda result: (
        "Drifts around the strongest motion, with the band that holds 95\N{NO-BREAK SPACE}%."
        + _left_out(
            len(_drawn_stories(result)), len(result.model.M), "stories", "the table of the stories has the peaks of all"
        )
    ),
    section="frame",
)
def reconstructed_histories(result: Reconstruction) -> Figure:
    """Drifts of the stories over time around the strongest motion, with 95 % bands."""
    sizes = [np.abs(item.response.drift) for item in result.runs]
    run, window = _strongest(sizes, result.model.modes.frequencies[0], result.recording.sampling_rate)
    moved, std = result.runs[run].response, result.runs[run].std["story_drift"]
    stories = _drawn_stories(result)
    figure = style.new_figure(style.PAGE_WIDTH, 1.35 * len(stories) + 0.9)
    for axes, story in zip(style.panels(figure, len(stories), 1, sharex=True), stories, strict=True):
        drift, band = 1000 * moved.drift[window, story - 1], 1000 * NORMAL_95 * std[window, story - 1]
        _band(axes, moved.time[window], drift, band, label="reconstructed")
        axes.set(title=f"story {story}", ylabel="mm")
    axes.set_xlabel("time, s")
    style.legend(figure, axes, left=True)
    return figure


def _change(result: Reconstruction, story: int) -> str:
    """Write the change of a story's stiffness against the identified one, such as "12 % softer"."""
    change = 100 * float(result.frame.against_others[0][story - 1])
    return f"{abs(change):.0f} % {'softer' if change < 0 else 'stiffer'}"


def _changes(result: Reconstruction) -> str:
    """Name the changed stories with their changes."""
    if not result.frame_fitted:
        return "whether a story changed was not asked"
    said = [f"story {each} is {_change(result, each)} than identified, against the others" for each in result.changed]
    return listed(said) if said else "no story is named as changed"


def _drawn_stories(result: Reconstruction) -> Ints:
    """Choose the stories with a drift history, including the one that the headline names."""
    peaks = result.peaks.values
    peak = peaks.get("story_drift_ratio", peaks["story_drift"])
    return _spread(np.arange(1, len(peak) + 1), ranking.first_largest(peak) + 1)
