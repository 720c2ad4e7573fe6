"""Several sensors on one floor: their common motion is the floor's sway, their difference its rotation.

A rigid floor that moves by U in the direction of test and turns by t moves by u = U - t y at the distance y across that
direction from its center. Sensors with declared positions give U and t by least squares. Without positions, or with a
center far beyond the sensors, U is their mean.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy

from cvxshear.records.findings import finding
from cvxshear.records.record import Channel, Finding, Record, Run, TimeRecord
from cvxshear.records.signals import AnyRecord, only, scaled, with_responses
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import STANDARD_GRAVITY
from cvxshear.util.typing import Floats, Ints

ACROSS = 30.0
"""Largest angle, degrees, between a useful sensor and the direction of test or its opposite."""
ROTATES = 0.05
"""Share of a floor's mean square motion in its rotation that is worth a word."""
LINES_A_HERTZ, NEARBY = 20.0, 0.01
"""Number of spectral lines for a mode's rotation, and their relative distance from its frequency."""
LARGEST_WEIGHTS = 1.5
"""Largest root of the sum of squares of the sensors' weights in the motion of the center. If the center is so far
beyond the sensors that noise grows by half, their mean (0.7 for two) is taken."""
CONTRADICTING = 4.0
"""Two sensors on one floor contradict each other above this ratio of the mean squares of their difference and their
mean. Only motion in common with the other floors counts, if there are any."""


SAME_SCALE = 4.0
"""Two sensors on one floor have different units above this ratio of their common motion with the other floors.
Sensors 5 m from the center of floors that turn reached 1.9 in 56 simulated records; the least ratio of units is 9.8."""


def one_a_floor(record: AnyRecord) -> tuple[AnyRecord, list[Finding]]:
    """Bring the record to one channel a floor, the motion of the floor's center in the direction of test.

    A sensor at `direction` degrees from the direction of test shows the floor's motion times the cosine; one more than
    30 degrees off is left out. Of several sensors the center's motion follows from their positions across the
    direction of test, or is their mean.

    Raises
    ------
    InputError
        Where two sensors on one floor contradict each other.
    """
    record, findings = along(record)
    groups = [np.flatnonzero(record.floors == floor) for floor in np.unique(record.floors)]
    findings += _beside_the_center(record, groups)
    if len(groups) == len(record.channels):
        return record, findings
    channels: list[Channel] = []
    for group in groups:
        first = record.channels[int(group[0])]
        name = first.name if len(group) == 1 else " + ".join(record.channels[int(c)].name for c in group)
        channels.append(dataclasses.replace(first, name=name, position=None, direction=None))
        if len(group) > 1:
            findings.append(_rotation(record, group))
    weights = [center_weights(record.channels, group)[0] for group in groups]
    centers = [
        np.column_stack([run.responses[:, group] @ weight for group, weight in zip(groups, weights, strict=True)])
        for run in record.runs
    ]
    return with_responses(record, centers, tuple(channels)), findings


def _beside_the_center(record: Record, groups: Sequence[Ints]) -> Iterator[Finding]:
    """Report floors with a single sensor beside their center: its record contains the rotation."""
    across = np.array([np.nan if channel.position is None else channel.position[1] for channel in record.channels])
    # Half the distance of sensors whose difference shows the rotation.
    half = [0.5 * float(np.ptp(across[group])) for group in groups if len(group) > 1 and np.ptp(across[group]) > 0]
    for group in groups:
        channel, off = record.channels[int(group[0])], abs(float(across[group[0]]))
        if len(group) == 1 and off > 0:
            seen = (
                "its entries are as uncertain as the other floors turn" if half else "no floor shows how much it turns"
            )
            # The place of the sensor is known; the center between two sensors may be anywhere (see `records.identify`).
            arm = off * np.sqrt(3.0) / np.mean(half) if half else 0.0
            numbers = {"floor": channel.floor, "channels": [channel.name], "placed": False, "arm": float(arm)}
            yield finding("rotation/one sensor", numbers, off=off, seen=seen)


def center_weights(channels: Sequence[Channel], group: Ints) -> tuple[Floats, bool]:
    """Find the weights of a floor's sensors in its motion, shape (sensors,), and whether positions determine them."""
    places = [channels[int(column)].position for column in group]
    across = np.array([0.0 if place is None else place[1] for place in places])
    if None not in places and np.ptp(across) > 1e-3 * np.abs(across).max():
        weights = np.asarray(np.linalg.pinv(np.column_stack([np.ones(len(group)), -across]))[0])
        if np.linalg.norm(weights) <= LARGEST_WEIGHTS:
            return weights, True
    return np.full(len(group), 1.0 / len(group)), False


def turning(record: TimeRecord) -> Callable[[float], float] | None:
    """How much of a frame's motion at a frequency, Hz, is rotation; None where no floor has two sensors.

    The power spectra of the sensors' differences from the center on the floors that have several, over those and the
    center's together.
    """
    groups = [np.flatnonzero(record.floors == floor) for floor in np.unique(record.floors)]
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return None
    rate = record.sampling_rate
    length = min(int(LINES_A_HERTZ * rate), *(run.samples for run in record.runs)) // 2 * 2
    lines = np.fft.rfftfreq(length, 1 / rate)
    mean, differences = np.zeros(len(lines)), np.zeros(len(lines))
    for run in record.runs:
        for group in groups:
            values = run.responses[:, group]
            middle = (values @ center_weights(record.channels, group)[0])[:, None]
            mean += run.samples * scipy.signal.welch(middle, rate, nperseg=length, axis=0)[1].mean(axis=1)
            off = values - middle
            differences += run.samples * scipy.signal.welch(off, rate, nperseg=length, axis=0)[1].mean(axis=1)

    def share(frequency: float) -> float:
        near = np.abs(lines - frequency) <= max(2 * lines[1], NEARBY * frequency)
        return float(differences[near].sum() / max(differences[near].sum() + mean[near].sum(), 1e-300))

    return share


def along(record: AnyRecord) -> tuple[AnyRecord, list[Finding]]:
    """Turn sensors into the direction of test, and leave out those that stand across it."""
    angles = [channel.direction or 0.0 for channel in record.channels]
    if not any(angles):
        return record, []
    cosines = np.cos(np.radians(angles))
    kept = [column for column, cosine in enumerate(cosines) if abs(cosine) >= np.cos(np.radians(ACROSS))]
    if not kept:
        raise InputError("no channel points along the direction of test: check the directions (degrees)")
    findings = [
        finding("direction", {"channel": channel.name, "degrees": angle}, where=channel)
        for column, (channel, angle) in enumerate(zip(record.channels, angles, strict=True))
        if column not in kept
    ]
    factors = {record.channels[column].name: float(1.0 / cosines[column]) for column in kept}
    record = only(scaled(record, factors), kept)
    channels = tuple(dataclasses.replace(channel, direction=None) for channel in record.channels)
    return dataclasses.replace(record, channels=channels), findings


def _rotation(record: Record, group: Ints) -> Finding:
    names = [record.channels[int(column)] for column in group]
    others = np.flatnonzero(record.floors != names[0].floor)
    weights, placed = center_weights(record.channels, group)
    center, turned, together, against = np.zeros(4)
    shown = np.zeros(len(group))
    for run in record.runs:
        values, rest = run.responses[:, group], None
        if isinstance(run, Run):
            values = values - values.mean(axis=0)
            rest = run.responses[:, others] - run.responses[:, others].mean(axis=0) if len(others) else None
        center += _mean_square((values @ weights)[:, None])
        turned += _mean_square(values - (values @ weights)[:, None])
        middle = values.mean(axis=1, keepdims=True)
        shown += np.mean(np.abs(_moving_with(rest, values)) ** 2, axis=0)
        together += _mean_square(_moving_with(rest, middle))
        against += _mean_square(_moving_with(rest, values - middle))
    what = "what moves with the other floors is" if len(others) else "the motion is"
    least, most = names[int(np.argmin(shown))], names[int(np.argmax(shown))]
    ratio = float(np.sqrt(shown.max() / max(shown.min(), 1e-300)))
    if ratio > SAME_SCALE:
        raise InputError(
            f"{most} and {least} are on one floor and contradict each other: {what} {ratio:.1f} times as large in the "
            f"first; is one of them in another unit (g is {STANDARD_GRAVITY:.3g} m/s2), or is its cable cut?"
        )
    if against > CONTRADICTING * together:
        raise InputError(
            f"{' and '.join(map(str, names))} are on one floor and contradict each other: {what} "
            f"{np.sqrt(against / max(together, 1e-300)):.1f} times as large in their difference as in their mean; is "
            "one of them reversed, or on another floor?"
        )
    share = float(turned / max(center + turned, 1e-300))
    said = "the floor turns as well" if share > ROTATES else "the floor hardly turns"
    how = (
        "by their positions they give its center's motion"
        if placed
        else "their mean is its motion, and its entries as uncertain as its center is between them"
    )
    called = [item.name for item in names]
    numbers = {"floor": names[0].floor, "channels": called, "share": share, "placed": placed}
    return finding("rotation/sensors", numbers, count=len(names), names=", ".join(called), how=how, said=said)


def _mean_square(values: Any) -> float:
    """Sum over the samples of the mean square of the columns."""
    return float(np.mean(np.sum(np.abs(values) ** 2, axis=0)))


def _moving_with(others: Floats | None, values: Any) -> Any:
    """Project each column on the other floors' motions; without other floors, return it unchanged."""
    if others is None:
        return values
    return others @ np.linalg.lstsq(others, values, rcond=None)[0]
