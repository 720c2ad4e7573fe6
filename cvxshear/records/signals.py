"""Preparation of the samples of a record: trend, decimation, clocks."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import scipy

from cvxshear.records.record import Channel, FrfRecord, Run, TimeRecord
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

AnyRecord = TypeVar("AnyRecord", bound=TimeRecord | FrfRecord)

IMPULSIVE = 0.1
"""A force that does nearly all its work within this share of the run is a blow."""
FORCE_SEEN = 0.02
"""Fraction of a force's peak. Smaller values are noise of the hammer's sensor; over a long run its energy equals the
blow's."""


def impulsive(run: Run) -> bool:
    """Whether the run's force is a blow: 90 % of its energy within a tenth of the run, offset and noise left out."""
    if run.excitation is None:
        return False
    # A blow does not move the median, which is the sensor's offset then.
    force = np.abs(run.excitation - np.median(run.excitation))
    power = np.sort(np.where(force > FORCE_SEEN * force.max(), force, 0.0) ** 2)[::-1]
    return bool(np.searchsorted(np.cumsum(power), 0.9 * power.sum()) < IMPULSIVE * len(power))


def struck(record: TimeRecord) -> bool:
    """Whether the record is one of blows: most of its runs, one among them may have missed its blow."""
    return record.input == "force" and 2 * sum(map(impulsive, record.runs)) > len(record.runs)


def detrended(record: TimeRecord) -> TimeRecord:
    """Remove mean and straight-line drift."""
    return _mapped(record, lambda values: scipy.signal.detrend(values, axis=0), record.sampling_rate)


def decimated(record: TimeRecord) -> TimeRecord:
    """Decimate to the lowest whole fraction of the sampling rate that keeps the band clear of the filter's edge."""
    if record.band is None:
        return record
    factor = int(record.sampling_rate / (2.5 * record.band[1]))
    if factor < 2:
        return record
    if min(run.samples for run in record.runs) < 40 * factor:
        raise InputError(f"the record is too short to be decimated to its band up to {record.band[1]:g} Hz; widen it")
    return _mapped(
        record, lambda values: scipy.signal.decimate(values, factor, ftype="fir", axis=0), record.sampling_rate / factor
    )


def without_offset(record: TimeRecord) -> TimeRecord:
    """Remove the median, which a blow does not move; a decay must not lose its slow part to a fitted line."""
    return _mapped(record, lambda values: values - np.median(values, axis=0), record.sampling_rate)


def scaled(record: AnyRecord, factors: Mapping[str, float]) -> AnyRecord:
    """Multiply channels, and "input", by factors; a channel that is not named stays."""
    factor = np.array([factors.get(channel.name, 1.0) for channel in record.channels])
    changed = with_responses(record, [run.responses * factor for run in record.runs])
    if "input" not in factors or not isinstance(changed, TimeRecord):
        return changed
    runs: Any = tuple(
        dataclasses.replace(run, excitation=None if run.excitation is None else run.excitation * factors["input"])
        for run in changed.runs
    )
    return dataclasses.replace(changed, runs=runs)


def only(record: AnyRecord, columns: Sequence[int]) -> AnyRecord:
    """Select some of a record's channels."""
    kept = list(columns)
    channels = tuple(record.channels[column] for column in kept)
    return with_responses(record, [run.responses[:, kept] for run in record.runs], channels)


def with_responses(
    record: AnyRecord, responses: Sequence[Any], channels: tuple[Channel, ...] | None = None
) -> AnyRecord:
    """Put other responses into the record's runs, and other channels."""
    changes: dict[str, Any] = {"channels": record.channels if channels is None else channels}
    each: Any = zip(record.runs, responses, strict=True)
    changes["runs"] = tuple(dataclasses.replace(run, responses=values) for run, values in each)
    return dataclasses.replace(record, **changes)


def _mapped(record: TimeRecord, change: Callable[[Floats], Floats], rate: float) -> TimeRecord:
    runs = []
    for run in record.runs:
        excitation = None if run.excitation is None else change(run.excitation[:, None])[:, 0]
        runs.append(dataclasses.replace(run, responses=change(run.responses), excitation=excitation))
    return dataclasses.replace(record, runs=tuple(runs), sampling_rate=rate)


SINC_TERMS = 48
"""Samples of the interpolation; a windowed sinc of this length is flat to 0.9 of half the rate."""


def in_step(record: AnyRecord, late: Mapping[str, tuple[float, float]]) -> AnyRecord:
    """Set clocks right that are late, and run slow.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    late : mapping
        Channel name, and "input", to (seconds at the start of the record, seconds more in each second after). Frequency
        response functions are turned by the seconds at the start.

    Returns
    -------
    TimeRecord or FrfRecord
        Runs in time without the ends for which some channel has no samples.
    """
    if isinstance(record, FrfRecord):
        seconds = np.array([late.get(channel.name, (0.0, 0.0))[0] for channel in record.channels])
        seconds = seconds - late.get("input", (0.0, 0.0))[0]
        turn = np.exp(2j * np.pi * record.frequencies[:, None] * seconds)
        return with_responses(record, [run.responses * turn for run in record.runs])
    rate, started, runs = record.sampling_rate, 0, []
    for run in record.runs:
        index = np.arange(run.samples)
        moved = {name: rate * (a + b * (started + index) / rate) for name, (a, b) in late.items()}
        edge = int(np.ceil(max(float(np.abs(each).max()) for each in moved.values()))) + SINC_TERMS // 2
        inner = slice(edge, run.samples - edge)
        responses = run.responses[inner].copy()
        for column, channel in enumerate(record.channels):
            if channel.name in moved:
                responses[:, column] = between(run.responses[:, column], (index + moved[channel.name])[inner])
        excitation = run.excitation
        if excitation is not None:
            place = index + moved["input"] if "input" in moved else None
            excitation = excitation[inner] if place is None else between(excitation, place[inner])
        runs.append(dataclasses.replace(run, responses=responses, excitation=excitation))
        started += run.samples
    return dataclasses.replace(record, runs=tuple(runs))


def between(values: Floats, places: Floats) -> Floats:
    """Values at places between the samples, by a windowed sinc."""
    whole = np.floor(places).astype(np.int64)
    offset = np.arange(1 - SINC_TERMS // 2, SINC_TERMS // 2 + 1)
    distance = (places - whole)[:, None] - offset[None, :]
    weight = np.sinc(distance) * np.cos(np.pi * distance / (SINC_TERMS + 2)) ** 2
    near = np.clip(whole[:, None] + offset[None, :], 0, len(values) - 1)
    return np.asarray(np.einsum("kj,kj->k", values[near], weight))
