"""Scale measured and modelled mode shapes at all floors, and draw them as displaced frames."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cvxshear.data import Model, Shapes
from cvxshear.data.pairing import mac
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.results import Identification
from cvxshear.loop import LoopResult
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.report.figures import style
from cvxshear.report.figures.drawn_frame import elevations
from cvxshear.report.figures.figure_table import figure
from cvxshear.util import ranking
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
    experiment = result.experiment
    shown = {item.configuration: item.mode_shapes * gains.get(item.configuration, 1.0) for item in found}
    return [(name, _mac(experiment, name, modelled)) for name, modelled in shown.items()]


def _mac(experiment: Experiment, name: str, modelled: Floats) -> Floats:
    configuration = next(each for each in experiment.configurations if each.name == name)
    model = modelled[:, configuration.measured_floors - 1]
    table = np.full((len(configuration.frequencies), len(model)), np.nan)
    for row, (shape, known) in enumerate(zip(configuration.mode_shapes, configuration.measured, strict=True)):
        if known.sum() >= 2:
            measured = shape[known] / np.max(np.abs(shape[known]))
            table[row] = [mac(measured, each[known]) if each[known].any() else 0.0 for each in model]
    return table


ABOVE, BELOW, TITLE = 0.3, 0.55, 0.5
"""Heights for the legend, the common label, and the two title lines of a panel, inch."""

SHEAR: dict[str, Any] = {"color": style.BEFORE, "ls": "--", "marker": "D", "mfc": "white", "ms": 3.6, "lw": 1.0}
"""Line style of the shear model's shape."""

HALF_WIDTH = 0.16
"""Half the width of the drawn frame, in units of the largest entry of a shape."""


@figure(
    "shapes",
    LoopResult,
    title="Mode shapes",
    alternative="Measured mode shapes with error bars beside those of the shear model and of the final model.",
    section="shapes",
    narrow=True,
)
def shapes(result: LoopResult) -> Figure:
    """Every measured mode with its error bars, the final model's as a displaced frame, and the first model's as a line.

    Each measured mode: dots with error bars are measured, the dashed line is the shear model, the frame is the
    final model.

    Each configuration and measured mode has one panel.
    """
    before, after = mode_shapes(result.before.estimate), mode_shapes(result.estimate)
    counts = [len(each.frequencies) for each in result.experiment.configurations]
    columns, rows, tall, width = style.shape_grid(counts, result.experiment.stories, 5.6)
    above = 3 * ABOVE if style.narrow_page() else ABOVE
    height = rows * (tall + TITLE) + above + BELOW
    # Panels of equal size need no automatic layout, which is slow for many panels.
    figure = style.new_figure(width, height, fixed=True)
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.12 / width, bottom=BELOW / height, top=1 - (above + TITLE) / height,
        hspace=TITLE / tall, wspace=0.08,
    )  # fmt: skip
    z, label = elevations(result.experiment)
    groups = style.panels_by_group(figure, counts, columns, sharex=True, sharey=True)
    drawn = [(axes, place) for group in groups for place, axes in enumerate(group)]
    for (axes, place), first, last in zip(drawn, before, after, strict=True):
        _displaced_frame(axes, z, first, last)
        if place % columns == 0:
            axes.set_ylabel(label)
    figure.text(0.5, 0.08 / height, "sway (largest measured entry = 1)", ha="center", va="bottom")
    figure.legend(
        handles=_legend(changed=len(result.steps) > 1), loc="upper center", ncols=1 if style.narrow_page() else 3
    )
    return figure


def _displaced_frame(axes: Axes, z: Floats, before: ModeShape, after: ModeShape) -> None:
    base = np.concatenate([[0.0], z])
    sway = np.concatenate([[0.0], after.modelled])
    axes.axvline(0, color="#C8C8C8", lw=0.5)
    for side in (-HALF_WIDTH, HALF_WIDTH):
        axes.plot(sway + side, base, color=style.AFTER, lw=1.0)
    axes.hlines(z, after.modelled - HALF_WIDTH, after.modelled + HALF_WIDTH, color=style.AFTER, lw=1.6)
    axes.plot(np.concatenate([[0.0], before.modelled]), base, **SHEAR)
    style.error_bars(axes, after.measured, z[after.floors - 1], after.std, zorder=5)
    axes.axhline(0, color=style.GREY, lw=0.8)
    axes.set(xlim=(-1.45, 1.45), xticks=[-1, 0, 1], ylim=(0, 1.07 * float(z[-1])))
    axes.set_title(
        f"{style.letters(after.configuration, 16)}\nmode {after.mode}: {after.frequency:#.4g} Hz", fontsize=7.5
    )


def _legend(*, changed: bool) -> list[Line2D]:
    first = "shear model" if changed else "the same model"
    return [
        Line2D([], [], color=style.MEASURED, marker="o", ms=3.0, lw=0.9, label="measured ± one std"),
        Line2D([], [], label=first, **SHEAR),
        Line2D([], [], color=style.AFTER, lw=1.6, label="with effects" if changed else "shear model"),
    ]
