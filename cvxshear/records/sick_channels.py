"""What single channels of a record get wrong, seen before any mode is looked for."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import signal

from cvxshear.records.record import Finding, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

DEAD = 1e-4
"""Of the median channel's standard deviation: a channel below it measures nothing."""
CLIPPED_RUN = 3
"""Consecutive samples at the extreme value that make a clip, not a peak."""
DRIFTED = 0.2
"""Change of the mean along the record, in standard deviations of the channel."""
NEAR_NYQUIST = 0.05
"""Share of a channel's power in the top tenth of its band that points to aliasing."""


def channel_findings(record: Record) -> list[Finding]:
    """Dead, clipped, held, drifting and aliased channels, each with its numbers."""
    if isinstance(record, FrfRecord):
        levels = np.sqrt(np.mean([np.mean(np.abs(run.responses) ** 2, axis=0) for run in record.runs], axis=0))
        return _dead(record, levels)
    levels = np.sqrt(np.mean([np.var(run.responses, axis=0) for run in record.runs], axis=0))
    found = _dead(record, levels)
    for run in record.runs:
        for column, channel in enumerate(record.channels):
            if levels[column] > DEAD * np.median(levels):
                found += _of_series(run.responses[:, column], f"{run.name}: {channel}", channel.name, record)
        if run.excitation is not None:
            found += _of_series(run.excitation, f"{run.name}: input channel", "input", record)
    return found


def without_dead(record: Record, findings: list[Finding]) -> Record:
    """The record without the channels found dead.

    Raises
    ------
    InputError
        Where none is left.
    """
    dead = {finding.numbers["channel"] for finding in findings if finding.kind == "dead channel"}
    if not dead:
        return record
    kept = [column for column, channel in enumerate(record.channels) if channel.name not in dead]
    if not kept:
        raise InputError(f"every channel is dead: {', '.join(sorted(dead))}")
    channels = tuple(record.channels[column] for column in kept)
    if isinstance(record, FrfRecord):
        frf_runs = tuple(FrfRun(run.responses[:, kept], run.floor, run.name) for run in record.runs)
        return dataclasses.replace(record, channels=channels, runs=frf_runs)
    runs = tuple(Run(run.responses[:, kept], run.excitation, run.floor, run.name) for run in record.runs)
    return dataclasses.replace(record, channels=channels, runs=runs)


def _dead(record: Record, levels: Floats) -> list[Finding]:
    typical = float(np.median(levels[levels > 0])) if np.any(levels > 0) else 0.0
    return [
        Finding(
            "dead channel",
            f"{channel} measures nothing: standard deviation {level:.3g} where the median channel has {typical:.3g}; "
            "left out",
            {"channel": channel.name, "floor": channel.floor, "std": float(level), "median_std": typical},
        )
        for channel, level in zip(record.channels, levels, strict=True)
        if level <= DEAD * typical
    ]


def _of_series(values: Floats, where: str, name: str, record: TimeRecord) -> list[Finding]:
    found = [_clipped(values, where, name), _held(values, where, name)]
    if record.input != "free_decay" and name != "input":
        found.append(_drift(values, where, name))
    found.append(_aliased(values, where, name, record.sampling_rate))
    return [finding for finding in found if finding is not None]


def _clipped(values: Floats, where: str, name: str) -> Finding | None:
    for extreme in (values.max(), values.min()):
        flat = values == extreme
        starts = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))
        lengths = starts[1::2] - starts[::2]
        count = int(lengths[lengths >= CLIPPED_RUN].sum())
        if count and values.std() > 0 and count < 0.5 * len(values) and abs(extreme - np.median(values)) > values.std():
            return Finding(
                "clipped channel",
                f"{where} is clipped at {extreme:.4g}: {count} of {len(values)} samples stand there in rows of "
                f"{CLIPPED_RUN} or more, the first at sample {int(np.argmax(flat)) + 1}",
                {"channel": name, "level": float(extreme), "samples": count, "share": count / len(values)},
            )
    return None


def _held(values: Floats, where: str, name: str) -> Finding | None:
    """Samples repeated at a fixed pace: a channel of a lower rate, filled up."""
    same = np.diff(values) == 0
    for pace in (2, 3, 4, 5):
        repeats = [np.mean(same[phase::pace]) for phase in range(pace)]
        if sum(share > 0.95 for share in repeats) == pace - 1 and min(repeats) < 0.5:
            return Finding(
                "held samples",
                f"{where} repeats every value {pace} times: it was sampled at a {pace}th of the rate and filled up",
                {"channel": name, "repeats": pace},
            )
    return None


def _drift(values: Floats, where: str, name: str) -> Finding | None:
    tenth = max(1, len(values) // 10)
    change = float(values[-tenth:].mean() - values[:tenth].mean())
    around = signal.detrend(values)
    level = float(around.std())
    # The mean of a tenth scatters by itself; only a change well beyond that is a drift.
    pieces = [float(part.mean()) for part in np.array_split(around, 20)]
    scatter = float(np.std(pieces))
    if level > 0 and abs(change) > DRIFTED * level and abs(change) > 4 * scatter:
        return Finding(
            "drift",
            f"{where} drifts by {change:.3g} from its first tenth to its last, {abs(change) / level:.2g} of its "
            "standard deviation; a straight line was taken off",
            {"channel": name, "change": change, "over_std": abs(change) / level},
        )
    return None


def _aliased(values: Floats, where: str, name: str, rate: float) -> Finding | None:
    _, power = signal.welch(values, fs=rate, nperseg=min(1024, len(values)))
    top = power[int(0.9 * len(power)) :]
    below = power[int(0.7 * len(power)) : int(0.9 * len(power))]
    share = float(top.sum() / power.sum()) if power.sum() > 0 else 0.0
    # White noise has a tenth of its power up there, and as much just below; a folded line stands out.
    if share > NEAR_NYQUIST and top.max() > 10 * np.median(below):
        return Finding(
            "aliasing",
            f"{where} has {100 * share:.0f} % of its power in the top tenth of the band up to {rate / 2:g} Hz; what "
            "lies beyond is folded back into it",
            {"channel": name, "share": share},
        )
    return None
