"""Channels that share nothing with the others left out, and clocks that are late or drift set right.

Two channels are compared by the phases of the whole band (`records.clocks`); which of the two is wrong the other
channels tell.
"""

from collections.abc import Callable, Mapping
from functools import cache, partial

import numpy as np
from scipy import special

from cvxshear.records.clocks import BandClock, band_clock, straight
from cvxshear.records.findings import finding
from cvxshear.records.record import Channel, Finding, TimeRecord
from cvxshear.records.segments import Segments
from cvxshear.records.signals import in_step, only, struck
from cvxshear.util.quantities import significant

SILENT = 6.0
"""Times the agreement that chance makes at one delay, which the search over delays and drifts brings it to."""
LEAST_AGREEMENT, MOST_CHANCE = 0.08, 0.55
"""Bounds of that limit: hum has a little in common with everything, up to a sixth of what channels have that measure;
few lines leave much to chance."""
AGREED = 0.25
"""Agreement of phases that tells a channel's clock; half of what is usual in an ambient record where that is less."""
IN_COMMON = 30.0
"""Ratio of agreement to chance above which drifts are searched for although less than `AGREED` is in common, as in long
ambient records with a high sampling rate."""
LATE = 0.5
"""Samples; the phases of the modes determine smaller delays more accurately."""
IN_STEP = 0.6
"""Largest ratio of the agreement without a delay to the agreement with it; above it, the delay may be chance: a few
modes nearly agree at many delays. Delays of half a sample and more leave a third at most."""
CERTAIN_DELAY = 4.0
"""Standard deviations of a delay that is taken out."""
DELAYS_AGREE = 0.05
"""Of a delay: as near half of the other clocks must come to it. Dampers part them by a fraction of a sample."""
NEARLY_AS_GOOD = 0.8
"""Fraction of the largest agreement of two clocks. A delay that reaches it does not contradict them. Dampers turn the
few modes of a decay, and a sidelobe of theirs may then be higher than the delay."""
MICROSECONDS = 6
"""Digits for the comparison of sums of delays, s; clocks are less accurate."""
HINT = 2.0
"""Drifts against one clock above this number of standard deviations are compared with the other clocks."""
DRIFT_CHANCE = 1e-6
"""Probability that chance makes a slope so steep of the delays in the parts of a record."""
DRIFT_SHORTEST = 0.08
"""Samples from the middle of the record to its end that a drift must make."""

Compare = Callable[[int, int], BandClock]
"""How late the first of two clocks is against the second."""


def with_right_clocks(record: TimeRecord) -> tuple[TimeRecord, list[Finding]]:
    """Leave out channels that share nothing with the others, and set clocks right that are late or drift."""
    names = [channel.name for channel in record.channels]
    driven = record.runs[0].excitation is not None
    clocks = [*names, "input"] if driven else names
    if len(clocks) < 2 or min(run.samples for run in record.runs) < 4 * record.sampling_rate:
        return record, []
    segments = Segments.of(record)
    compare: Compare = cache(partial(band_clock, segments))
    plain = np.array([[_in_common(segments, i, k) for k in range(len(clocks))] for i in range(len(clocks))])
    shared = np.median(plain, axis=0) if len(clocks) > 3 else plain.sum(axis=0)
    reference = int(np.argmax(shared))
    against = {i: compare(i, reference) for i in range(len(clocks)) if i != reference}
    usual = float(np.median(np.delete(plain[reference], reference)))
    least = max(LEAST_AGREEMENT, usual / 6)
    limits = {i: min(max(SILENT * item.chance, least), MOST_CHANCE) for i, item in against.items()}
    # Sampled far beyond its highest mode a frame has much of its band where forces of the wind move each floor alone.
    agreed = min(AGREED, usual / 2) if record.input == "none" else AGREED
    heard = {i: item for i, item in against.items() if item.agreement > max(agreed, limits[i])}
    if len(heard) < len(against) / 2:
        # Most channels have little in common, as in a few sine waves or in noise: nothing can be concluded.
        return record, []
    silent = [i for i, item in against.items() if item.agreement < limits[i] and i < len(names)]
    findings = [_silent(record.channels[i], against[i]) for i in silent]
    heard[reference] = BandClock(0.0, 0.0, 1.0, 0.0)
    # Where little more is in common than chance makes, the search over drifts finds one in its noise. Several blows in
    # one run may be at several floors, whatever is declared, and with dampers the phases are other ones at each.
    comparable = len(record.runs) > 1 or not struck(record)
    by_chance = float(np.median([item.chance for item in against.values()]))
    common = comparable and usual > min(AGREED, IN_COMMON * by_chance)
    drifts = {i: _drift(compare, i, heard, segments.rate) if common else (0.0, np.inf) for i in heard}
    # The right clock is the nearest to all others among the clocks without a drift. With an even number of clocks, two
    # are equally near except for rounding; take the clock with more in common with the others.
    middles = {i: item.middle for i, item in heard.items()}
    apart_by = {i: round(sum(abs(middles[i] - each) for each in middles.values()), MICROSECONDS) for i in heard}
    right = min(heard, key=lambda i: (drifts[i][0] != 0, apart_by[i], -shared[i]))
    wrong: dict[str, tuple[float, float]] = {}
    for i in heard.keys() - {right}:
        late, (slope, slope_std) = middles[i] - middles[right], drifts[i]
        std = float(np.hypot(heard[i].std, heard[right].std))
        if not slope:
            std = _std_of_delay(compare, segments, i, right, late, std)
        if not np.isfinite(std) or not straight(segments, i, right, late, slope, heard[i].time):
            continue
        start = late - slope * heard[i if i != reference else right].time
        wrong[clocks[i]] = (start, slope)
        if slope:
            findings.append(clock_drift(clocks[i], clocks[right], start, slope, slope_std))
        else:
            findings.append(clock_offset(clocks[i], clocks[right], late, std))
    if silent:
        record = only(record, [column for column in range(len(names)) if column not in silent])
    return (in_step(record, wrong) if wrong else record), findings


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


def _std_of_delay(compare: Compare, segments: Segments, late: int, right: int, seconds: float, std: float) -> float:
    """Find the standard deviation of a delay with the scatter of the other clocks; inf for an uncertain delay."""
    limit = LATE / segments.rate
    if abs(seconds) < max(limit, CERTAIN_DELAY * std):
        return np.inf
    off = []
    for k in range(segments.spectra.shape[2]):
        if k not in (late, right):
            own, expected = compare(late, k).middle, compare(right, k).middle + seconds
            turned = segments.agreed(late, k, expected) >= NEARLY_AS_GOOD * segments.agreed(late, k, own)
            off.append(0.0 if turned else abs(own - expected))
    if sum(each < max(2 * limit, DELAYS_AGREE * abs(seconds)) for each in off) < len(off) / 2:
        return np.inf
    if segments.agreed(late, right, 0.0) > IN_STEP * segments.agreed(late, right, seconds):
        return np.inf
    return float(np.hypot(std, np.median(off) if off else 0.0))


def _drift(compare: Compare, place: int, heard: Mapping[int, BandClock], rate: float) -> tuple[float, float]:
    """Drift of a clock, s a second, and its standard deviation; 0 where nothing hints at any."""
    hints = {i for i, item in heard.items() if abs(item.slope) > HINT * item.slope_std}
    # Where the clock that all were compared with drifts, most of them seem to.
    reference = heard[place].freedom == 0
    if not (len(hints) > 1 if reference else place in hints):
        return 0.0, heard[place].slope_std
    return _drift_of([compare(place, k) for k in heard if k != place], rate)


def _drift_of(clocks: list[BandClock], rate: float) -> tuple[float, float]:
    """Drift of a clock that was compared with several others, s a second, and its standard deviation; 0 for none.

    Every comparison holds the noise of the clock itself, so more of them make the drift no surer; but the scatter
    about each line is one more estimate of the same deviation, which few stretches of motion tell badly.
    """
    fitted = [clock for clock in clocks if clock.freedom > 0]
    if not fitted:
        return 0.0, np.inf
    slope = float(np.median([clock.slope for clock in fitted]))
    std = float(np.median([clock.slope_std for clock in fitted]))
    certain = -float(special.stdtrit(sum(clock.freedom for clock in fitted), DRIFT_CHANCE))
    reach = float(np.median([clock.reach for clock in fitted]))
    # A sound clock moves against one that drifts, and against no other.
    alone = sum(abs(clock.slope - slope) > abs(slope) / 2 for clock in fitted) > len(fitted) / 2
    if abs(slope) < certain * std or abs(slope) * reach < DRIFT_SHORTEST / rate or alone:
        return 0.0, std
    return slope, std


def _silent(channel: Channel, clock: BandClock) -> Finding:
    numbers = {"channel": channel.name, "floor": channel.floor, "agreement": clock.agreement, "out": True}
    return finding("dead channel/silent", numbers, where=channel, chance=clock.chance)


def clock_drift(name: str, reference: str, start: float, slope: float, std: float) -> Finding:
    """Report a clock that drifted, and has been set right."""
    numbers = {"channel": name, "reference": reference, "seconds": start, "drift": slope, "drift_std": std}
    numbers["corrected"] = True
    return finding(
        "clock drift", numbers, slow="slow" if slope > 0 else "fast", by=abs(slope), std=significant(1e6 * std, 2),
        start=abs(start), late="late" if start > 0 else "early",
    )  # fmt: skip


def clock_offset(name: str, reference: str, seconds: float, std: float) -> Finding:
    """Report a clock that was late, or early, by the phases of the whole band, and has been set right."""
    numbers = {"channel": name, "reference": reference, "seconds": seconds, "std": std, "corrected": True}
    late, spread = "late" if seconds > 0 else "early", significant(1e3 * std, 2)
    return finding("clock offset", numbers, by=abs(seconds), late=late, spread=spread)
