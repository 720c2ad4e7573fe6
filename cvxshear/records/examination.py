"""Examine a record before the identification: remove faulty channels, correct clocks, judge signs and units.

A finding reports each change of the record. A sound record is not changed.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy

from cvxshear.records.findings import finding
from cvxshear.records.floors import along, one_a_floor, turning
from cvxshear.records.late_clocks import CERTAIN_DELAY, with_right_clocks
from cvxshear.records.record import Channel, Finding, FrfRecord, Record, TimeRecord
from cvxshear.records.sick_channels import channel_findings, without_sick, without_spikes
from cvxshear.records.signals import detrended, impulsive, scaled
from cvxshear.util.quantities import IN_SI
from cvxshear.util.typing import Floats

QUIET = 0.5
"""Fraction of the lowest frequency where a floor moves twice as far as the base. At lower frequencies the floors move
with the base."""
FEWEST_LINES_BELOW = 3
"""Lines below the first resonance for the signs of a record with base motion."""
COHERENT_LINE = 0.8
"""Coherence with the base of lines that count."""
FALLING = 0.9
"""A channel's ratio to the base falls if the upper half of such lines has less than this fraction of the lower half."""
SAME_RATIO = 0.2
"""Largest relative difference between a ratio of levels and a ratio of two units."""


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
    steady, of_clocks = with_right_clocks(without_spikes(record, findings))
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
    findings, factors = [], {}
    reversed_ = level < -CERTAIN_DELAY * std
    if reversed_.sum() > len(level) / 2:
        reversed_, level = ~reversed_, -level
        findings.append(finding("sign/input", {"channel": "input", "corrected": True}))
        factors["input"] = -1.0
    for channel, value, spread, wrong in zip(record.channels, level, std, reversed_, strict=True):
        factor = 1.0
        if wrong:
            factor = -1.0
            numbers = {"channel": channel.name, "gain": float(value), "corrected": True}
            findings.append(finding("sign/base", numbers, where=channel, spread=spread))
        unit = unit_of(abs(float(value)))
        if unit is not None and abs(value) > CERTAIN_DELAY * spread:
            size = IN_SI["acceleration"][unit]
            factor *= size
            why = f"it moves {abs(value):.3g} times as much as the base at low frequency"
            findings.append(in_unit(channel, size, why))
        if factor != 1.0:
            factors[channel.name] = factor
    return (scaled(record, factors) if factors else record), findings


def unit_of(gain: float) -> str | None:
    """Name the unit of a channel from its ratio to a channel in m/s2; None for m/s2 and for an unknown ratio."""
    return None if abs(np.log(gain)) <= 3 * SAME_RATIO else _nearest_unit(1.0 / gain)


def _nearest_unit(size: float) -> str | None:
    """Name the unit of acceleration of this size in m/s2; None without a near unit."""
    off = {name: abs(np.log(size / each)) for name, each in IN_SI["acceleration"].items()}
    nearest = min(off, key=lambda name: off[name])
    return nearest if off[nearest] < SAME_RATIO else None


def unit_in_truth(channel: Channel, factor: float) -> str | None:
    """Name the unit that a channel was recorded in, where its values are to be multiplied by a factor; None if none is.

    What it was declared in, or m/s2, times the factor.
    """
    return _nearest_unit(IN_SI["acceleration"].get(channel.unit or "m/s2", 1.0) * factor)


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
    if record.quantity != "acceleration" or any(run.excitation is None or impulsive(run) for run in record.runs):
        return None
    length = min(int(20 * rate), min(run.samples for run in record.runs) // 4) // 2 * 2
    if length < 64:
        return None
    record = detrended(record)
    lines_of = length // 2 + 1
    cross = np.zeros((lines_of, len(record.channels)), dtype=np.complex128)
    power, base, frequencies = np.zeros(cross.shape), np.zeros((lines_of, 1)), np.zeros(lines_of)
    for run in record.runs:
        assert run.excitation is not None
        both = np.column_stack([run.excitation, run.responses])
        weight = run.samples
        frequencies, each = scipy.signal.csd(both[:, [0]], both, rate, nperseg=length, axis=0)
        _, own = scipy.signal.welch(both, rate, nperseg=length, axis=0)
        cross, power, base = cross + weight * each[:, 1:], power + weight * own[:, 1:], base + weight * own[:, [0]]
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
    if len(lines) < FEWEST_LINES_BELOW:
        return None
    # Above a resonance that the table leaves out motions fall as frequency rises, and have another sign.
    if np.median(size[lines[-half:]].sum(axis=0) / size[lines[:half]].sum(axis=0)) < FALLING:
        return None
    rows = np.column_stack([np.ones(len(lines)), (frequencies[lines] / amplified) ** 2])
    fit, left, *_ = np.linalg.lstsq(rows, transfer[lines].real, rcond=None)
    scatter = left / (len(lines) - 2) if left.size else np.var(transfer[lines].real, axis=0)
    return fit[0], np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[0, 0])
