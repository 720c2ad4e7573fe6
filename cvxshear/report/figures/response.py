"""Draw predicted and measured responses: histories with a band, peaks over height, and the frame in motion."""

from collections.abc import Iterator, Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cvxshear.loop import LoopResult
from cvxshear.measurement.configuration import Sensor
from cvxshear.records import ModalResult
from cvxshear.records.picking import scaled_to_one
from cvxshear.report.figures import drawn_frame, mode_figures, style
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.response.compare import seen
from cvxshear.response.predicted import RESPONSES
from cvxshear.util import ranking
from cvxshear.util.quantities import NORMAL_95, scaled, significant, significants
from cvxshear.util.typing import Floats, Ints, Json

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


def _left_out(shown: int, total: int, word: str) -> str:
    """State the number of floors or stories without a panel; empty if all are drawn."""
    if shown >= total:
        return ""
    verb = "is" if total - shown == 1 else "are"
    return f" {total - shown} of {total} {word} {verb} not drawn, never that of the largest peak; the tables have all."


def _floors(result: RecordPrediction) -> Ints:
    """Choose the floors to draw: the measured floors if any, and the floor with the largest acceleration."""
    peaks = result.peaks.values["floor_acceleration"]
    measured = result.after.comparison
    places = np.arange(1, len(peaks) + 1) if measured is None else measured.floors
    return _spread(places, ranking.first_largest(peaks) + 1)


@style.figure(
    "history",
    RecordPrediction,
    title="Accelerations over time",
    caption=lambda result: (
        "Total accelerations of the floors around the strongest motion: predicted (dashed), with "
        "the band that holds 95\N{NO-BREAK SPACE}% by the deviations of masses, stiffnesses, effects and damping, and, "
        "where the record has them, measured."
        + _left_out(len(_floors(result)), len(result.after.damped.model.M), "floors")
    ),
    section="peaks",
)
def response_histories(result: RecordPrediction) -> Figure:
    """Accelerations of the floors over time around the strongest, predicted with a 95 % band, and measured.

    Parameters
    ----------
    result : RecordPrediction

    Returns
    -------
    Figure
    """
    floors = _floors(result)
    model = result.after.damped.model
    sizes = [np.abs(item.acceleration) for item in result.after.responses]
    run, window = _strongest(sizes, model.modes.frequencies[0], result.motion.sampling_rate)
    driven = result.motion.runs[run]
    time = result.after.responses[run].time[window]
    figure, every = style.panels(len(floors), 1, 1.35, 0.9, sharex=True, sharey=True)
    for axes, floor in zip(every, floors, strict=True):
        if driven.responses is not None and floor in result.motion.floors:
            column = int(np.flatnonzero(result.motion.floors == floor)[0])
            axes.plot(time, driven.responses[window, column], color=style.MEASURED, lw=1.8, label="measured")
        after = seen(model, result.after.responses[run], np.array([floor]))[window, 0]
        band = NORMAL_95 * np.abs(model.gain[floor - 1]) * result.std[run]["floor_acceleration"][window, floor - 1]
        _band(axes, time, after, band, ls="--", label="predicted")
        axes.set(title=f"floor {floor}", ylabel="m/s²")
    axes.set_xlabel("time, s")
    style.legend(figure, left=True)
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


@style.figure("peaks", RecordPrediction, title="Peaks", section="peaks")
def response_peaks(result: RecordPrediction) -> Figure:
    """Peaks over the height; the numbers are in the table above.

    Peaks over the height with error bars that hold 95 %; circles are measured.

    Parameters
    ----------
    result : RecordPrediction

    Returns
    -------
    Figure
    """
    shown = [each for each in PROFILES if each in result.peaks.values]
    n = len(result.after.damped.model.M)
    floors = np.arange(1, n + 1)
    measured = [driven.responses for driven in result.motion.runs if driven.responses is not None]
    figure, every = style.panels(len(shown), len(shown), min(1.6 + 0.32 * n, 6.0), sharey=True)
    for axes, name in zip(every, shown, strict=True):
        values, std, unit = result.peaks.values[name], result.peaks.std[name], RESPONSES[name].unit
        factor, label = (1e-3, "mm") if unit == "m" else scaled(values.tolist(), unit)
        known = bool(np.isfinite(std).all())
        axes.errorbar(
            values / factor, floors, xerr=NORMAL_95 * std / factor if known else None, color=style.AFTER, marker="s",
            ls="-", lw=1.0, capsize=2.5, label="predicted, 95 %" if known else "predicted",
        )  # fmt: skip
        if name == "floor_acceleration" and measured:
            top = np.max([np.max(np.abs(each), axis=0) for each in measured], axis=0)
            axes.plot(top, result.motion.floors, "o", color=style.MEASURED, mfc="white", label="measured")
        axes.set_xlabel(f"{RESPONSES[name].word}, {label}")
        axes.set_xlim(left=0)
        axes.grid(visible=True, axis="x")
    every[0].set_ylabel("floor / story")
    every[0].yaxis.set_major_locator(MaxNLocator(min(n, 12), integer=True))
    every[0].set_ylim(0.5, n + 0.5)
    style.legend(figure, left=True)
    return figure


@style.figure("drifts", Reconstruction, title="Drift of every story", section="findings")
def story_drifts(result: Reconstruction) -> Figure:
    """Peak drift of each story over the height; the numbers are in the table of the stories.

    Peak drift of each story with bars that hold 95 %, the prediction that looks at no sensor, and the limits. A story
    that changed by itself has its change against the others. Triangles mark the floors with sensors.

    Parameters
    ----------
    result : Reconstruction

    Returns
    -------
    Figure
    """
    name = "story_drift_ratio" if "story_drift_ratio" in result.peaks.values else "story_drift"
    factor, unit = (100.0, "% of height") if name == "story_drift_ratio" else (1000.0, "mm")
    peaks, band = factor * result.peaks.values[name], factor * NORMAL_95 * result.peaks.std[name]
    heights = result.model.heights if result.model.heights is not None else np.ones(len(peaks))
    levels = np.concatenate([[0.0], np.cumsum(heights)])
    middle = 0.5 * (levels[1:] + levels[:-1])
    figure, (axes,) = style.panels(1, 1, style.LINE * (2 * min(len(peaks), 24) + 8))
    for level in levels:
        axes.axhline(level, color=style.GREY, lw=0.8, zorder=0)
    axes.errorbar(peaks, middle, xerr=band, fmt="o", color=style.AFTER, ms=4, capsize=2, label="reconstructed")
    axes.plot(factor * result.predicted_peaks.values[name], middle, "x", color=style.BEFORE, ms=5, label="predicted")
    for story in result.changed:
        at = peaks[story - 1], middle[story - 1]
        change = float(result.frame.against_others[0][story - 1])
        said = f"{100 * abs(change):.0f} % {'softer' if change < 0 else 'stiffer'}"
        axes.annotate(said, at, (0, 4), textcoords="offset points", fontsize=7)
    sensors = levels[np.asarray(result.recording.floors)]
    axes.plot(0 * sensors, sensors, ls="none", marker=">", color=style.MEASURED, clip_on=False, label="sensor")
    if result.limits is not None and result.passed is not None:
        for word, limit in zip(result.limits.names, result.limits.story_drift, strict=True):
            if 100 * limit < 2 * float(np.max(peaks + band)):
                axes.axvline(100 * limit, color=style.GREY, ls=":", lw=1)
                axes.text(100 * limit, levels[-1], style.letters(word), rotation=90, va="top", ha="right", fontsize=7)
    axes.set_xlim(left=0)
    axes.set_xlabel(f"peak drift, {unit}")
    axes.set_ylabel("elevation, m" if result.model.heights is not None else "story (no heights declared)")
    style.legend(figure, left=True)
    return figure


@style.figure(
    "histories",
    Reconstruction,
    title="Drifts over time",
    caption=lambda result: (
        "Drifts around the strongest motion, with the band that holds 95\N{NO-BREAK SPACE}%."
        + _left_out(len(_drawn_stories(result)), len(result.model.M), "stories")
    ),
    section="frame",
)
def reconstructed_histories(result: Reconstruction) -> Figure:
    """Drifts of the stories over time around the strongest motion, with 95 % bands.

    Parameters
    ----------
    result : Reconstruction

    Returns
    -------
    Figure
    """
    sizes = [np.abs(item.response.drift) for item in result.runs]
    run, window = _strongest(sizes, result.model.modes.frequencies[0], result.recording.sampling_rate)
    moved, std = result.runs[run].response, result.runs[run].std["story_drift"]
    stories = _drawn_stories(result)
    figure, every = style.panels(len(stories), 1, 1.35, 0.9, sharex=True)
    for axes, story in zip(every, stories, strict=True):
        drift, band = 1000 * moved.drift[window, story - 1], 1000 * NORMAL_95 * std[window, story - 1]
        _band(axes, moved.time[window], drift, band, label="reconstructed")
        axes.set(title=f"story {story}", ylabel="mm")
    axes.set_xlabel("time, s")
    style.legend(figure, left=True)
    return figure


def _drawn_stories(result: Reconstruction) -> Ints:
    """Choose the stories with a drift history, including the one that the headline names."""
    peaks = result.peaks.values
    peak = peaks.get("story_drift_ratio", peaks["story_drift"])
    return _spread(np.arange(1, len(peak) + 1), ranking.first_largest(peak) + 1)


# The frame in motion, as SVG that a browser plays without a script.

#: Width of a frame in motion and its largest sway from side to side, in pixels; a panel is three times as wide.
SWAY = 60.0

#: Number of pictures in a second of an animation, which shows one period of the first mode.
PICTURES = 20


@singledispatch
def animations(*results: Any) -> Iterator[Json]:
    """Yield the animations of results of one type as a page shows them: SVG without a script.

    Parameters
    ----------
    *results : LoopResult, Reconstruction or ModalResult
        Other results have no animation.

    Yields
    ------
    dict
        `name`, `title`, `caption`, `alternative` and `section` as of a figure; `svg`, the drawing; `moves`, true.
    """
    yield from ()


@animations.register
def _swaying(result: LoopResult) -> Iterator[Json]:
    """Move the modes of the final model, each as the first test that measured it shows it."""
    caption, experiment = "The modes of the final model, with measured frequencies.", result.experiment
    if experiment.frame.turns:
        tested, found = experiment.configurations[0], result.estimate.predictions[0]
        shapes = found.mode_shapes[found.modes - 1]
        yield _moving_plans(tested.sensors, shapes, tested.modes, tested.frequencies, caption, experiment.frame.plan)
        return
    modes = {each.mode: (each.frequency, each.modelled) for each in reversed(mode_figures.mode_shapes(result.estimate))}
    yield _moving_frames(modes, drawn_frame.elevations(experiment)[0], caption)


@animations.register
def _swaying_records(*results: ModalResult) -> Iterator[Json]:
    """Move the measured modes, each as the first record that has it shows it."""
    first, caption = results[0], "The measured modes at the floors with sensors."
    if first.sensors:
        yield _moving_plans(first.sensors, first.mode_shapes, first.modes, first.frequencies, caption)
        return
    found = {
        mode: (frequency, shape)
        for each in reversed(results)
        for mode, frequency, shape in zip(each.modes.tolist(), each.frequencies, each.mode_shapes, strict=True)
        if np.array_equal(each.floors, first.floors)
    }
    yield _moving_frames(found, first.floors, caption)


def _moving_frames(found: dict[int, tuple[float, Floats]], levels: Floats | Ints, caption: str) -> Json:
    """Draw modes of frames by the frequency and the shape of each number."""
    modes = {}
    for mode, (frequency, given) in found.items():
        shape = scaled_to_one(given)
        said = f"sway from the lowest floor up: {', '.join(significants(shape.tolist()))}"
        modes[mode] = (frequency, said, [_outline(sign * shape, levels) for sign in (1.0, -1.0, 0.0)])
    return _modes(modes, caption)


def _moving_plans(
    sensors: Sequence[Sensor], shapes: Floats, modes: Ints, frequencies: Floats, caption: str,
    plan: Floats | None = None,
) -> Json:  # fmt: skip
    """Draw modes of floors that turn, from above."""
    outline, displaced = drawn_frame.displaced_plans(sensors, shapes, plan)
    scale = 1.4 * SWAY / float(np.max(np.ptp(outline, axis=0))) * np.array([1.0, -1.0])

    def path(by: Floats) -> str:
        corners = (outline + by - outline.mean(axis=0)) * scale - [0.0, SWAY]
        return "".join(f"M{'L'.join(f'{x:.1f} {y:.1f}' for x, y in floor)}z" for floor in corners)

    found = {}
    for place, (mode, frequency) in enumerate(zip(modes.tolist(), frequencies.tolist(), strict=True)):
        said = drawn_frame.shares_in_words(sensors, shapes[place : place + 1])
        found[mode] = (frequency, said, [path(sign * displaced[place]) for sign in (1.0, -1.0, 0.0)])
    return _modes(found, caption)


def _modes(found: dict[int, tuple[float, str, list[str]]], caption: str) -> Json:
    """Draw modes in motion: frequency, words, and paths of an SVG at both ends and at rest, by the mode's number."""
    panels, columns = [], min(len(found), style.MOST_PANELS)
    for place, (mode, (frequency, said, (one, other, rest))) in enumerate(sorted(found.items())):
        label = f"mode {mode}: {frequency:#.4g} Hz"
        slow = 'calcMode="spline" keyTimes="0;.5;1" keySplines=".4 0 .6 1;.4 0 .6 1"'
        drawn = _still(one, rest, label) + _moving([one, other, one], rest, 2.0, more=_words(label), how=slow)
        panels.append(_panel(f"<title>{label}; {escape(said)}</title>{drawn}", place % columns, place // columns))
    return {
        "name": "swaying",
        "title": "Mode shapes in motion",
        "section": "shapes",
        "caption": f"{caption} All sway at one speed and equally far.",
        "alternative": "The mode shapes in motion; another figure shows the same shapes.",
        "svg": _svg(panels, columns, -(-len(found) // columns)),
        "moves": True,
    }


@animations.register
def _shaking(result: Reconstruction) -> Iterator[Json]:
    """Replay the strongest motion beside the excitation; stills show one period in quarters."""
    sizes = [np.abs(item.response.drift) for item in result.runs]
    first_mode, rate = float(result.model.modes.frequencies[0]), result.recording.sampling_rate
    place, window = _strongest(sizes, first_mode, rate)
    run, peak = result.runs[place], int(np.argmax(sizes[place].max(axis=1)))
    step = max(1, round(rate / first_mode / PICTURES))
    shown = np.arange(window.start + (peak - window.start) % step, window.stop, step)
    sways, excitation, time = run.response.displacement, run.excitation[shown], run.response.time
    largest = np.max(np.abs(sways[shown]), axis=0)
    top = ranking.first_largest(largest)
    sways = sways / largest[top]
    heights = run.response.heights
    levels = np.arange(1, len(largest) + 1) if heights is None else np.cumsum(heights)
    quarters = peak + np.round(np.arange(style.MOST_PANELS) * rate / first_mode / 4).astype(int)
    rest = _outline(np.zeros(len(levels)), levels)
    stills = [
        _panel(_still(_outline(sways[at], levels), rest, f"{time[at]:.2f} s"), column, 0)
        for column, at in enumerate(np.minimum(quarters, len(time) - 1))
    ]
    seconds = float(time[shown[-1]] - time[shown[0]]) * first_mode
    driven = _history(excitation, time[shown], seconds)
    replayed = _panel(_moving([_outline(sway, levels) for sway in sways[shown]], rest, seconds, more=driven), 0, 0)
    said = f"largest sway from floor 1 up: {', '.join(significants((1e3 * largest).tolist(), 3))} mm"
    word, unit = ("force", "N") if result.recording.input == "force" else ("base acceleration", "m/s²")
    strongest = significant(float(np.abs(excitation).max()), 3)
    yield {
        "name": "shaking",
        "title": "The strongest motion",
        "section": "motion",
        "caption": (
            f"The frame against the ground around the strongest motion; floor {top + 1} sways most, by "
            f"{significant(1e3 * float(largest[top]), 3)} mm. In motion, beside the {word} (at most {strongest} "
            f"{unit}), a second shows {significant(1 / first_mode, 2)} s. Without motion: one period in quarters."
        ),
        "alternative": f"The frame as it swayed; {said}.",
        "svg": _svg([f"<title>{said}</title>", *stills, replayed], style.MOST_PANELS, 1),
        "moves": True,
    }


def _outline(sway: Floats, levels: Floats | Ints) -> str:
    """Write a frame as the path of an SVG, story by story; the middle of its base is the origin."""
    x = SWAY / 2 * (np.concatenate([[0.0], sway]) - 1.0)
    y = -2 * SWAY * np.concatenate([[0.0], levels / levels[-1]])
    corners = zip(x, y, x[1:], y[1:], strict=False)
    return "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}h{SWAY:g}L{a + SWAY:.1f} {b:.1f}z" for a, b, c, d in corners)


def _still(swayed: str, rest: str, label: str) -> str:
    """Draw the path of a swayed frame before that of the frame at rest, for readers without motion."""
    return f'<g class="still"><path class="rest" d="{rest}"/><path d="{swayed}"/>{_words(label)}</g>'


def _moving(paths: Sequence[str], rest: str, seconds: float, *, more: str, how: str = "") -> str:
    """Draw a frame that goes through these paths again and again."""
    repeat = f'dur="{seconds:.2f}s" repeatCount="indefinite"'
    moved = f'<path><animate attributeName="d" {repeat} {how} values="{";".join(paths)}"/></path>'
    return f'<g class="moving"><path class="rest" d="{rest}"/>{moved}{more}</g>'


def _history(values: Floats, time: Floats, seconds: float) -> str:
    """Draw the excitation beside a frame, with a line that moves along as time passes."""
    x, y = np.linspace(2 * SWAY, 10 * SWAY, len(values)), -SWAY * (1 + values / np.abs(values).max())
    line = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    ends = _words(f"{time[0]:.1f} s", x[0]) + _words(f"{time[-1]:.1f} s", x[-1])
    way = f'values="{x[0]:g};{x[-1]:g}" dur="{seconds:.2f}s" repeatCount="indefinite"'
    now = f'<path d="M0 0V{-2 * SWAY:g}"><animateTransform attributeName="transform" type="translate" {way}/></path>'
    return f'<path d="M{line}"/>{now}{ends}'


def _words(text: str, x: float = 0.0) -> str:
    return f'<text x="{x:g}" y="18" text-anchor="middle">{text}</text>'


def _panel(drawn: str, column: int, row: int) -> str:
    """Put a drawing into a panel of a grid."""
    return f'<g transform="translate({(3 * column + 1.5) * SWAY:g} {(2.6 * row + 2.1) * SWAY:g})">{drawn}</g>'


def _svg(parts: list[str], columns: int, rows: int) -> Markup:
    """Write a drawing of panels; all of its texts are numbers and words from here."""
    width, height = 3 * SWAY * columns, (2.6 * rows - 0.1) * SWAY
    size = f'width="{width:g}" style="--width: {width:g}px" viewBox="0 0 {width:g} {height:g}"'
    return Markup(f'<svg class="motion" aria-hidden="true" focusable="false" {size}>{"".join(parts)}</svg>')
