"""Several sensors on one floor: their mean is the floor's motion, their difference its rotation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import signal

from cvxshear.records.record import Channel, Finding, Record, Run, TimeRecord
from cvxshear.records.signals import AnyRecord, only, scaled, with_responses
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

ACROSS = 30.0
"""Degrees from the direction of test, or from its opposite, beyond which a sensor says little of it."""
ROTATES = 0.05
"""Share of a floor's mean square motion in its rotation that is worth a word."""
LINES_A_HERTZ, NEARBY = 20.0, 0.01
"""Lines of the spectra that a mode's rotation is told by, and how far about its frequency, relative."""
CONTRADICTING = 4.0
"""Mean square of the difference over that of the mean from which on two sensors on one floor contradict each other,
both counted as far as they move with the other floors, where there are any: a rotation that only they see is none."""


def one_a_floor(record: AnyRecord) -> tuple[AnyRecord, list[Finding]]:
    """The record with one channel a floor, each the mean of those that sit there, in the direction of test.

    A sensor at `direction` degrees from that of test shows the floor's motion times the cosine; one more than
    30 degrees off is left out. Of two sensors half the difference is the rotation's part.

    Raises
    ------
    InputError
        Where two sensors on one floor contradict each other.
    """
    record, findings = _along(record)
    floors = [channel.floor for channel in record.channels]
    if len(set(floors)) == len(floors):
        return record, findings
    channels: list[Channel] = []
    groups = [np.flatnonzero(record.floors == floor) for floor in sorted(set(floors))]
    for group in groups:
        first = record.channels[int(group[0])]
        name = first.name if len(group) == 1 else " + ".join(record.channels[int(c)].name for c in group)
        channels.append(dataclasses.replace(first, name=name, position=None, direction=None))
        if len(group) > 1:
            findings.append(_rotation(record, group))
    means = [np.column_stack([run.responses[:, group].mean(axis=1) for group in groups]) for run in record.runs]
    return with_responses(record, means, tuple(channels)), findings


def turning(record: TimeRecord) -> Callable[[float], float] | None:
    """How much of a frame's motion at a frequency, Hz, is rotation; None where no floor has two sensors.

    The power spectra of the sensors' differences on the floors that have several, over those and the means together.
    """
    groups = [np.flatnonzero(record.floors == floor) for floor in np.unique(record.floors)]
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return None
    rate = record.sampling_rate
    length = min(int(LINES_A_HERTZ * rate), *(run.samples for run in record.runs)) // 2 * 2
    lines = np.fft.rfftfreq(length, 1 / rate)
    mean, apart = np.zeros(len(lines)), np.zeros(len(lines))
    for run in record.runs:
        for group in groups:
            values = run.responses[:, group]
            middle = values.mean(axis=1, keepdims=True)
            mean += run.samples * signal.welch(middle, rate, nperseg=length, axis=0)[1].mean(axis=1)
            apart += run.samples * signal.welch(values - middle, rate, nperseg=length, axis=0)[1].mean(axis=1)

    def share(frequency: float) -> float:
        near = np.abs(lines - frequency) <= max(2 * lines[1], NEARBY * frequency)
        return float(apart[near].sum() / max(apart[near].sum() + mean[near].sum(), 1e-300))

    return share


def _along(record: AnyRecord) -> tuple[AnyRecord, list[Finding]]:
    """Sensors turned into the direction of test; those that stand across it left out."""
    angles = [channel.direction or 0.0 for channel in record.channels]
    if not any(angles):
        return record, []
    cosines = np.cos(np.radians(angles))
    kept = [column for column, cosine in enumerate(cosines) if abs(cosine) >= np.cos(np.radians(ACROSS))]
    if not kept:
        raise InputError("no channel points along the direction of test: check the directions (degrees)")
    findings = [
        Finding(
            "direction",
            f"{channel} points {angle:g} degrees from the direction of test; left out",
            {"channel": channel.name, "degrees": angle},
        )
        for column, (channel, angle) in enumerate(zip(record.channels, angles, strict=True))
        if column not in kept
    ]
    factors = {record.channels[column].name: float(1.0 / cosines[column]) for column in kept}
    return only(scaled(record, factors), kept), findings


def _rotation(record: Record, group: Ints) -> Finding:
    names = [record.channels[int(column)] for column in group]
    others = np.flatnonzero(record.floors != names[0].floor)
    mean, apart, together, against = 0.0, 0.0, 0.0, 0.0
    for run in record.runs:
        values, rest = run.responses[:, group], None
        if isinstance(run, Run):
            values = values - values.mean(axis=0)
            rest = run.responses[:, others] - run.responses[:, others].mean(axis=0) if len(others) else None
        middle = values.mean(axis=1, keepdims=True)
        mean += _mean_square(middle)
        apart += _mean_square(values - middle)
        together += _mean_square(_moving_with(rest, middle))
        against += _mean_square(_moving_with(rest, values - middle))
    if against > CONTRADICTING * together:
        raise InputError(
            f"{' and '.join(map(str, names))} are on one floor and contradict each other: what moves with the other "
            f"floors is {np.sqrt(against / max(together, 1e-300)):.1f} times as large in their difference as in their "
            "mean; is one of them reversed, or on another floor?"
            if len(others)
            else f"{' and '.join(map(str, names))} are on one floor and contradict each other: their difference is "
            f"{np.sqrt(apart / max(mean, 1e-300)):.1f} times their mean; is one of them reversed, or on another floor?"
        )
    share = apart / max(mean + apart, 1e-300)
    said = "the floor turns as well" if share > ROTATES else "the floor hardly turns"
    return Finding(
        "rotation",
        f"floor {names[0].floor} has {len(names)} sensors, {', '.join(item.name for item in names)}: their mean is its "
        f"motion, and {100 * share:.1f} % of the mean square is in their difference; {said}",
        {"floor": names[0].floor, "channels": [item.name for item in names], "share": share},
    )


def _mean_square(values: Any) -> float:
    """Sum over the samples of the mean square of the columns."""
    return float(np.mean(np.sum(np.abs(values) ** 2, axis=0)))


def _moving_with(others: Floats | None, values: Any) -> Any:
    """The part of each column that is a combination of the other floors' motions; all of it where there are none."""
    if others is None:
        return values
    return others @ np.linalg.lstsq(others, values, rcond=None)[0]
