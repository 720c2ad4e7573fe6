"""Frequencies that depend on amplitude: strong parts of a record against weak ones, a whole decay against its end."""

from __future__ import annotations

import dataclasses

import numpy as np

from cvxshear.modal.estimate import Replication
from cvxshear.modal.frf import ImpulseSource
from cvxshear.modal.picking import Parts
from cvxshear.modal.result import ModalResult
from cvxshear.records.record import Finding
from cvxshear.util.typing import Bools, Floats

SIGNIFICANT = 3.0
"""Standard deviations of a change of frequency that is said: chance makes one in 370 modes."""
SMALLEST_CHANGE = 5e-4
"""Relative change of a frequency that is said: two degrees of temperature change a steel frame's by as much."""
FEWEST_BLOCKS = 8
"""Blocks of which half, four, still determine the modes and show how they scatter."""


def amplitude_findings(setting: Replication, result: ModalResult) -> list[Finding]:
    """Modes whose frequency differs between strong and weak motion by more than chance allows."""
    if setting.source.unit == "block" and len(setting.source.groups) >= FEWEST_BLOCKS:
        return _strong_against_weak(setting, result)
    if setting.source.impulse() is not None:
        return _early_against_late(setting, result)
    return []


def _strong_against_weak(setting: Replication, result: ModalResult) -> list[Finding]:
    energies = setting.source.energies
    strong = energies > np.median(energies)
    first, second = (_log_frequencies(setting, keep) for keep in (strong, ~strong))
    if first is None or second is None:
        return []
    ratio = float(np.sqrt(energies[strong].mean() / energies[~strong].mean()))
    # Half the data each: twice the variance each, so four times for the difference.
    limit = SIGNIFICANT * 2 * result.frequency_std
    return [
        Finding(
            "amplitude",
            f"mode {mode}: {frequency * np.exp(up):.4f} Hz in the stronger half of the record, "
            f"{frequency * np.exp(low):.4f} Hz in the weaker ({100 * (up - low):+.2f} %, chance allows "
            f"{100 * bound:.2f} %; {ratio:.1f} times the motion): the frequency depends on amplitude, and the one "
            "reported is a mean",
            {"mode": int(mode), "change": float(up - low), "chance": float(bound), "amplitude_ratio": ratio},
        )
        for mode, frequency, up, low, bound in zip(
            result.modes,
            result.frequencies,
            first - np.log(result.frequencies),
            second - np.log(result.frequencies),
            limit,
            strict=True,
        )
        if abs(up - low) > max(bound, SMALLEST_CHANGE)
    ]


def _log_frequencies(setting: Replication, keep: Bools) -> Floats | None:
    values = setting.values(keep)
    if values is None:
        return None
    return np.asarray(np.log(np.abs(values.eigenvalues + setting.shift) / (2 * np.pi)))


def _early_against_late(setting: Replication, result: ModalResult) -> list[Finding]:
    """Compare the impulse response from its start with the same once it has decayed to a third."""
    later = _later(setting, None)
    if later is None:
        return []
    change = np.log(result.frequencies) - later
    if np.all(np.abs(change) < SMALLEST_CHANGE):
        return []
    std = _std_of_change(setting)
    found = []
    for place, mode in enumerate(result.modes):
        bound = SIGNIFICANT * (result.frequency_std[place] if std is None else std[place])
        if abs(change[place]) > max(bound, SMALLEST_CHANGE):
            found.append(
                Finding(
                    "amplitude",
                    f"mode {mode}: {result.frequencies[place]:.4f} Hz over the whole decay, "
                    f"{np.exp(later[place]):.4f} Hz in its later part ({100 * change[place]:+.2f} %, chance allows "
                    f"{100 * bound:.2f} %): the frequency depends on amplitude",
                    {"mode": int(mode), "change": float(change[place]), "chance": float(bound)},
                )
            )
    return found


def _std_of_change(setting: Replication) -> Floats | None:
    groups = setting.source.groups
    if len(groups) < 4:
        return None
    changes = []
    for piece in range(len(groups)):
        keep = np.arange(len(groups)) != piece
        whole, later = _log_frequencies(setting, keep), _later(setting, keep)
        if whole is not None and later is not None:
            changes.append(whole - later)
    if len(changes) < 4:
        return None
    return np.asarray(np.sqrt((len(changes) - 1) * np.var(changes, axis=0)))


def _later(setting: Replication, keep: Bools | None) -> Floats | None:
    impulse = setting.source.impulse(keep)
    if impulse is None:
        return None
    power = np.sum(impulse.sequence**2, axis=(1, 2))
    left = np.cumsum(power[::-1])[::-1]
    weak = np.flatnonzero(left < left[impulse.start] / 9)
    if not weak.size or weak[0] > 0.6 * len(power):
        return None
    source = ImpulseSource(dataclasses.replace(impulse, start=int(weak[0])), setting.source.sampling_rate)
    values = Parts(source, setting.sweep.poles).values(setting.sweep.chosen, None)
    if values is None:
        return None
    return np.asarray(np.log(np.abs(values.eigenvalues + setting.shift) / (2 * np.pi)))
