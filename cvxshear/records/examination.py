"""What is done to a record before anything is identified: sick channels out, clocks set right, signs and units judged.

Every step that changes the record is said in a finding; a record with nothing wrong comes back as it went in.
"""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import scipy

from cvxshear.records.clocks import BandClock, Segments, band_clock, drift_of, straight
from cvxshear.records.findings import finding
from cvxshear.records.floors import along, one_a_floor, turning
from cvxshear.records.record import Channel, Finding, FrfRecord, Record, TimeRecord
from cvxshear.records.sick_channels import channel_findings, without_sick, without_spikes
from cvxshear.records.signals import detrended, impulsive, in_step, only, scaled, struck
from cvxshear.util.quantities import IN_SI, significant
from cvxshear.util.typing import Floats

SILENT = 6.0
"""Times the agreement that chance makes at one delay, which the search over delays and drifts brings it to."""
LEAST_AGREEMENT, MOST_CHANCE = 0.08, 0.55
"""Bounds of that limit: hum has a little in common with everything, up to a sixth of what channels have that measure;
few lines leave much to chance."""
AGREED = 0.25
"""Agreement of phases that tells a channel's clock; half of what is usual in an ambient record where that is less."""
IN_COMMON = 30.0
"""Times the agreement that chance makes, from which on drifts are looked for where less than `AGREED` is in common: of
a long ambient record sampled far beyond its highest mode."""
LATE = 0.5
"""Samples; a delay of less is left to the phases of the modes, which tell it finer."""
IN_STEP = 0.6
"""Agreement of phases without a delay, over that with it, from which on the delay may be chance: of few modes, which
nearly agree at many delays. Delays of half a sample and more leave a third at most."""
CERTAIN_DELAY = 4.0
"""Standard deviations of a delay that is taken out."""
DELAYS_AGREE = 0.05
"""Of a delay: as near half of the other clocks must come to it. Dampers part them by a fraction of a sample."""
SLOPES_AGREE = 0.6
"""Of a drift: as near the drifts against every other clock must come to it. Those that dampers feign differ by more."""
HINT = 2.0
"""Standard deviations of a drift against one clock from which on the others are asked."""
QUIET = 0.5
"""Of the frequency at which the motion of some floor is twice the base's: below it the floors move with the base."""
FEWEST_LINES_BELOW = 3
"""Lines below the first resonance that the signs of a record with base motion are told by."""
COHERENT_LINE = 0.8
"""Coherence with the base of lines that count."""
SAME_RATIO = 0.2
"""Relative; how near a ratio of levels must come to that of two units."""


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
    late : dict
        What was taken out of the clocks of channels, and of "input": (s at the start, s a second).
    """

    record: Record
    findings: tuple[Finding, ...]
    late: dict[str, tuple[float, float]]
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
        return Examined(record, (*findings, *of_floors), {})
    steady, of_clocks, late = _in_step(without_spikes(record, findings))
    steady, of_directions = along(steady)
    share = turning(steady)
    steady, of_floors = one_a_floor(steady)
    findings += [*of_clocks, *of_directions, *of_floors]
    if steady.input == "base":
        steady, of_signs = _with_the_base(steady)
        findings += of_signs
    return Examined(steady, tuple(findings), late, share)


def _in_step(record: TimeRecord) -> tuple[TimeRecord, list[Finding], dict[str, tuple[float, float]]]:
    """Channels that share nothing with the others out; clocks that are late set right."""
    names = [channel.name for channel in record.channels]
    driven = record.runs[0].excitation is not None
    clocks = [*names, "input"] if driven else names
    if len(clocks) < 2 or min(run.samples for run in record.runs) < 4 * record.sampling_rate:
        return record, [], {}
    segments = Segments.of(record)
    plain = np.array([[_in_common(segments, i, j) for j in range(len(clocks))] for i in range(len(clocks))])
    reference = int(np.argmax(np.median(plain, axis=0) if len(clocks) > 3 else plain.sum(axis=0)))
    against = {i: band_clock(segments, i, reference) for i in range(len(clocks)) if i != reference}
    usual = float(np.median(np.delete(plain[reference], reference)))
    least = max(LEAST_AGREEMENT, usual / 6)
    limits = {i: min(max(SILENT * item.chance, least), MOST_CHANCE) for i, item in against.items()}
    # Sampled far beyond its highest mode a frame has much of its band where forces of the wind move each floor alone.
    agreed = min(AGREED, usual / 2) if record.input == "none" else AGREED
    heard_by = {i: item for i, item in against.items() if item.agreement > max(agreed, limits[i])}
    if len(heard_by) < len(against) / 2:
        # Nothing is sure where most have little in common: a few sine waves, a record of noise.
        return record, [], {}
    silent = [i for i, item in against.items() if item.agreement < limits[i] and names[i : i + 1]]
    findings = [_silent(record, i, against[i]) for i in silent]
    heard_by[reference] = BandClock(0.0, 0.0, 1.0, 0.0)
    # Where little more is in common than chance makes, the search over drifts finds one in its noise. Several blows in
    # one run may be at several floors, whatever is declared, and with dampers the phases are other ones at each.
    apart = len(record.runs) > 1 or not struck(record)
    common = apart and usual > min(AGREED, IN_COMMON * float(np.median([item.chance for item in against.values()])))
    drifts = {i: _drift(segments, i, heard_by) if common else (0.0, np.inf) for i in heard_by}
    # The clock that is nearest to all others counts as right, of those that do not drift.
    middles = {i: item.middle for i, item in heard_by.items()}
    right = min(
        middles, key=lambda i: (drifts[i][0] != 0, sum(abs(middles[i] - other) for other in middles.values()), i)
    )
    wrong: dict[str, tuple[float, float]] = {}
    limit = LATE / record.sampling_rate
    for i, item in heard_by.items():
        late, std, (slope, slope_std) = item.middle - middles[right], np.hypot(item.std, heard_by[right].std), drifts[i]
        if driven and not slope and i < len(names) and i != reference and not struck(record):
            others = [band_clock(segments, i, k) for k in heard_by if k != i]
            findings += _perhaps_drifting(clocks[i], others, limit / 2)
        if i == right or (abs(late) < max(limit, CERTAIN_DELAY * std) and not slope):
            continue
        if not slope:
            off = np.abs(_by_others(segments, i, right, len(clocks)) - late)
            if sum(off < max(2 * limit, DELAYS_AGREE * abs(late))) < len(off) / 2:
                continue
            std = np.hypot(std, np.median(off) if len(off) else 0.0)
        if not slope and segments.agreed(i, right, 0.0) > IN_STEP * segments.agreed(i, right, late):
            continue
        if not straight(segments, i, right, late, slope, item.time):
            continue
        start = late - slope * (item if i != reference else heard_by[right]).time
        wrong[clocks[i]] = (start, slope)
        if slope:
            findings.append(_drifting(clocks[i], clocks[right], start, slope, slope_std))
        else:
            findings.append(clock_offset(clocks[i], clocks[right], late, float(std)))
    kept = [column for column in range(len(names)) if column not in silent]
    record = only(record, kept) if silent else record
    return (in_step(record, wrong) if wrong else record), findings, wrong


def _in_common(segments: Segments, first: int, second: int) -> float:
    """Find the largest agreement of two clocks over all delays, over what chance makes; 0 of a clock with itself."""
    if first == second:
        return 0.0
    squares, weights, _, _ = segments.agreement(first, second)
    total = float(weights.sum())
    if total <= 0:
        return 0.0
    delays = np.fft.ifft(squares.sum(axis=0), n=2 * segments.length).real * 2 * segments.length
    return float(delays.max()) / total


def _by_others(segments: Segments, late: int, right: int, clocks: int) -> Floats:
    """Find how late a clock is against another by each of the remaining clocks, s."""
    others = [k for k in range(clocks) if k not in (late, right)]
    return np.array([band_clock(segments, late, k).middle - band_clock(segments, right, k).middle for k in others])


def _drift(segments: Segments, place: int, heard: dict[int, BandClock]) -> tuple[float, float]:
    """Drift of a clock by all that are heard, and its standard deviation; 0 where nothing hints at any."""
    hints = {i for i, item in heard.items() if abs(item.slope) > HINT * item.slope_std}
    # Where the clock that all were compared with drifts, most of them seem to.
    reference = heard[place].freedom == 0
    if not (len(hints) > 1 if reference else place in hints):
        return 0.0, heard[place].slope_std
    return drift_of([band_clock(segments, place, k) for k in heard if k != place], segments.rate)


def _silent(record: TimeRecord, column: int, clock: BandClock) -> Finding:
    channel = record.channels[column]
    numbers = {"channel": channel.name, "floor": channel.floor, "agreement": clock.agreement, "out": True}
    return finding("dead channel/silent", numbers, where=channel, chance=clock.chance)


def _perhaps_drifting(name: str, clocks: list[BandClock], least: float) -> Iterator[Finding]:
    """Report a clock that seems to drift against every other, in a record that passes one mode after the other."""
    slopes = np.array([clock.steepest for clock in clocks])
    slope, reach = float(np.median(slopes)), float(np.median([clock.reach for clock in clocks]))
    alike = np.abs(slopes - slope).max() < SLOPES_AGREE * abs(slope)
    if len(slopes) < 3 or not alike or abs(slope) * reach < least:
        return
    numbers = {"channel": name, "drift": slope, "corrected": False}
    yield finding("clock drift/doubtful", numbers, slow="slow" if slope > 0 else "fast", by=abs(slope))


def _drifting(name: str, reference: str, start: float, slope: float, std: float) -> Finding:
    numbers = {"channel": name, "seconds": start, "drift": slope, "drift_std": std, "corrected": True}
    return finding(
        "clock drift", numbers, slow="slow" if slope > 0 else "fast", by=abs(slope), std=significant(1e6 * std, 2),
        start=abs(start), late="late" if start > 0 else "early", reference=reference,
    )  # fmt: skip


def clock_offset(name: str, reference: str, seconds: float, std: float) -> Finding:
    """Report a clock that was late, or early, by the phases of the whole band, and has been set right."""
    numbers = {"channel": name, "reference": reference, "seconds": seconds, "std": std, "corrected": True}
    late, spread = "late" if seconds > 0 else "early", significant(1e3 * std, 2)
    return finding("clock offset", numbers, by=abs(seconds), late=late, spread=spread)


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
    """Name the unit of a channel that shows so many times what one in m/s2 would; None where it is m/s2 or no unit."""
    return None if abs(np.log(gain)) <= 3 * SAME_RATIO else _nearest_unit(1.0 / gain)


def _nearest_unit(size: float) -> str | None:
    """Name the unit of acceleration that is nearest to so many m/s2; None where none is near."""
    off = {name: abs(np.log(size / each)) for name, each in IN_SI["acceleration"].items()}
    nearest = min(off, key=lambda name: off[name])
    return nearest if off[nearest] < SAME_RATIO else None


def unit_in_truth(channel: Channel, factor: float) -> str | None:
    """Name the unit that a channel was recorded in, where its values are to be multiplied by a factor; None if none is.

    What it was declared in, or m/s2, times the factor.
    """
    return _nearest_unit(IN_SI["acceleration"].get(channel.unit or "m/s2", 1.0) * factor)


def in_unit(channel: Channel, factor: float, why: str) -> Finding:
    """Report a channel recorded in another unit than was declared or, where nothing was, than the others."""
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
    right; T(0) is fitted to the real parts of H1 below half the frequency at which some |T| reaches 2.
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
    usual = np.median(np.abs(transfer[2:]), axis=0)
    relative = np.abs(transfer) / np.maximum(np.abs(transfer[2:4]).mean(axis=0), 0.05 * usual)
    amplified = np.flatnonzero((relative > 2.0).any(axis=1) & (frequencies > 2 * frequencies[1]))
    if not amplified.size:
        return None
    lines = np.flatnonzero((frequencies < QUIET * frequencies[amplified[0]]) & (np.arange(len(frequencies)) > 1))
    lines = lines[(coherence[lines] > COHERENT_LINE).mean(axis=1) > 0.5]
    if len(lines) < FEWEST_LINES_BELOW:
        return None
    rows = np.column_stack([np.ones(len(lines)), (frequencies[lines] / frequencies[amplified[0]]) ** 2])
    fit, left, *_ = np.linalg.lstsq(rows, transfer[lines].real, rcond=None)
    scatter = left / (len(lines) - 2) if left.size else np.var(transfer[lines].real, axis=0)
    return fit[0], np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[0, 0])
