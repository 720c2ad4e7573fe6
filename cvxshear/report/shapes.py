"""Measured mode shapes beside those of a model, at all floors, in one scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.effects import compose
from cvxshear.experiment import Experiment
from cvxshear.identification import Identification
from cvxshear.identification.efficient import Estimate
from cvxshear.loop import Closure
from cvxshear.typing import Floats, Ints


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
    """Every measured mode of every configuration beside what the fit makes of it."""
    result = []
    facing: dict[int, Floats] = {}
    scale = estimate.noise_scale if np.isfinite(estimate.noise_scale) and estimate.noise_scale > 0 else 1.0
    for target, match in zip(estimate.misfit.targets, estimate.fit.at.matches, strict=True):
        configuration = target.configuration
        gain = compose(estimate.experiment, configuration, estimate.effects, estimate.theta).gain
        std = scale * np.broadcast_to(configuration.entry_std, target.shapes.shape)
        for j, mode in enumerate(target.modes):
            known = target.weights[j] > 0
            full = match.modes.shapes[:, match.paired[j]] * gain
            seen = full[target.floors]
            # The modelled shape was scaled to the measured one; the same factor holds at the floors without a sensor.
            factor = float(match.seen[j] @ seen / (seen @ seen)) if seen.any() else 1.0
            if not known.any():
                factor = 1.0 / full[np.argmax(np.abs(full))]
            entries = target.shapes[j, known]
            unit = entries[np.argmax(np.abs(entries))] if known.any() else 1.0
            # Which entry is largest may change with the configuration; the mode keeps its sign.
            unit = -unit if facing.setdefault(int(mode), full * factor / unit) @ (full * factor / unit) < 0 else unit
            result.append(
                ModeShape(
                    configuration.name,
                    int(mode) + 1,
                    target.floors + 1,
                    np.where(known, target.shapes[j] / unit, np.nan),
                    std[j] / abs(unit),
                    full * factor / unit,
                    float(np.exp(target.log_frequencies[j])),
                    float(match.modes.frequencies[match.paired[j]]),
                )
            )
    return result


def mac_tables(result: Closure | Identification) -> list[tuple[str, Floats]]:
    """For each configuration its name and the MAC of every measured mode (rows) with every modelled one (columns).

    A row of nan belongs to a mode that has no shape at two floors or more.
    """
    experiment = result.experiment
    found = (
        result.estimate.predictions
        if isinstance(result, Closure)
        else tuple(item for part in result.parts for item in part.predictions)
    )
    gains = _gains(result)
    return [
        (
            item.configuration,
            _mac(experiment, item.configuration, item.mode_shapes * gains.get(item.configuration, 1.0)),
        )
        for item in found
    ]


def _gains(result: Closure | Identification) -> dict[str, Floats]:
    """What the sensors make of the shapes, by configuration."""
    if not isinstance(result, Closure):
        return {}
    estimate = result.estimate
    return {
        each.name: compose(estimate.experiment, each, estimate.effects, estimate.theta).gain
        for each in estimate.experiment.configurations
    }


def _mac(experiment: Experiment, name: str, modelled: Floats) -> Floats:
    configuration = next(each for each in experiment.configurations if each.name == name)
    model = modelled[:, configuration.measured_floors - 1]
    table = np.full((len(configuration.frequencies), len(model)), np.nan)
    for row, (shape, known) in enumerate(zip(configuration.mode_shapes, configuration.measured, strict=True)):
        if known.sum() < 2:
            continue
        a, b = shape[known] / np.max(np.abs(shape[known])), model[:, known]
        length = np.sum(b**2, axis=1)
        table[row] = np.where(length > 0, (b @ a) ** 2 / (np.where(length > 0, length, 1.0) * (a @ a)), 0.0)
    return table
