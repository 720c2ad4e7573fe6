"""Measured mode shapes beside those of a model, at all floors, in one scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.data import Model, Shapes
from cvxshear.data.pairing import mac
from cvxshear.fit.efficient import Estimate
from cvxshear.loop import Closure
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.methods import Identification
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class ModeShape:
    """One measured mode beside the model's.

    Parameters
    ----------
    configuration : str
    mode : int
        1 the lowest.
    floors : ndarray of int, shape (n,)
        Where it was measured, 1 the lowest.
    measured : ndarray, shape (n,)
        Scaled to a largest entry of 1; nan where not measured.
    std : ndarray, shape (n,)
        Of the entries, in the same scale.
    modelled : ndarray, shape (N,)
        At all floors as sensors would show them, scaled to the measured ones as the fit does.
    measured_frequency, modelled_frequency : float
        Hz.
    """

    configuration: str
    mode: int
    floors: Ints
    measured: Floats
    std: Floats
    modelled: Floats
    measured_frequency: float
    modelled_frequency: float


def mode_shapes(estimate: Estimate) -> list[ModeShape]:
    """Every measured mode of every configuration beside what the fit makes of it, a mode with one sign in all."""
    models = {id(model.state.tested): model for model in estimate.fit.at.models}
    laid = {id(datum.tested): datum for datum in estimate.misfit.data if isinstance(datum, Shapes)}
    facing: dict[int, Floats] = {}
    result = []
    for configuration in estimate.experiment.configurations:
        model, datum = models[id(configuration)], laid.get(id(configuration))
        modelled = _modelled(configuration, model, datum)
        noise = estimate.misfit.noise.of(Shapes.noise) if datum is not None and not datum.declared else 1.0
        for j, mode in enumerate(configuration.modes.tolist()):
            unit = _unit(configuration, j)
            # Which entry is largest may change with the configuration; the mode keeps its sign.
            unit = -unit if facing.setdefault(mode, modelled[j] / unit) @ modelled[j] / unit < 0 else unit
            result.append(
                ModeShape(
                    configuration.name,
                    mode,
                    configuration.measured_floors,
                    np.where(configuration.measured[j], configuration.mode_shapes[j] / unit, np.nan),
                    noise * configuration.entry_std[j] / abs(unit),
                    modelled[j] / unit,
                    float(configuration.frequencies[j]),
                    float(model.modes.frequencies[model.paired[j]]),
                )
            )
    return result


def _modelled(configuration: Configuration, model: Model, datum: Shapes | None) -> Floats:
    """The shapes at all floors as sensors would show them, on the measured ones' scale, shape (m, N).

    The factor that lays a shape on the measured entries holds at the floors without a sensor too.
    """
    full = model.state.observation.shown(model.modes.shapes[model.paired])
    factor = 1.0 / full[np.arange(len(full)), np.argmax(np.abs(full), axis=1)]
    if datum is not None:
        at_sensors = full[datum.kept][:, configuration.measured_floors - 1]
        length = np.sum(at_sensors**2, axis=1)
        factor[datum.kept] = np.where(length > 0, np.sum(datum.seen(model) * at_sensors, axis=1) / length, 1.0)
    laid: Floats = factor[:, None] * full
    return laid


def _unit(configuration: Configuration, j: int) -> float:
    """The largest measured entry of a mode, with its sign; 1 where none was measured."""
    entries = configuration.mode_shapes[j, configuration.measured[j]]
    return float(entries[np.argmax(np.abs(entries))]) if entries.size else 1.0


def mac_tables(result: Closure | Identification) -> list[tuple[str, Floats]]:
    """For each configuration its name and the MAC of every measured mode (rows) with every modelled one (columns).

    A row of nan belongs to a mode that has no shape at two floors or more.
    """
    if isinstance(result, Closure):
        found = result.estimate.predictions
        gains = {model.state.tested.name: model.state.gain for model in result.estimate.fit.at.models}
    else:
        found, gains = tuple(item for part in result.parts for item in part.predictions), {}
    experiment = result.experiment
    return [
        (
            item.configuration,
            _mac(experiment, item.configuration, item.mode_shapes * gains.get(item.configuration, 1.0)),
        )
        for item in found
    ]


def _mac(experiment: Experiment, name: str, modelled: Floats) -> Floats:
    configuration = next(each for each in experiment.configurations if each.name == name)
    model = modelled[:, configuration.measured_floors - 1]
    table = np.full((len(configuration.frequencies), len(model)), np.nan)
    for row, (shape, known) in enumerate(zip(configuration.mode_shapes, configuration.measured, strict=True)):
        if known.sum() >= 2:
            measured = shape[known] / np.max(np.abs(shape[known]))
            table[row] = [mac(measured, each[known]) if each[known].any() else 0.0 for each in model]
    return table
