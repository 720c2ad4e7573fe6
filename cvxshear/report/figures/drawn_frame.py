"""Draw the frame to scale with the located effects, or with its identified masses and stiffnesses."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle

from cvxshear.effects import LocatedEffect
from cvxshear.effects.open_class import STANDS_OUT, named_pair
from cvxshear.effects.stories import SIDES
from cvxshear.effects.whole_frame import separate_levels
from cvxshear.fit.results import Identification, IdentifiedFrame
from cvxshear.fit.turning_floors import TurningFrame
from cvxshear.loop import LoopResult
from cvxshear.loop.results import AddedEffect
from cvxshear.measurement.configuration import Sensor, motion_shares
from cvxshear.measurement.declaration import MOTIONS
from cvxshear.measurement.experiment import Experiment
from cvxshear.planning import Plan, predicted
from cvxshear.report.figures import style
from cvxshear.report.headline import NAMED
from cvxshear.report.identified import in_one_unit
from cvxshear.util.quantities import AUTOMATIC, SURE, chance, counted, percent
from cvxshear.util.typing import Floats

#: Thickness of the heaviest floor as a fraction of the smallest story height.
SLAB = 0.3

#: Distance of a label from a column, as a fraction of the panel's width.
LABEL_DISTANCE = 0.07

#: Width of the columns of the largest story stiffness, points; other columns are proportional.
THICKEST = 7.0


#: Horizontal places of the two columns of a drawn frame, as fractions of the panel's width.
Columns = tuple[float, float]


def elevations(experiment: Experiment) -> tuple[Floats, str]:
    """Return the floor elevations, shape (N,), and their axis label; without declared heights, stories are equal."""
    declared = experiment.frame.elevations
    if declared is None:
        return np.arange(1.0, experiment.stories + 1), "floor (no story heights declared)"
    return declared, "elevation, m"


def _structure(axes: Axes, found: IdentifiedFrame, z: Floats, at: Columns) -> None:
    """Draw the ground, columns with widths by story stiffness, and slabs with thicknesses by floor mass."""
    heights, total = np.diff(z, prepend=0.0), float(z[-1])
    mass, stiffness = (np.nan_to_num(values) for values in (found.floor_mass, found.story_stiffness))
    slabs = SLAB * float(heights.min()) * mass / (float(mass.max()) or 1.0)
    strokes = THICKEST * stiffness / (float(stiffness.max()) or 1.0)
    left, right = at
    below = (left - 0.04, -0.04 * total), right - left + 0.08, 0.04 * total
    axes.add_patch(Rectangle(*below, fc="none", ec=style.GREY, hatch="////", lw=0))
    axes.plot([left - 0.04, right + 0.04], [0, 0], color="black", lw=1.0)
    for low, high, stroke in zip(z - heights, z, strokes, strict=True):
        for side in at:
            axes.plot([side, side], [low, high], color=style.AFTER, lw=stroke, solid_capstyle="butt")
    for level, slab in zip(z, slabs, strict=True):
        place = (left - 0.02, level - slab / 2)
        axes.add_patch(Rectangle(place, right - left + 0.04, slab, fc=style.PALE, ec="black", lw=0.8, zorder=3))
    axes.set(xlim=(0, 1), ylim=(-0.045 * total, total + float(slabs.max())), xticks=[])
    axes.spines["bottom"].set_visible(False)
    # Without heights the axis shows floor numbers, which are integers.
    axes.locator_params("y", integer=bool(np.all(heights == 1.0)))


def _leader(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.plot(*zip(start, end, strict=True), color=style.GREY, lw=0.5)


# Figure of the located effects.


@style.figure("findings", LoopResult, title="What was found, and where", section="verdict", **style.OF_ONE_MOTION)
def findings(result: LoopResult) -> Figure:
    """Frame of each state to scale; what was found is marked where it acts, as in the table of effects.

    The frame, heights to scale if declared; a slab is the thicker the heavier its floor, a column the wider the stiffer
    its story. Masses without added mass and stiffnesses are averages over all sets of effects. Triangles: floors with a
    sensor. Orange: what was found, with its size and probability; dashed: what may be there in its place. Of many
    states those are drawn of which most is sure.

    Parameters
    ----------
    result : LoopResult

    Returns
    -------
    Figure
        One panel for each state with effects, and one for a state without effects. If no effect was added, the
        figure shows the frame's masses and stiffnesses.
    """
    if not result.effects:
        return _numbered_frames(result.experiment, [("", result.averaged)], sensors=True)
    states = _shown_states(result)
    columns = min(len(states), 2)
    marks = [_marks(result, state, first=not place) for place, state in enumerate(states)]
    lines = max(sum(mark.lines for mark in each) for each in marks)
    height = float(np.clip(max(result.experiment.stories * 0.36, lines * style.LINE), 1.9, 6.5))
    width = style.PAGE_WIDTH if columns > 1 else 5.4
    drawn, every = style.panels(len(states), columns, height + 0.7, width=width, sharey=True)
    for axes, state, each in zip(every, states, marks, strict=True):
        _state(axes, result, state, each, height)
    for axes in every[::columns]:
        axes.set_ylabel(elevations(result.experiment)[1])
    return drawn


def _shown_states(result: LoopResult) -> list[str | None]:
    """List the drawn states; only None if no effect belongs to a single state."""
    every = [item.placed.place.state for item in result.effects]
    every += [rival.placed.place.state for item in result.effects for rival in item.rivals[:NAMED]]
    concerned = [state for state in every if state is not None]
    if not concerned:
        return [None]
    # Effects are sorted by probability; their rivals follow.
    found, states = list(dict.fromkeys(concerned)), result.experiment.states
    free = [state for state in (result.experiment.frame.reference, *states) if state is not None and state not in found]
    shown = {*found[: style.MOST_PANELS - bool(free)], *free[:1]}
    return [state for state in states if state in shown]


@dataclass(frozen=True)
class _Mark:
    """An effect or its rival in the drawing, with its label."""

    placed: LocatedEffect
    text: str
    sure: bool
    joined: tuple[tuple[int, int], ...] = ()

    @property
    def lines(self) -> int:
        """Number of lines of text, including a blank line below."""
        return self.text.count("\n") + 2


def _marks(result: LoopResult, state: str | None, *, first: bool) -> list[_Mark]:
    """Collect the marks for the drawing of a state; effects of all states are marked in the first drawing."""
    sure = not result.provisional
    found = []
    for item in result.effects:
        place, rivals = item.placed.place, item.rivals[:NAMED]
        if place.state == state or (first and place.state is None):
            said = [item.size if sure else f"provisional: {item.size}", f"{chance(item.probability)} probable"]
            said += [f"or: {rival.placed.label} ({chance(rival.probability)})" for rival in rivals]
            found.append(_Mark(item.placed, _wrapped(said), sure, _joined(item, result.experiment)))
        else:
            found += [
                _Mark(each.placed, _wrapped([f"or here: {each.placed.label} ({chance(each.probability)})"]), sure=False)
                for each in rivals
                if each.placed.place.state == state
            ]
    return found


def _joined(item: AddedEffect, experiment: Experiment) -> tuple[tuple[int, int], ...]:
    """Find the pairs of levels that an effect joins by springs above `STANDS_OUT` standard deviations."""
    known = {named_pair(i, j): (i, j) for i, j in separate_levels(experiment.stories)}
    if not set(item.parameters) <= set(known) or set(item.placed.units(experiment)) != {"N/m"}:
        return ()
    sure = (name for name, value in item.parameters.items() if abs(value) > STANDS_OUT * (item.std[name] or np.inf))
    return tuple(known[name] for name in sure)


def _wrapped(texts: Sequence[str]) -> str:
    lines = [line for text in texts for line in textwrap.wrap(text, style.LONGEST_NAME)]
    return "\n".join(style.letters(line, style.LONGEST_NAME + 2) for line in lines)


def _state(axes: Axes, result: LoopResult, state: str | None, marks: Sequence[_Mark], height: float) -> None:
    z, _ = elevations(result.experiment)
    at = _, right = 0.10, 0.34
    _structure(axes, result.averaged, z, at)
    _sensors(axes, result.experiment, state, z, at)
    total = float(axes.get_ylim()[1])
    base = np.concatenate([[0.0], z])
    middles = np.array([np.mean(_extent(mark.placed, z)) for mark in marks])
    order = np.argsort(middles, kind="stable")
    room = max((mark.lines for mark in marks), default=1) * style.LINE * total / height
    levels = style.spread(middles[order], room, room / 2, total - room / 2)
    for mark, middle, level in zip([marks[each] for each in order], middles[order], levels, strict=True):
        for low, high in mark.joined:
            _tie(axes, float(base[low]), float(base[high]), at, sure=mark.sure)
        if not mark.joined:
            _mark(axes, mark.placed, z, at, sure=mark.sure)
        _leader(axes, (right + 0.05, middle), (right + LABEL_DISTANCE + 0.02, level))
        axes.text(right + LABEL_DISTANCE + 0.03, level, mark.text, ha="left", va="center", color="black", fontsize=8)
    if not marks:
        words = "nothing was found here"
        axes.text(right + LABEL_DISTANCE, total / 2, words, ha="left", va="center", color=style.GREY, style="italic")
    found = sum(mark.placed.place.state == state for mark in marks if mark.sure)
    heading = "every state" if state is None else style.letters(state, 18)
    if state is not None and not heading.casefold().startswith("state"):
        heading = f"state {heading}"
    axes.set_title(heading if state is None or not found else f"{heading}: {counted(found, 'finding')}", weight="bold")


def _sensors(axes: Axes, experiment: Experiment, state: str | None, z: Floats, at: Columns) -> None:
    """Mark the floors that have a sensor in some test of a state."""
    tests = [each for each in experiment.configurations if state in (None, each.state)]
    floors = sorted({int(floor) for each in tests for floor in each.measured_floors})
    axes.plot([at[0] - 0.06] * len(floors), z[np.array(floors, dtype=int) - 1], ls="none", marker=">", color=style.GREY)


def _extent(placed: LocatedEffect, z: Floats) -> tuple[float, float]:
    """Find the elevations between which an effect acts: a story, a floor, two levels, or the whole frame."""
    place, base = placed.place, np.concatenate([[0.0], z])
    if place.story is not None:
        return float(base[place.story - 1]), float(base[place.story])
    if place.floor is None:
        return 0.0, float(z[-1])
    return float(base[place.floor]), float(base[place.floor if place.to is None else place.to])


def _mark(axes: Axes, placed: LocatedEffect, z: Floats, at: Columns, *, sure: bool) -> None:
    """Colour the part that an effect acts on: a story, a floor, a tie between two floors, or the whole frame."""
    place, (low, high), (left, right) = placed.place, _extent(placed, z), at
    if place.to is not None:
        _tie(axes, low, high, at, sure=sure)
        return
    if place.story is None and place.floor is None:
        # A bracket beside the frame marks the whole frame without hiding it.
        axes.plot([right + 0.03, right + 0.05, right + 0.05, right + 0.03], [low, low, high, high],
                  color=style.BEFORE, lw=1.6, ls="-" if sure else "--")  # fmt: skip
        return
    # A story is marked without its floors, a floor with a margin.
    thick = 0.16 * float(np.diff(z, prepend=0.0).min()) * (1 if place.story is None else -1)
    low, high = low - thick, high + thick
    corner, wide = (left - 0.035, low), right - left + 0.07
    band = Rectangle(corner, wide, high - low, fc="none", ec=style.BEFORE, lw=1.0, ls="--", zorder=4)
    if sure:
        band.set(facecolor="#D55E0033", linewidth=1.6, linestyle="-")
    axes.add_patch(band)
    for side in at if sure and place.story is not None else ():
        axes.plot([side, side], [low, high], color=style.BEFORE, lw=4.0, solid_capstyle="butt", zorder=5)


def _tie(axes: Axes, low: float, high: float, at: Columns, *, sure: bool) -> None:
    """Draw a tie between two elevations."""
    dashes = "-" if sure else "--"
    axes.plot(at, [low, high], color=style.BEFORE, lw=2.6, ls=dashes, zorder=5)


# The identified frame with its numbers.


@style.figure("frame", LoopResult, Identification, title="The identified frame", section="frame", **style.OF_ONE_MOTION)
def frame(result: LoopResult | Identification) -> Figure:
    """Frame to scale with its identified masses and stiffnesses; the numbers are in the table above.

    The frame, heights to scale; a slab is the thicker the heavier its floor, a column the wider the stiffer its
    story.

    Parameters
    ----------
    result : LoopResult or Identification

    Returns
    -------
    Figure
        If each configuration was identified separately, each one has its panel.
    """
    if isinstance(result, LoopResult):
        frames = [("", result.averaged)]
    else:
        several = len(result.parts) > 1
        frames = [(style.letters(part.name) if several else "", part.frame) for part in result.parts]
    return _numbered_frames(result.experiment, frames)


@style.figure("planned", Plan, title="The floors to measure", section="choice")
def planned(result: Plan) -> Figure:
    """Frame as designed, to scale, with the floors to measure; the numbers are in the tables below.

    The frame as designed, heights to scale; a slab is the thicker the heavier its floor, a column the wider the
    stiffer its story. Triangles: floors with a sensor. Deviations are those that the tests will leave.

    Parameters
    ----------
    result : Plan

    Returns
    -------
    Figure
    """
    design, std = result.model.design, result.chosen
    frame = IdentifiedFrame(design.floor_mass, design.story_stiffness, std.floor_mass_std, std.story_stiffness_std)
    every = predicted(result)
    tests = tuple(each for each in every.configurations if each.name in result.names)
    return _numbered_frames(replace(every, configurations=tests), [("", frame)], sensors=True)


def _numbered_frames(
    experiment: Experiment, frames: Sequence[tuple[str, IdentifiedFrame]], *, sensors: bool = False
) -> Figure:
    """Draw frames with their numbers and titles."""
    height = float(np.clip(experiment.stories * 2 * style.LINE, 2.2, 8.0))
    drawn, every = style.panels(len(frames), 2, height + 0.75, width=style.PAGE_WIDTH * min(len(frames), 2))
    z, label = elevations(experiment)
    at = left, right = 0.46, 0.57
    for axes, (title, found) in zip(every, frames, strict=True):
        _structure(axes, found, z, at)
        if sensors:
            _sensors(axes, experiment, None, z, at)
        _numbers(axes, found, z, at, float(z[-1]) * style.LINE / height)
        axes.set_ylabel(label)
        for x, text, std, align in (
            (left - LABEL_DISTANCE, "story stiffness", found.story_stiffness_std, "right"),
            (right + LABEL_DISTANCE, "floor mass", found.floor_mass_std, "left"),
        ):
            # A value at a bound has no standard deviation.
            heading = text if not np.isfinite(std).any() else f"{text} ± std"
            axes.text(x, 1.02, heading, ha=align, va="bottom", weight="bold", transform=axes.transAxes)
        if title:
            axes.set_title(title, pad=20)
    return drawn


def _numbers(axes: Axes, found: IdentifiedFrame, z: Floats, at: Columns, gap: float) -> None:
    """Write stiffnesses left of the stories and masses right of the floors, without overlaps."""
    stiffnesses, unit = in_one_unit(found.story_stiffness, found.story_stiffness_std, AUTOMATIC.of_stiffness)
    masses, mass_unit = in_one_unit(found.floor_mass, found.floor_mass_std, AUTOMATIC.of_mass)
    (left, right), top, middle = at, float(z[-1]), z - np.diff(z, prepend=0.0) / 2
    for i, (level, shown) in enumerate(zip(middle, style.spread(middle, gap, 0.0, top), strict=True)):
        _leader(axes, (left, level), (left - LABEL_DISTANCE + 0.01, shown))
        axes.text(left - LABEL_DISTANCE, shown, f"story {i + 1}:  {stiffnesses[i]} {unit}", ha="right", va="center")
    for i, (level, shown) in enumerate(zip(z, style.spread(z, gap, 0.0, top), strict=True)):
        _leader(axes, (right + 0.02, level), (right + LABEL_DISTANCE - 0.01, shown))
        axes.text(right + LABEL_DISTANCE, shown, f"floor {i + 1}:  {masses[i]} {mass_unit}", ha="left", va="center")


# Floors that turn, seen from above.

#: Semi-axes of the ellipse with the probability `SURE`, in standard deviations of its coordinates.
ELLIPSE = float(np.sqrt(-2.0 * np.log(1.0 - SURE)))


@style.figure(
    "plans",
    Identification,
    LoopResult,
    title="The floors from above",
    section="frame",
    applies=lambda result: result.experiment.frame.turns,
    needs="floors that turn",
)
def plans(result: Identification | LoopResult) -> Figure:
    """Floors from above with their centers of mass and stiffness; the numbers are in the table above.

    Dots: mass centers; diamonds: centers of stiffness of the story below; ellipses of 95 %, from the deviations of x
    and y. Black: sensors and their directions. Thick lines: sides at which the story below changed, with the change. A
    center that the data leave open is not drawn.

    Parameters
    ----------
    result : Identification or LoopResult

    Returns
    -------
    Figure
    """
    found = result.effects if isinstance(result, LoopResult) else ()
    frame = result.averaged if isinstance(result, LoopResult) else result.parts[0].frame
    sensors = result.experiment.configurations[0].sensors
    assert isinstance(frame, TurningFrame)
    outline = _outline(result.experiment.frame.plan, sensors)
    drawn, panels = _plan_panels(result.experiment.stories, outline)
    reach = 0.12 * float(np.ptp(outline))
    for floor, axes in enumerate(panels):
        axes.plot(*np.vstack([outline, outline[:1]]).T, color=style.GREY, lw=0.9)
        centers = (
            ("mass", frame.mass_center, frame.mass_center_std, "o", style.AFTER),
            ("stiffness", frame.stiffness_center, frame.stiffness_center_std, "D", style.BEFORE),
        )
        for label, center, std, marker, colour in centers:
            axes.plot(*center[floor], ls="none", marker=marker, ms=4.0, color=colour, label=f"center of {label}")
            if np.all(np.isfinite(std[floor])):
                width, height = 2.0 * ELLIPSE * std[floor]
                place = float(center[floor, 0]), float(center[floor, 1])
                axes.add_patch(Ellipse(place, width, height, fc="none", ec=colour, lw=0.9))
        for sensor in (each for each in sensors if each.floor == floor + 1):
            ends = np.array([sensor.position, sensor.position + reach * sensor.row[:2]])
            axes.plot(*ends.T, color=style.MEASURED, lw=0.8, marker=".", markevery=[0], label="sensor")
        for item in found:
            if item.placed.place.story == floor + 1 and "change" in item.parameters:
                _changed_sides(axes, outline, item)
        axes.set_title(f"floor {floor + 1}", fontsize=7.5)
    style.legend(drawn)
    return drawn


def _changed_sides(axes: Axes, outline: Floats, item: AddedEffect) -> None:
    """Mark the sides of the plan at which a story changed, all of them for the whole story, with the change."""
    low, high = outline[0], outline[2]
    sides = [SIDES[item.placed.place.part]] if item.placed.place.part else [SIDES["in x"], SIDES["in y"]]
    for axis, signs in sides:
        for sign in signs:
            ends = np.array([low, high])
            ends[:, 1 - axis] = high[1 - axis] if sign > 0 else low[1 - axis]
            axes.plot(*ends.T, color=style.BEFORE, lw=3.0, label="changed side")
            axes.annotate(
                percent(item.parameters["change"], 1), ends.mean(axis=0), fontsize=7, color=style.BEFORE,
                ha="center", va="center", xytext=(0, -8 * sign) if axis == 0 else (-18 * sign, 0),
                textcoords="offset points",
            )  # fmt: skip


def moved_plans(sensors: Sequence[Sensor], shapes: Floats, frequencies: Floats, plan: Floats | None) -> Figure:
    """Draw one panel a mode, the floors displaced by as much as a quarter of the plan."""
    outline, moved = displaced_plans(sensors, shapes, plan)
    drawn, panels = _plan_panels(len(shapes), outline)
    for mode, axes in enumerate(panels):
        for floor, displaced in enumerate([np.zeros_like(outline), *moved[mode]]):
            corners = outline + displaced
            colour, dark = (style.AFTER, floor / len(moved[mode])) if floor else (style.GREY, 1.0)
            axes.plot(*np.vstack([corners, corners[:1]]).T, color=colour, alpha=dark, lw=1.0)
        shares = shares_in_words(sensors, shapes[mode : mode + 1])
        axes.set_title(f"mode {mode + 1}: {frequencies[mode]:#.4g} Hz\n{shares}", fontsize=7)
    return drawn


def shares_in_words(sensors: Sequence[Sensor], shape: Floats) -> str:
    """Write how much of a mode, shape (1, r), is displacement in x, in y, and rotation."""
    shares = motion_shares(sensors, shape)[0]
    return ", ".join(f"{name} {percent(share, 0)}" for name, share in zip(MOTIONS, shares, strict=True))


def displaced_plans(sensors: Sequence[Sensor], shapes: Floats, plan: Floats | None) -> tuple[Floats, Floats]:
    """Find the corners of the plan, and their displacements on each floor in each mode, a quarter of the plan at most.

    Returns
    -------
    outline : ndarray, shape (4, 2), m
    displaced : ndarray, shape (m, N, 4, 2), m
    """
    outline = _outline(plan, sensors)
    rows = Sensor.rows(sensors, max(sensor.floor for sensor in sensors))
    motions = (np.linalg.pinv(rows) @ shapes.T).T.reshape(len(shapes), -1, 1, 3)
    x, y = outline.T
    by = np.stack([motions[..., 0] - motions[..., 2] * y, motions[..., 1] + motions[..., 2] * x], axis=-1)
    return outline, 0.25 * float(np.ptp(outline)) * by / np.abs(by).max(axis=(1, 2, 3), keepdims=True)


def _outline(plan: Floats | None, sensors: Sequence[Sensor]) -> Floats:
    """Return the corners of the largest declared plan, or of the rectangle around the sensors, shape (4, 2), m."""
    places = np.array([sensor.position for sensor in sensors])
    if plan is None:
        low, high = places.min(axis=0), places.max(axis=0)
    else:
        high = np.max(np.atleast_2d(plan), axis=0) / 2.0
        low = -high
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _plan_panels(count: int, outline: Floats) -> tuple[Figure, list[Axes]]:
    """Make panels with equal scales in x and y, m."""
    columns = style.even_columns(count, 3)
    wide, high = np.ptp(outline, axis=0)
    panel = style.PAGE_WIDTH / columns * float(np.clip(high / wide, 0.4, 1.5)) + 0.5
    drawn, panels = style.panels(count, columns, panel, 0.5, sharex=True, sharey=True)
    for axes in panels:
        axes.set_aspect("equal")
        axes.tick_params(labelsize=7)
    drawn.supxlabel("x, m", fontsize=8.5)
    drawn.supylabel("y, m", fontsize=8.5)
    return drawn, panels
