"""Several sensors on one floor: their common motion is the floor's sway, their difference its rotation.

A rigid floor that moves by U in the direction of test and turns by t moves by u = U - t y at the distance y across that
direction from its center. Sensors with declared positions give U and t by least squares. Without positions, or with a
center far beyond the sensors, U is their mean.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import scipy

from cvxshear.records import prepare
from cvxshear.records.clocks import FAULTY, SEGMENT, with_right_channels
from cvxshear.records.prepare import AnyRecord, only, scaled
from cvxshear.records.record import Channel, Finding, FrfRecord, Record, Run, TimeRecord, finding
from cvxshear.records.sick_channels import channel_findings, without_sick, without_spikes
from cvxshear.util import odds, quantities, ranking
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

ACROSS = 30.0
"""Largest angle, degrees, between a useful sensor and the direction of test or its opposite."""
ROTATES = 0.05
"""Share of a floor's mean square motion in its rotation that is worth a word."""
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
    return prepare.with_responses(record, centers, tuple(channels)), findings


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
    length = min(int(SEGMENT * rate), *(run.samples for run in record.runs)) // 2 * 2
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
        near = np.abs(lines - frequency) <= 2 * lines[1]
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
    count = len(group)
    whole, common = np.zeros((2, count, count))
    for run in record.runs:
        values = moving = run.responses[:, group]
        if isinstance(run, Run):
            values = moving = values - values.mean(axis=0)
            if len(others):
                rest = run.responses[:, others] - run.responses[:, others].mean(axis=0)
                moving = rest @ np.linalg.lstsq(rest, values, rcond=None)[0]
        whole += (values.conj().T @ values).real / len(values)
        common += (moving.conj().T @ moving).real / len(values)
    shown, together = np.diag(common), float(common.mean())
    # Mean squares of the sensors' differences from their mean, and from the center's motion.
    against = float(np.trace(common)) - count * together
    center = float(weights @ whole @ weights)
    turned = float(np.trace(whole) - 2 * np.sum(whole @ weights)) + count * center
    what = "what moves with the other floors is" if len(others) else "the motion is"
    least, most = names[int(np.argmin(shown))], names[int(np.argmax(shown))]
    ratio = float(np.sqrt(shown.max() / max(shown.min(), 1e-300)))
    if ratio > SAME_SCALE:
        raise InputError(
            f"{most} and {least} are on one floor and contradict each other: {what} {ratio:.1f} times as large in the "
            f"first; is one of them in another unit (g is {quantities.STANDARD_GRAVITY:.3g} m/s2), or is its cable cut?"
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
    return finding("rotation/sensors", numbers, count=count, names=", ".join(called), how=how, said=said)


QUIET = 0.5
"""Fraction of the lowest frequency where a floor moves twice as far as the base. At lower frequencies the floors move
with the base."""
COHERENT_LINE = 0.8
"""Coherence with the base of lines that count."""
FALLING = 0.9
"""A channel's ratio to the base falls if the upper half of such lines has less than this fraction of the lower half."""
SAME_RATIO = 0.2
"""Relative standard deviation of a level at low frequency, and of a ratio to another unit."""
OTHER_UNIT = 0.005
"""Probability beforehand that a channel is in another unit than declared."""
NEITHER = 1e-6
"""Density of levels that neither explains: one channel in a thousand, of a level up to a thousand."""


@dataclasses.dataclass(frozen=True, eq=False)
class Examined:
    """A record that can be identified, and what was found on the way.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
        One channel a floor, none of them dead, clocks within half a sample of each other.
    findings : tuple of Finding
    turning : callable or None
        The share of rotation at a frequency, Hz, where some floor has several sensors.
    """

    record: Record
    findings: tuple[Finding, ...]
    turning: Callable[[float], float] | None = None

    def without(self, findings: list[Finding]) -> Examined:
        """Leave out the channels of further findings."""
        out = {item.numbers["channel"] for item in findings}
        kept = [column for column, channel in enumerate(self.record.channels) if channel.name not in out]
        return dataclasses.replace(self, record=only(self.record, kept), findings=(*self.findings, *findings))


def examined(record: Record) -> Examined:
    """Look at a record before anything is identified.

    Parameters
    ----------
    record : TimeRecord or FrfRecord

    Returns
    -------
    Examined

    Raises
    ------
    InputError
        Where no channel is left, or two on one floor contradict each other.
    """
    findings = channel_findings(record)
    record = without_sick(record, findings)
    if isinstance(record, FrfRecord):
        record, of_floors = one_a_floor(record)
        return Examined(record, (*findings, *of_floors))
    steady, of_clocks = with_right_channels(without_spikes(record, findings))
    steady, of_directions = along(steady)
    share = turning(steady)
    steady, of_floors = one_a_floor(steady)
    findings += [*of_clocks, *of_directions, *of_floors]
    if steady.input == "base":
        steady, of_signs = _with_the_base(steady)
        findings += of_signs
    return Examined(steady, tuple(findings), share)


def _with_the_base(record: TimeRecord) -> tuple[TimeRecord, list[Finding]]:
    """Signs and units by the motion at low frequency, where every floor moves with the base."""
    gains = floor_over_base(record)
    if gains is None:
        return record, []
    level, std = gains
    units = {size: name for name, size in reversed(quantities.IN_SI["acceleration"].items())}
    factors = np.array([sign * size for sign in (1.0, -1.0) for size in sorted(units, key=lambda size: size != 1.0)])
    priors = np.where(factors > 0, 1.0, FAULTY) * np.where(np.abs(factors) == 1.0, 1.0, OTHER_UNIT)
    # Rows: the input as declared, and reversed; then the channels; then the factors that mend a channel.
    spread = np.hypot(std[:, None], SAME_RATIO / np.abs(factors))
    off = (np.outer([1.0, -1.0], level)[:, :, None] - 1.0 / factors) / spread
    likely = np.exp(-0.5 * off**2) / spread * priors + NEITHER
    turned = int(odds.weigh(np.log(likely.sum(axis=2)).sum(axis=1), np.log([1.0, FAULTY]))[1] >= quantities.SURE)
    findings, changes = [], {}
    if turned:
        findings.append(finding("sign/input", {"channel": "input", "corrected": True}))
        changes["input"] = -1.0
    for channel, value, error, each in zip(record.channels, level * (1 - 2 * turned), std, likely[turned], strict=True):
        best = ranking.first_largest(each)
        if best == 0 or each[0] > (1.0 - quantities.SURE) * each.sum():
            continue
        factor = float(factors[best])
        changes[channel.name] = factor
        if factor < 0:
            numbers = {"channel": channel.name, "gain": float(value), "corrected": True}
            findings.append(finding("sign/base", numbers, where=channel, spread=float(error)))
        if abs(factor) != 1.0:
            why = f"it moves {abs(value):.3g} times as much as the base at low frequency"
            findings.append(in_unit(channel, abs(factor), why))
    return (scaled(record, changes) if changes else record), findings


def unit_of(gain: float) -> str | None:
    """Name the unit of a channel from its ratio to a channel in m/s2; None for m/s2 and for an unknown ratio."""
    return _nearest_unit(1.0 / gain)


def _nearest_unit(size: float) -> str | None:
    """Name the unit of acceleration of this size in m/s2; None without a near unit."""
    off = {name: abs(np.log(size / each)) for name, each in quantities.IN_SI["acceleration"].items()}
    nearest = min(off, key=lambda name: off[name])
    return nearest if off[nearest] < SAME_RATIO else None


def unit_in_truth(channel: Channel, factor: float) -> str | None:
    """Name the unit of a channel whose values need a factor: declared unit or m/s2, times factor; None if unknown."""
    return _nearest_unit(quantities.IN_SI["acceleration"].get(channel.unit or "m/s2", 1.0) * factor)


def in_unit(channel: Channel, factor: float, why: str) -> Finding:
    """Report a channel with another unit than the declared unit or, without a declaration, than the other channels."""
    unit = unit_in_truth(channel, factor)
    if channel.unit is not None:
        looks = f"is declared in {channel.unit} and looks like " + (unit or f"{factor:.3g} times that")
    elif unit is not None:
        looks = f"looks like {unit}, the others like m/s2"
    else:
        looks = f"looks like m/s2, the others like {unit_of(factor) or f'{1 / factor:.3g} times that'}"
    remedy = "" if unit is None else f'. Write unit = "{unit}" in the record file'
    numbers = {"channel": channel.name, "floor": channel.floor, "unit": unit, "factor": factor, "corrected": True}
    return finding("unit", numbers, looks=looks, where=channel, why=why, remedy=remedy)


def floor_over_base(record: TimeRecord) -> tuple[Floats, Floats] | None:
    """Find each floor's motion over the base's towards 0 Hz, and its standard deviation; None if not recorded.

    Below the first resonance the transmissibility is T(f) = T(0) (1 + c f^2 + ...), with T(0) = 1 for a sensor that is
    right; T(0) is fitted to the real parts of H1 below half the lowest frequency with |T| = 2.
    """
    rate = record.sampling_rate
    if record.quantity != "acceleration" or any(
        run.excitation is None or prepare.impulsive(run) for run in record.runs
    ):
        return None
    length = min(int(SEGMENT * rate), min(run.samples for run in record.runs) // 4) // 2 * 2
    if length < 64:
        return None
    columns = len(record.channels) + 1
    cross, power = np.zeros((length // 2 + 1, columns), dtype=np.complex128), np.zeros((length // 2 + 1, columns))
    for run in prepare.detrended(record).runs:
        assert run.excitation is not None
        each, own = prepare.welch(np.column_stack([run.excitation, run.responses]), 0, rate, length)
        cross, power = cross + run.samples * each, power + run.samples * own
    frequencies, base = rate / length * np.arange(length // 2 + 1), power[:, :1]
    cross, power = cross[:, 1:], power[:, 1:]
    transfer, coherence = cross / base, np.abs(cross) ** 2 / (base * power)
    # A table hardly moves at the lowest frequencies; incoherent lines give no transmissibility.
    heard = np.flatnonzero((coherence > COHERENT_LINE).mean(axis=1) > 0.5)
    heard = heard[heard > 1]
    size = np.abs(transfer)
    if not heard.size:
        return None
    relative = size[heard[0] :] / np.maximum(size[heard[:2]].mean(axis=0), 0.05 * np.median(size[2:], axis=0))
    amplified = frequencies[heard[0] + np.flatnonzero((relative > 2.0).any(axis=1))[:1]]
    lines = heard[frequencies[heard] < QUIET * amplified.sum()]
    half = len(lines) // 2
    rows = np.column_stack([np.ones(len(lines)), (frequencies[lines] / amplified) ** 2])
    if len(lines) <= rows.shape[1]:
        return None
    # Above a resonance that the table leaves out motions fall as frequency rises, and have another sign.
    if np.median(size[lines[-half:]].sum(axis=0) / size[lines[:half]].sum(axis=0)) < FALLING:
        return None
    fit, left, *_ = np.linalg.lstsq(rows, transfer[lines].real, rcond=None)
    scatter = left / (len(lines) - 2) if left.size else np.var(transfer[lines].real, axis=0)
    return fit[0], np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[0, 0])
