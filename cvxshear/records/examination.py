"""What is looked at in a record before anything is identified: single channels, and several sensors on one floor.

A rigid floor that moves by U in the direction of test and turns by t moves by u = U - t y at the distance y across that
direction from its center. Sensors with declared positions give U and t by least squares. Without positions, or with a
center far beyond the sensors, U is their mean.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import scipy

from cvxshear.records import clocks, placement, prepare
from cvxshear.records.data_frames import stretches
from cvxshear.records.record import Channel, Finding, FrfRecord, Record, Run, TimeRecord, finding
from cvxshear.util import quantities
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

#: Largest angle, degrees, between a useful sensor and the direction of test or its opposite.
ACROSS = 30.0
#: Share of a floor's mean square motion in its rotation that is worth a word.
ROTATES = 0.05
#: Largest root of the sum of squares of the sensors' weights in the motion of the center. If the center is so far
#: beyond the sensors that noise grows by half, their mean (0.7 for two) is taken.
LARGEST_WEIGHTS = 1.5
#: Two sensors on one floor contradict each other above this ratio of their motions (5 m from the center of floors that
#: turn it reached 1.9 in 56 simulated records; the least ratio of units is 9.8), or of the mean squares of their
#: difference and their mean. Only motion in common with the other floors counts, if there are any.
CONTRADICTING = 4.0


def one_a_floor(record: prepare.AnyRecord) -> tuple[prepare.AnyRecord, list[Finding]]:
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
    length = min(int(prepare.SEGMENT * rate), *(run.samples for run in record.runs)) // 2 * 2
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


def along(record: prepare.AnyRecord) -> tuple[prepare.AnyRecord, list[Finding]]:
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
    record = prepare.only(prepare.scaled(record, factors), kept)
    channels = tuple(dataclasses.replace(channel, direction=None) for channel in record.channels)
    return dataclasses.replace(record, channels=channels), findings


def _rotation(record: Record, group: Ints) -> Finding:
    """Report the rotation that several sensors on one floor show; raise InputError where they contradict each other."""
    names = [record.channels[int(column)] for column in group]
    others = np.flatnonzero(record.floors != names[0].floor)
    weights, placed = center_weights(record.channels, group)
    center, turned, common = 0.0, 0.0, np.zeros((len(group), len(group)))
    for run in record.runs:
        values = moving = run.responses[:, group]
        if isinstance(run, Run):
            values = moving = values - values.mean(axis=0)
            if len(others):
                rest = run.responses[:, others] - run.responses[:, others].mean(axis=0)
                moving = rest @ np.linalg.lstsq(rest, values, rcond=None)[0]
        common += (moving.conj().T @ moving).real / len(values)
        middle = values @ weights
        center += float(np.mean(np.abs(middle) ** 2))
        turned += float(np.sum(np.abs(values - middle[:, None]) ** 2)) / len(values)
    _refuse_contradictions(names, common, "what moves with the other floors is" if len(others) else "the motion is")
    share = float(turned / max(center + turned, 1e-300))
    said = "the floor turns as well" if share > ROTATES else "the floor hardly turns"
    how = "their mean is its motion, and its entries as uncertain as its center is between them"
    if placed:
        how = "by their positions they give its center's motion"
    called = [item.name for item in names]
    numbers = {"floor": names[0].floor, "channels": called, "share": share, "placed": placed}
    return finding("rotation/sensors", numbers, count=len(called), names=", ".join(called), how=how, said=said)


def _refuse_contradictions(names: Sequence[Channel], common: Floats, what: str) -> None:
    """Raise InputError where sensors on one floor cannot all be right, by the products of their motions."""
    shown, together = np.diag(common), float(common.mean())
    ratio = float(np.sqrt(shown.max() / max(shown.min(), 1e-300)))
    against = float(np.trace(common)) - len(names) * together
    if ratio > CONTRADICTING:
        most, least = names[int(np.argmax(shown))], names[int(np.argmin(shown))]
        how = (
            f"{ratio:.1f} times as large in {most} as in {least}; is one of them in another unit, or is its cable cut?"
        )
    elif against > CONTRADICTING * together:
        times = np.sqrt(against / max(together, 1e-300))
        how = f"{times:.1f} times as large in their difference as in their mean; is one reversed, or on another floor?"
    else:
        return
    raise InputError(f"{' and '.join(map(str, names))} are on one floor and contradict each other: {what} {how}")


#: Share of the median channel's standard deviation; a channel below it measures nothing.
DEAD = 1e-4
#: Times as many samples at the extreme value as at the next one, and as many once more, make a clip. The rounded peak
#: of a slow motion has 2.4 times as many.
CLIPPED = 5
#: s, and at least 20 samples, for which a converter that works does not repeat one value while the others move.
STUCK = 0.5
#: Share of a record; a channel that sticks for longer is left out.
STUCK_SHARE = 0.02
#: Local deviations; noise has 5 at most in a record of an hour, and what the frame does the other channels show too.
SPIKE_DEVIATIONS = 10.0
#: Times the root mean square of the samples around it that a spike differs from what the model makes of them.
OUT_OF_MOTION = 2.0
#: Coefficients of the model for spikes: two for each mode of a dozen stories.
AR_ORDER = 24


def channels_mended(record: prepare.AnyRecord) -> tuple[prepare.AnyRecord, list[Finding]]:
    """Name dead, stuck and clipped channels and spikes; replace each spike by what the samples around it say."""
    if isinstance(record, FrfRecord):
        levels = np.sqrt(np.mean([np.mean(np.abs(run.responses) ** 2, axis=0) for run in record.runs], axis=0))
        return record, _dead(record, levels)
    levels = np.sqrt(np.mean([np.var(run.responses, axis=0) for run in record.runs], axis=0))
    found, mended = _dead(record, levels), []
    for run in record.runs:
        responses, spikes = run.responses.copy(), np.zeros(run.responses.shape, dtype=bool)
        cleaned = responses
        if not prepare.impulsive(run):
            spikes, cleaned = spikes_in(responses)
        for column in np.flatnonzero(levels > DEAD * np.median(levels)).tolist():
            channel = record.channels[column]
            where = f"{run.name}: {channel}"
            of_channel = [*_clipped(responses[:, column], where, channel.name)]
            of_channel += _stuck(responses, column, where, channel.name, record.sampling_rate)
            # The corners of clipped and stuck values would be taken for spikes.
            if not of_channel and (count := int(spikes[:, column].sum())):
                numbers, first = {"channel": channel.name, "samples": count}, int(np.argmax(spikes[:, column])) + 1
                counted = quantities.counted(count, "spike")
                of_channel.append(finding("spikes", numbers, where=where, spikes=counted, first=first))
                responses[:, column] = cleaned[:, column]
            found += of_channel
        if run.excitation is not None:
            found += _clipped(run.excitation, f"{run.name}: input channel", "input")
        mended.append(responses)
    return prepare.with_responses(record, mended), found


def spikes_in(responses: Floats) -> tuple[Bools, Floats]:
    """Find samples that differ from their neighbors in one channel alone, and the responses without them.

    With the coefficients a of an autoregressive model, the difference of a sample from what all others make of it is
    (a * reversed a * x) / (a'a): white where the model holds, and largest at the sample itself.
    """
    cleaned, found = np.array(responses), np.zeros(responses.shape, dtype=bool)
    # One spike throws the errors around it off: the largest in reach is taken first, and those beside it after.
    while True:
        off, scale = np.zeros(responses.shape), np.full(responses.shape, np.inf)
        for column, values in enumerate(cleaned.T):
            if values.std() > 0:
                off[:, column] = _interpolation_errors(values - values.mean())
                scale[:, column] = _local_scale(off[:, column])
        # Under strong motion a model of the whole record has larger errors; a spike exceeds the local and the overall
        # errors.
        loud = np.sqrt(scipy.ndimage.uniform_filter1d((cleaned - cleaned.mean(axis=0)) ** 2, 2 * AR_ORDER + 1, axis=0))
        ratio = np.where(np.abs(off) > OUT_OF_MOTION * loud, np.abs(off) / scale, 0.0)
        near = scipy.ndimage.maximum_filter1d(ratio, 5, axis=0)
        now = (ratio > SPIKE_DEVIATIONS) & (ratio >= scipy.ndimage.maximum_filter1d(ratio, 2 * AR_ORDER + 1, axis=0))
        for hit in np.flatnonzero(now.any(axis=0)).tolist():
            others = np.delete(near, hit, axis=1)
            if others.shape[1]:
                now[:, hit] &= others.max(axis=1) < SPIKE_DEVIATIONS / 2
        for place, hit in np.argwhere(now).tolist():
            now[place, hit] = not _begins(cleaned, place, hit)
        if not np.any(now & ~found):
            return found, cleaned
        found |= now
        cleaned[now] -= off[now]


def _begins(values: Floats, place: int, hit: int) -> bool:
    """Whether motion of a channel begins at a sample and goes on as strongly, or begins in all within reach of it."""
    # The model looks ahead: its errors begin before the first sample that moves. A knock on the sensor's own
    # floor dies away as fast as its highest modes, so what follows at once counts; a filter smears one sample to two.
    before = np.abs(values[max(0, place - 2 - AR_ORDER) : max(0, place - 2)])
    after = np.abs(values[place + 3 : place + 2 * AR_ORDER + 1])
    if not len(before) or not len(after):
        return True
    loud = np.quantile(after, 0.75, axis=0)
    rises = loud[hit] > 3.0 * np.quantile(before[:, hit], 0.75)
    # The model looks back: a release affects its errors at later samples.
    quiet = np.abs(values[max(0, place - 2 * AR_ORDER) : max(1, place - AR_ORDER)])
    released = values.shape[1] > 1 and bool(np.all(loud > 3.0 * np.quantile(quiet, 0.75, axis=0)))
    return released or bool(rises and abs(values[place, hit]) < 4.0 * after[:, hit].max())


def _interpolation_errors(values: Floats) -> Floats:
    """Each sample less what an autoregressive model makes of those around it; nought at the ends."""
    order = min(AR_ORDER, len(values) // 8)
    # Samples are cut off where the model is fitted, lest spikes make it.
    limit = SPIKE_DEVIATIONS * np.minimum(_local_scale(values), 1e300)
    spectrum = np.abs(np.fft.rfft(np.clip(values, -limit, limit), 2 * len(values))) ** 2
    covariances = np.fft.irfft(spectrum)[: order + 1]
    covariances[0] *= 1.0 + 1e-6
    model = np.concatenate([[1.0], -scipy.linalg.solve_toeplitz(covariances[:-1], covariances[1:])])
    errors = np.convolve(values, np.convolve(model, model[::-1]), mode="same") / (model @ model)
    errors[:order] = errors[-order:] = 0.0
    return np.asarray(errors)


def _local_scale(errors: Floats) -> Floats:
    """Estimate the standard deviation of errors around each sample, from the medians of their sizes in blocks."""
    count = max(1, len(errors) // 200)
    parts = np.array_split(np.abs(errors), count)
    # The louder of a block and its neighbors: an onset is no spike.
    medians = scipy.ndimage.maximum_filter1d([np.median(part) / 0.6745 for part in parts], 3)
    lengths = np.array([len(part) for part in parts])
    scale = np.interp(np.arange(len(errors)), np.cumsum(lengths) - 0.5 * lengths, medians)
    return np.asarray(np.where(scale > 0, scale, np.inf))


def _stuck(responses: Floats, column: int, where: str, name: str, rate: float) -> Iterator[Finding]:
    """Find samples that repeat one value for long while the other channels move as elsewhere."""
    values, stuck = responses[:, column], np.zeros(len(responses), dtype=bool)
    repeats = stretches(np.diff(values) == 0) + np.array([0, 1])
    others = np.delete(responses, column, axis=1)
    for start, stop in repeats[np.diff(repeats, axis=1)[:, 0] >= max(20, int(STUCK * rate))].tolist():
        moved = others[start:stop].std(axis=0) / np.maximum(others.std(axis=0), 1e-300)
        # Where all is quiet, converters of few bits repeat themselves; the others then do as well.
        repeated = np.mean(np.diff(others[start:stop], axis=0) == 0, axis=0)
        stuck[start:stop] = others.size and (np.median(moved) > 0.3 or np.median(repeated) < 0.2)
    if not stuck.any():
        return
    where_stuck = stretches(stuck)
    count, longest, first = int(stuck.sum()), int(np.diff(where_stuck, axis=1).max()), int(where_stuck[0, 0])
    out = bool(count > STUCK_SHARE * len(stuck))
    numbers = {"channel": name, "samples": count, "share": float(count / len(stuck)), "out": out}
    yield finding(
        "stuck channel", numbers, where=where, value=responses[first, column], first=first + 1, length=len(stuck),
        longest=longest / rate, left_out="; left out" if out else "",
    )  # fmt: skip


def _dead(record: Record, levels: Floats) -> list[Finding]:
    typical = float(np.median(levels[levels > 0])) if np.any(levels > 0) else 0.0
    found = []
    for channel, level in zip(record.channels, levels.tolist(), strict=True):
        if level <= DEAD * typical:
            place = {"channel": channel.name, "floor": channel.floor}
            numbers = {**place, "std": level, "median_std": typical, "out": True}
            found.append(finding("dead channel", numbers, where=channel))
    return found


def _clipped(values: Floats, where: str, name: str) -> Iterator[Finding]:
    """Find samples cut off at the extreme value."""
    levels, times = np.unique(values, return_counts=True)
    for extreme, beside in ((-1, -2), (0, 1)):
        level, count = levels[extreme], int(times[extreme])
        far = abs(level - np.median(values)) > values.std()
        if far and CLIPPED * (1 + times[beside]) <= count < 0.5 * len(values):
            numbers = {"channel": name, "level": float(level), "samples": count, "share": count / len(values)}
            first = int(np.argmax(values == level)) + 1
            yield finding("clipped channel", numbers, where=where, length=len(values), first=first)
            break


@dataclasses.dataclass(frozen=True, eq=False)
class Examined:
    """A record that can be identified, and what was found on the way.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
        One channel a floor, unless the floors turn; none of them dead, clocks within half a sample of each other.
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
    record, findings = channels_mended(record)
    record = prepare.without(record, findings)
    if isinstance(record, FrfRecord):
        record, of_floors = one_a_floor(record)
        return Examined(record, (*findings, *of_floors))
    steady, of_clocks = clocks.with_right_channels(record)
    findings += of_clocks
    if steady.turns:
        return Examined(steady, tuple(findings))
    steady, of_directions = along(steady)
    share = turning(steady)
    steady, of_floors = one_a_floor(steady)
    findings += [*of_directions, *of_floors]
    if steady.input == "base":
        steady, of_signs = placement.with_the_base(steady)
        findings += of_signs
    return Examined(steady, tuple(findings), share)
