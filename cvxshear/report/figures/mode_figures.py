"""Draw modes: measured and modelled shapes and their assurance criterion; shapes, poles and functions of records."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cvxshear.data import Model, Shapes, kinds
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.results import Identification
from cvxshear.loop import LoopResult
from cvxshear.measurement.experiment import Configuration
from cvxshear.records import ModalResult
from cvxshear.records.picking import Sweep, scaled_to_one
from cvxshear.records.result import band_of, over_amplitude, synthesized
from cvxshear.report.figures import drawn_frame, style
from cvxshear.report.from_records import method_in_words
from cvxshear.util import ranking
from cvxshear.util.quantities import percents
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class ModeShape:
    """One measured mode and the model's.

    Parameters
    ----------
    configuration : str
    mode : int
        1 the lowest.
    floors : ndarray of int, shape (n,)
        Measured floors, 1 the lowest.
    measured : ndarray, shape (n,)
        Measured shape, scaled to a largest entry of 1; nan if an entry was not measured.
    std : ndarray, shape (n,)
        Standard deviations of the entries, in the same scale.
    modelled : ndarray, shape (N,)
        Modelled shape at all floors as sensors would show the shape, with the scale factor of the fit.
    frequency : float
        Measured frequency, Hz.
    """

    configuration: str
    mode: int
    floors: Ints
    measured: Floats
    std: Floats
    modelled: Floats
    frequency: float


def mode_shapes(estimate: Estimate) -> list[ModeShape]:
    """Collect every measured mode and the modelled one; a mode has the same sign in all configurations."""
    models = {id(model.state.tested): model for model in estimate.fit.at.models}
    laid = {id(datum.tested): datum for datum in estimate.misfit.data if isinstance(datum, Shapes)}
    facing: dict[int, Floats] = {}
    result = []
    for configuration in estimate.experiment.configurations:
        model, datum = models[id(configuration)], laid.get(id(configuration))
        modelled = _modelled(configuration, model, datum)
        noise = estimate.misfit.noise.of(Shapes.noise.name) if datum is not None and not datum.declared else 1.0
        for j, mode in enumerate(configuration.modes.tolist()):
            # The largest measured entry, with its sign; 1 without measured entries.
            entries = configuration.mode_shapes[j, configuration.measured[j]]
            unit = float(entries[ranking.first_largest(np.abs(entries))]) if entries.size else 1.0
            # The largest entry may change with the configuration; the sign of the mode does not.
            unit = -unit if facing.setdefault(mode, modelled[j] / unit) @ modelled[j] / unit < 0 else unit
            measured = np.where(configuration.measured[j], configuration.mode_shapes[j] / unit, np.nan)
            std = noise * configuration.entry_std[j] / abs(unit)
            floors, frequency = configuration.measured_floors, float(configuration.frequencies[j])
            result.append(ModeShape(configuration.name, mode, floors, measured, std, modelled[j] / unit, frequency))
    return result


def _modelled(configuration: Configuration, model: Model, datum: Shapes | None) -> Floats:
    """Compute the shapes at all floors as sensors would show them, scaled to the measured ones, shape (m, N).

    The factor that fits a shape to the measured entries also scales the floors without a sensor.
    """
    full = model.state.observation.shown(model.modes.shapes[model.paired])
    factor = 1.0 / full[np.arange(len(full)), ranking.largest(np.abs(full))]
    if datum is not None:
        at_sensors = full[datum.used][:, configuration.measured_floors - 1]
        length = np.sum(at_sensors**2, axis=1)
        factor[datum.used] = np.where(length > 0, np.sum(datum.seen(model) * at_sensors, axis=1) / length, 1.0)
    return np.asarray(factor[:, None] * full)


def mac_tables(result: LoopResult | Identification) -> list[tuple[str, Floats]]:
    """Compute the MAC of measured modes (rows) with modelled ones (columns), by the name of each configuration.

    A row is nan if the mode has a shape at fewer than two floors.
    """
    if isinstance(result, LoopResult):
        found = result.estimate.predictions
        gains = {model.state.tested.name: model.state.gain for model in result.estimate.fit.at.models}
    else:
        found, gains = tuple(item for part in result.parts for item in part.predictions), {}
    shown = {item.configuration: item.mode_shapes * gains.get(item.configuration, 1.0) for item in found}
    return [(each.name, _mac(each, shown[each.name])) for each in result.experiment.configurations]


def _mac(configuration: Configuration, modelled: Floats) -> Floats:
    model = modelled[:, configuration.measured_floors - 1]
    table = np.full((len(configuration.frequencies), len(model)), np.nan)
    for row, (shape, known) in enumerate(zip(configuration.mode_shapes, configuration.measured, strict=True)):
        if known.sum() >= 2:
            measured = shape[known] / np.max(np.abs(shape[known]))
            table[row] = [kinds.mac(measured, each[known]) if each[known].any() else 0.0 for each in model]
    return table


#: Line styles of the shapes of the shear model beside a final model, and of the only or final model.
SHEAR: dict[str, Any] = {"color": style.BEFORE, "ls": "--", "marker": "D", "mfc": "white", "ms": 3.6, "lw": 1.0}
FINAL: dict[str, Any] = {"color": style.AFTER, "lw": 1.6}


@style.figure("shapes", LoopResult, title="Mode shapes", section="shapes", **style.OF_ONE_MOTION)
def shapes(result: LoopResult) -> Figure:
    """Measured mode shapes with error bars beside those of the shear model and of the final model.

    Dots with error bars are measured, the solid line is the final model. Where effects were added, the dashed line is
    the shear model.

    Parameters
    ----------
    result : LoopResult

    Returns
    -------
    Figure
        Each configuration and measured mode has one panel.
    """
    before, after = mode_shapes(result.before.estimate), mode_shapes(result.estimate)
    counts = [len(each.frequencies) for each in result.experiment.configurations]
    (z, label), changed = drawn_frame.elevations(result.experiment), len(result.steps) > 1
    figure, groups = _shape_panels(counts, label, "sway (largest measured entry = 1)", z)
    for axes, first, last in zip(itertools.chain(*groups), before, after, strict=True):
        _modelled_line(axes, last.modelled, z, label="with effects" if changed else "shear model", **FINAL)
        if changed:
            _modelled_line(axes, first.modelled, z, label="shear model", **SHEAR)
        _measured_dots(axes, last.measured, z[last.floors - 1], last.std)
        name = style.letters(last.configuration, 16)
        axes.set_title(f"{name}\nmode {last.mode}: {last.frequency:#.4g} Hz", fontsize=7.5)
    style.legend(figure)
    return figure


def _shape_panels(
    counts: Sequence[int], label: str, sway: str, levels: Floats | Ints
) -> tuple[Figure, list[list[Axes]]]:
    """Make a panel for each mode of each group up to the highest level, with the labels of the axes."""
    # A panel of a shape is narrow: one more fits into a row.
    columns = style.even_columns(max(counts), style.MOST_PANELS + 1)
    # A panel has its title of three lines, and a line for each story.
    row = style.LINE * (float(np.clip(len(levels), 9, 17)) + 3.5)
    figure, groups = style.panels_by_group(counts, columns, row, 5 * style.LINE, sharex=True, sharey=True)
    for group in groups:
        for axes in group[::columns]:
            axes.set_ylabel(label)
        for axes in group:
            axes.axvline(0, color="#C8C8C8", lw=0.5)
            axes.axhline(0, color=style.GREY, lw=0.8)
            axes.set(xlim=(-1.45, 1.45), xticks=[-1, 0, 1], ylim=(0, 1.07 * float(levels[-1])))
            axes.locator_params("y", integer=bool(np.all(levels == np.round(levels))))
    figure.supxlabel(sway, fontsize=8.5)
    return figure, groups


def _modelled_line(axes: Axes, shape: Floats, levels: Floats | Ints, **look: Any) -> None:
    """Draw a shape from the ground up."""
    axes.plot(np.concatenate([[0.0], shape]), np.concatenate([[0.0], levels]), **look)


def _measured_dots(axes: Axes, values: Floats, levels: Floats | Ints, std: Floats | None) -> None:
    look: dict[str, Any] = {"fmt": "o", "color": style.MEASURED, "ms": 3.0, "capsize": 2.0, "lw": 0.9, "zorder": 5}
    axes.errorbar(values, levels, xerr=std, label="measured ± one std", **look)


#: Largest number of modes for a matrix with numbers in its cells.
MOST_NUMBERED = 8


def _mac_caption(result: LoopResult | Identification) -> str:
    stories = result.experiment.stories
    seen = min(len(each.measured_floors) for each in result.experiment.configurations if len(each.measured_floors))
    alike = f" At {seen} of {stories} floors different modes look alike, so that other entries are large too."
    return (
        "The modal assurance criterion (1 for the same shape, 0 for unrelated ones) of every measured mode with every "
        f"mode of the model. A light diagonal means that every mode was recognised.{alike if seen < stories else ''}"
    )


@style.figure(
    "mac",
    LoopResult,
    Identification,
    title="Measured and modelled modes",
    caption=_mac_caption,
    section="shapes",
    applies=lambda result: any(each.measured.any() and not each.sensors for each in result.experiment.configurations),
    needs="measured mode shapes",
)
def mac(result: LoopResult | Identification) -> Figure:
    """Modal assurance criterion of every measured mode with every mode of the final model.

    Parameters
    ----------
    result : LoopResult or Identification

    Returns
    -------
    Figure
        Each configuration has one panel; dark is 0, light is 1, also in black and white.
    """
    tested, every = result.experiment.configurations, range(1, result.experiment.stories + 1)
    most = 3 if len(every) <= 4 else 2
    side = style.PAGE_WIDTH / most
    figure, drawn = style.panels(len(tested), most, side + 0.3, width=side * min(len(tested), most) + 0.9)
    for axes, test, (name, table) in zip(drawn, tested, mac_tables(result), strict=True):
        image = axes.imshow(table, vmin=0, vmax=1, cmap="cividis", aspect="auto")
        step = 1 if len(every) <= 10 else 2
        axes.set_xticks(range(0, len(every), step), list(map(str, every[::step])))
        axes.set_yticks(range(0, len(table), step), list(map(str, test.modes[::step])))
        axes.set(title=style.letters(name), xlabel="mode of the model", ylabel="measured mode")
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
        if len(every) <= MOST_NUMBERED:
            _numbers(axes, table)
    figure.colorbar(image, ax=drawn, label="MAC (1: the same shape)", shrink=0.8)
    return figure


def _numbers(axes: Axes, table: Floats) -> None:
    digits = 4 if table.shape[1] <= 4 else 2
    for (row, column), value in np.ndenumerate(table):
        if not np.isnan(value):
            # A dark page exchanges pure black and white, but not the colours of the cells. These colours stay as they
            # are.
            colour = "#010101" if value > 0.5 else "#FEFEFE"
            axes.text(column, row, f"{value:.{digits}f}", ha="center", va="center", color=colour, fontsize=6.5)


#: Height of the labels above the orders, as a fraction of the orders' height.
BAND = 0.42
#: End of the axis of frequencies, as a multiple of the highest natural frequency.
HIGHEST = 1.3
POLES: dict[str, dict[str, Any]] = {
    "pole": {"marker": ".", "color": "#B5B5B5", "ms": 3.0},
    "stable": {"marker": "+", "color": style.BEFORE, "ms": 4.5, "mew": 0.8},
    "of a mode": {"marker": "o", "color": style.AFTER, "ms": 3.4},
}


@style.figure(
    "stabilization",
    ModalResult,
    title="Stabilization diagram",
    applies=lambda *results: all(result.sweep is not None for result in results),
    needs="an order sweep: modes that were identified from a record here",
)
def stabilization(*results: ModalResult) -> Figure:
    """Poles over model order: all of them, the stable ones, and those the modes rest on.

    Poles of models of growing order. A pole that comes back from order to order is stable; the values of a mode are
    medians over its poles.

    Parameters
    ----------
    *results : ModalResult
        Results of `identify_modes`, one panel each.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If a result has no order sweep.
    """
    most = max(len(result.frequencies) for result in results)
    figure, drawn = style.panels(len(results), 1, 3.4, 0.5, width=max(style.PAGE_WIDTH, style.LINE * most + 1.4))
    for axes, result in zip(drawn, results, strict=True):
        assert result.sweep is not None
        _poles(axes, result.sweep)
        top = max(poles.order for poles in result.sweep.poles)
        axes.set_xlim(0.0, HIGHEST * float(result.frequencies[-1]))
        axes.set_ylim(0, (1 + BAND) * top)
        axes.set_yticks(range(0, top + 1, max(2, top // 6 // 2 * 2)))
        _labels(axes, result, top, figure.get_figwidth() - 1.0)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel("model order (states)", y=0.5 / (1 + BAND))
        axes.set_title(f"{style.letters(result.name)}: {method_in_words(result)}")
    style.legend(figure)
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


def _labels(axes: Axes, result: ModalResult, top: int, inches: float) -> None:
    """Write vertical labels of modes above the poles, without overlaps, each with a line to its pole."""
    end = axes.get_xlim()[1]
    gap = end * style.LINE / inches
    places = style.spread(result.frequencies, gap, gap / 2, end - gap / 2)
    for mode, frequency, x in zip(result.modes, result.frequencies, places, strict=True):
        axes.plot([frequency, frequency, x], [0, 1.03 * top, 1.1 * top], color=style.AFTER, lw=0.6, alpha=0.6)
        axes.text(x, 1.12 * top, f"{mode}: {frequency:#.4g} Hz", rotation=90, ha="center", va="bottom", fontsize=7)


@style.figure(
    "amplitude",
    ModalResult,
    title="Modes over the amplitude of the motion",
    applies=lambda *results: len(results) > 2 and all(result.amplitude for result in results),
    needs="three continuous records or more",
)
def modes_over_amplitude(*results: ModalResult) -> Figure:
    """Frequency and damping of each mode over the largest motion in each record.

    Frequencies relative to their median over the records, and damping ratios. Each dot is a record.

    Parameters
    ----------
    *results : ModalResult

    Returns
    -------
    Figure
    """
    figure, (above, below) = style.panels(2, 1, 2.0, sharex=True)
    at = [result.amplitude or 0.0 for result in results]
    modes = list(over_amplitude(results).items())[: len(style.MARKERS) - 1]
    for (mode, (frequencies, damping, _)), look in zip(modes, style.looks(len(modes)), strict=True):
        dots = {"color": look["color"], "marker": look["marker"], "ls": "none", "ms": 3.5}
        middle = float(np.nanmedian(frequencies))
        above.plot(at, 100 * (frequencies / middle - 1.0), label=f"mode {mode}: {middle:#.4g} Hz", **dots)
        below.plot(at, 100 * damping, **dots)
    above.set_ylabel("frequency,\nchange in %")
    below.set(ylabel="damping, %", xlabel="largest motion (SI)", xscale="log")
    style.legend(figure, 3)
    return figure


#: Axis labels of the ratio of each response to a force.
FUNCTIONS = {
    "acceleration": "accelerance, (m/s²)/N",
    "velocity": "mobility, (m/s)/N",
    "displacement": "receptance, m/N",
}


@style.figure(
    "functions",
    ModalResult,
    title="Measured and synthesized functions",
    applies=lambda *results: all(result.functions is not None for result in results),
    needs="the functions of a record with a measured input (identify_modes: functions=True)",
)
def functions(*results: ModalResult) -> Figure:
    """Measured functions beside those that the identified modes make, floor by floor.

    What was measured, and what the identified poles and shapes make of it, residual terms included. Where the
    curves differ, a mode is missing or its shape is wrong. Grey lines: the natural frequencies.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    Figure
        One panel for each record and floor. With several driving points, the panel shows the strongest response.

    Raises
    ------
    InputError
        If a result has no functions.
    """
    every = [result.functions for result in results if result.functions is not None]
    counts = [len(seen.floors) for seen in every]
    columns = style.even_columns(max(counts), 4 if max(counts) > 9 else 3)
    figure, groups = style.panels_by_group(counts, columns, 1.75, 0.7)
    figure.supxlabel("frequency, Hz", fontsize=8.5)
    for result, seen, drawn in zip(results, every, groups, strict=True):
        made = synthesized(result)
        name = FUNCTIONS[seen.quantity] if seen.inputs[0] else f"{seen.quantity} / base acceleration"
        drawn[0].set_ylabel(name, fontsize=7)
        shown = band_of(seen.frequencies, result.frequencies)
        strongest = np.argmax(np.sum(np.abs(seen.values[shown]) ** 2, axis=0), axis=1)
        lines = seen.frequencies[shown]
        for output, (axes, column) in enumerate(zip(drawn, strongest, strict=True)):
            measured, modelled = (np.abs(each[shown, output, column]) for each in (seen.values, made))
            axes.plot(lines, measured, color="black", lw=0.8, label="measured")
            axes.plot(lines, modelled, color=style.BEFORE, ls="--", lw=1.1, label="of the modes")
            axes.set_yscale("log")
            for frequency in result.frequencies:
                axes.axvline(float(frequency), color=style.GREY, lw=0.5, alpha=0.6, zorder=0)
            at, name = seen.inputs[column], f"{style.letters(result.name, 20)}\n" if len(results) > 1 else ""
            force = f"\nforce at floor {at}" if at else ""
            axes.set_title(f"{name}floor {seen.floors[output]}{force}", fontsize=7.5)
            axes.grid(axis="y")
            axes.tick_params(labelsize=7)
    style.legend(figure, 2)
    return figure


@style.figure(
    "shapes",
    ModalResult,
    title="Mode shapes",
    applies=lambda *results: not any(result.sensors for result in results),
    needs="one motion a floor",
)
def modal_shapes(*results: ModalResult) -> Figure:
    """Mode shapes with their standard deviations; the numbers are in the table above.

    Real normal modes, the largest entry 1; bars are one standard deviation.

    Parameters
    ----------
    *results : ModalResult

    Returns
    -------
    Figure
        One panel a record and mode; a mode has the same sign in all records.
    """
    levels = np.arange(1, max(result.stories for result in results) + 1)
    counts = [len(result.frequencies) for result in results]
    figure, groups = _shape_panels(counts, "floor", "sway (largest entry = 1)", levels)
    facing: dict[int, tuple[ModalResult, Floats]] = {}
    for result, drawn in zip(results, groups, strict=True):
        for row, (axes, mode) in enumerate(zip(drawn, result.modes, strict=True)):
            shape = _facing(result, scaled_to_one(result.mode_shapes[row]), facing, int(mode))
            stds, frequency_std = result.written_entry_std[row], float(result.written_frequency_std[row])
            known = stds if np.all(np.isfinite(stds)) else None
            _modelled_line(axes, shape, result.floors, color=style.AFTER)
            _measured_dots(axes, shape, result.floors, known)
            std = f" ± {percents([frequency_std])[0]}" if np.isfinite(frequency_std) else ""
            frequency = f"{result.frequencies[row]:#.4g} Hz{std}"
            axes.set_title(f"{style.letters(result.name, 18)}\nmode {mode}\n{frequency}", fontsize=7)
    return figure


def _facing(result: ModalResult, shape: Floats, facing: dict[int, tuple[ModalResult, Floats]], mode: int) -> Floats:
    """Give the shape the sign of this mode in the first record, by the floors that both records measured."""
    first, before = facing.setdefault(mode, (result, shape))
    _, mine, theirs = np.intersect1d(result.floors, first.floors, return_indices=True)
    return -shape if shape[mine] @ before[theirs] < 0 else shape


def _seen_from_above(*results: Any) -> bool:
    first = results[0]
    sensors = first.sensors if isinstance(first, ModalResult) else first.experiment.frame.turns
    return len(results) == 1 and bool(sensors)


@style.figure(
    "plan_shapes",
    ModalResult,
    Identification,
    LoopResult,
    title="Mode shapes from above",
    section="shapes",
    applies=_seen_from_above,
    needs="one test of floors that turn",
)
def plan_shapes(result: ModalResult | Identification | LoopResult) -> Figure:
    """Mode shapes of the floors from above, with the shares of x, y and rotation; the numbers are in the tables.

    Grey: the floors at rest; lines: their motion in the mode, the highest floor darkest.

    Parameters
    ----------
    result : ModalResult, Identification or LoopResult

    Returns
    -------
    Figure
    """
    if isinstance(result, ModalResult):
        return drawn_frame.moved_plans(result.sensors, result.mode_shapes, result.frequencies, None)
    predictions = result.estimate.predictions if isinstance(result, LoopResult) else result.parts[0].predictions
    found, tested = predictions[0], result.experiment.configurations[0]
    modes = found.modes - 1
    return drawn_frame.moved_plans(
        tested.sensors, found.mode_shapes[modes], found.frequencies[modes], result.experiment.frame.plan
    )
