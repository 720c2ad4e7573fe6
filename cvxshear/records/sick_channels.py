"""Faults of single channels, found before the identification."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy import linalg, ndimage

from cvxshear.records.data_frames import stretches
from cvxshear.records.prepare import AnyRecord, impulsive, only
from cvxshear.records.record import Finding, FrfRecord, Record, TimeRecord, finding
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import counted
from cvxshear.util.typing import Bools, Floats

DEAD = 1e-4
"""Share of the median channel's standard deviation; a channel below it measures nothing."""
CLIPPED = 5
"""Times as many samples at the extreme value as at the next one, and as many once more, make a clip. The rounded peak
of a slow motion has 2.4 times as many."""
STUCK = 0.5
"""s, and at least 20 samples, for which a converter that works does not repeat one value while the others move."""
STUCK_SHARE = 0.02
"""Share of a record; a channel that sticks for longer is left out."""
SPIKE_DEVIATIONS = 10.0
"""Local deviations; noise has 5 at most in a record of an hour, and what the frame does the other channels show too."""
OUT_OF_MOTION = 2.0
"""Times the root mean square of the samples around it that a spike differs from what the model makes of them."""
AR_ORDER = 24
"""Coefficients of the model for spikes: two for each mode of a dozen stories."""
SPIKE_PASSES = 8
"""Number of searches for spikes; each search finds one of several near spikes."""
LEFT_OUT = ("dead channel", "stuck channel")
"""Kinds of findings whose channel is left out, by name."""


def channel_findings(record: Record) -> list[Finding]:
    """Dead, stuck, clipped and held channels and spikes, each with its numbers."""
    if isinstance(record, FrfRecord):
        levels = np.sqrt(np.mean([np.mean(np.abs(run.responses) ** 2, axis=0) for run in record.runs], axis=0))
        return _dead(record, levels)
    levels = np.sqrt(np.mean([np.var(run.responses, axis=0) for run in record.runs], axis=0))
    found = _dead(record, levels)
    for run in record.runs:
        spikes = np.zeros(run.responses.shape, dtype=bool) if impulsive(run) else spikes_in(run.responses)[0]
        for column, channel in enumerate(record.channels):
            if levels[column] > DEAD * np.median(levels):
                where = f"{run.name}: {channel}"
                of_channel = [*_of_converter(run.responses[:, column], where, channel.name)]
                of_channel += _stuck(run.responses, column, where, channel.name, record.sampling_rate)
                # The corners of clipped, held and stuck values would be taken for spikes.
                if not of_channel and (count := int(spikes[:, column].sum())):
                    numbers = {"channel": channel.name, "samples": count}
                    first = int(np.argmax(spikes[:, column])) + 1
                    said = finding("spikes", numbers, where=where, spikes=counted(count, "spike"), first=first)
                    of_channel.append(said)
                found += of_channel
        if run.excitation is not None:
            found += _of_converter(run.excitation, f"{run.name}: input channel", "input")
    return found


def without_sick(record: AnyRecord, findings: list[Finding]) -> AnyRecord:
    """Leave out the channels that measure nothing.

    Raises
    ------
    InputError
        No channel is left.
    """
    dead = {finding.numbers["channel"] for finding in findings if finding.kind in LEFT_OUT and finding.numbers["out"]}
    if not dead:
        return record
    kept = [column for column, channel in enumerate(record.channels) if channel.name not in dead]
    if not kept:
        raise InputError(f"every channel is dead: {', '.join(sorted(dead))}")
    return only(record, kept)


def without_spikes(record: TimeRecord, findings: list[Finding]) -> TimeRecord:
    """Replace each spike by what the samples on both sides of it say."""
    hit = {finding.numbers["channel"] for finding in findings if finding.kind == "spikes"}
    columns = [column for column, channel in enumerate(record.channels) if channel.name in hit]
    if not columns:
        return record
    runs = []
    for run in record.runs:
        responses = run.responses.copy()
        if not impulsive(run):
            responses[:, columns] = spikes_in(run.responses)[1][:, columns]
        runs.append(dataclasses.replace(run, responses=responses))
    return dataclasses.replace(record, runs=tuple(runs))


def spikes_in(responses: Floats) -> tuple[Bools, Floats]:
    """Find samples that differ from their neighbors in one channel alone, and the responses without them.

    With the coefficients a of an autoregressive model, the difference of a sample from what all others make of it is
    (a * reversed a * x) / (a'a): white where the model holds, and largest at the sample itself.
    """
    cleaned, found = np.array(responses), np.zeros(responses.shape, dtype=bool)
    # One spike throws the errors around it off: the largest in reach is taken first, and those beside it after.
    for _ in range(SPIKE_PASSES):
        off, scale = np.zeros(responses.shape), np.full(responses.shape, np.inf)
        for column, values in enumerate(cleaned.T):
            if values.std() > 0:
                off[:, column] = _interpolation_errors(values - values.mean())
                scale[:, column] = _local_scale(off[:, column])
        # Under strong motion a model of the whole record has larger errors; a spike exceeds the local and the overall
        # errors.
        loud = np.sqrt(ndimage.uniform_filter1d((cleaned - cleaned.mean(axis=0)) ** 2, 2 * AR_ORDER + 1, axis=0))
        ratio = np.where(np.abs(off) > OUT_OF_MOTION * loud, np.abs(off) / scale, 0.0)
        near = ndimage.maximum_filter1d(ratio, 5, axis=0)
        now = (ratio > SPIKE_DEVIATIONS) & (ratio >= ndimage.maximum_filter1d(ratio, 2 * AR_ORDER + 1, axis=0))
        for hit in np.flatnonzero(now.any(axis=0)).tolist():
            others = np.delete(near, hit, axis=1)
            if others.shape[1]:
                now[:, hit] &= others.max(axis=1) < SPIKE_DEVIATIONS / 2
        for place, hit in np.argwhere(now).tolist():
            now[place, hit] = not _begins(cleaned, place, hit)
        if not now.any():
            break
        found |= now
        cleaned[now] -= off[now]
    return found, cleaned


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
    model = np.concatenate([[1.0], -linalg.solve_toeplitz(covariances[:-1], covariances[1:])])
    errors = np.convolve(values, np.convolve(model, model[::-1]), mode="same") / (model @ model)
    errors[:order] = errors[-order:] = 0.0
    return np.asarray(errors)


def _local_scale(errors: Floats) -> Floats:
    """Estimate the standard deviation of errors around each sample, from the medians of their sizes in blocks."""
    count = max(1, len(errors) // 200)
    parts = np.array_split(np.abs(errors), count)
    # The louder of a block and its neighbors: an onset is no spike.
    medians = ndimage.maximum_filter1d([np.median(part) / 0.6745 for part in parts], 3)
    lengths = np.array([len(part) for part in parts])
    scale = np.interp(np.arange(len(errors)), np.cumsum(lengths) - 0.5 * lengths, medians)
    return np.asarray(np.where(scale > 0, scale, np.inf))


def stuck_in(responses: Floats, column: int, rate: float) -> Bools:
    """Find the samples of one channel that repeat one value for long while the other channels move as elsewhere.

    Parameters
    ----------
    responses : ndarray, shape (samples, channels)
    column : int
        Of the channel.
    rate : float
        Hz.

    Returns
    -------
    ndarray of bool, shape (samples,)
    """
    values, found = responses[:, column], np.zeros(len(responses), dtype=bool)
    repeats = stretches(np.diff(values) == 0) + np.array([0, 1])
    long = repeats[np.diff(repeats, axis=1)[:, 0] >= max(20, int(STUCK * rate))]
    others = np.delete(responses, column, axis=1)
    if not len(long) or not others.shape[1]:
        return found
    usual = others.std(axis=0)
    for start, stop in long.tolist():
        moved = np.median(others[start:stop].std(axis=0) / np.maximum(usual, 1e-300)) > 0.3
        # Where all is quiet, converters of few bits repeat themselves; the others then do as well.
        if moved or np.median(np.mean(np.diff(others[start:stop], axis=0) == 0, axis=0)) < 0.2:
            found[start:stop] = True
    return found


def _stuck(responses: Floats, column: int, where: str, name: str, rate: float) -> Iterator[Finding]:
    stuck = stuck_in(responses, column, rate)
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


def _of_converter(values: Floats, where: str, name: str) -> Iterator[Finding]:
    """Find samples cut off at the extreme value, and samples repeated at a fixed pace by a channel of a lower rate."""
    levels, times = np.unique(values, return_counts=True)
    for extreme, beside in ((-1, -2), (0, 1)) if len(levels) > 1 else ():
        level, count = levels[extreme], int(times[extreme])
        far = abs(level - np.median(values)) > values.std()
        if far and CLIPPED * (1 + times[beside]) <= count < 0.5 * len(values):
            numbers = {"channel": name, "level": float(level), "samples": count, "share": count / len(values)}
            first = int(np.argmax(values == level)) + 1
            yield finding("clipped channel", numbers, where=where, length=len(values), first=first)
            break
    same = np.diff(values) == 0
    for pace in (2, 3, 4, 5):
        repeats = [np.mean(same[phase::pace]) for phase in range(pace)]
        if sum(share > 0.95 for share in repeats) == pace - 1 and min(repeats) < 0.5:
            yield finding("held samples", {"channel": name, "repeats": pace}, where=where)
            return
