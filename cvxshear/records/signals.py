"""What is done to the samples of a record before anything is made of them: trend off, decimated, clocks right."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from scipy import signal

from cvxshear.records.record import Channel, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

AnyRecord = TypeVar("AnyRecord", bound=TimeRecord | FrfRecord)

IMPULSIVE = 0.1
"""A force that does nearly all its work within this share of the run is a blow."""


def impulsive(run: Run) -> bool:
    """Whether the run's force is a blow: 90 % of its energy within a tenth of the run."""
    if run.excitation is None:
        return False
    power = np.sort(run.excitation**2)[::-1]
    return bool(np.searchsorted(np.cumsum(power), 0.9 * power.sum()) < IMPULSIVE * len(power))


def detrended(record: TimeRecord) -> TimeRecord:
    """The record without mean and straight-line drift."""
    return _mapped(record, lambda values: signal.detrend(values, axis=0), record.sampling_rate)


def decimated(record: TimeRecord) -> TimeRecord:
    """The record at the lowest whole fraction of its sampling rate that keeps its band clear of the filter's edge."""
    if record.band is None:
        return record
    factor = int(record.sampling_rate / (2.5 * record.band[1]))
    if factor < 2:
        return record
    if min(run.samples for run in record.runs) < 40 * factor:
        raise InputError(f"the record is too short to be decimated to its band up to {record.band[1]:g} Hz; widen it")
    return _mapped(
        record,
        lambda values: signal.decimate(values, factor, ftype="fir", axis=0),
        record.sampling_rate / factor,
    )


def without_offset(record: TimeRecord) -> TimeRecord:
    """A decay must not lose its slow part to a fitted line: only the median goes, which a blow does not move."""
    return _mapped(record, lambda values: values - np.median(values, axis=0), record.sampling_rate)


def scaled(record: AnyRecord, factors: Mapping[str, float]) -> AnyRecord:
    """The record with channels, and "input", multiplied by factors; a channel that is not named stays."""
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
    """The record with these of its channels."""
    kept = list(columns)
    channels = tuple(record.channels[column] for column in kept)
    return with_responses(record, [run.responses[:, kept] for run in record.runs], channels)


def with_responses(
    record: AnyRecord, responses: Sequence[Any], channels: tuple[Channel, ...] | None = None
) -> AnyRecord:
    """The record with other responses in its runs, and other channels."""
    changes: dict[str, Any] = {"channels": record.channels if channels is None else channels}
    each: Any = zip(record.runs, responses, strict=True)
    changes["runs"] = tuple(dataclasses.replace(run, responses=values) for run, values in each)
    return dataclasses.replace(record, **changes)


def _mapped(record: TimeRecord, change: Callable[[Floats], Floats], rate: float) -> TimeRecord:
    runs = tuple(
        dataclasses.replace(
            run,
            responses=change(run.responses),
            excitation=None if run.excitation is None else change(run.excitation[:, None])[:, 0],
        )
        for run in record.runs
    )
    return dataclasses.replace(record, runs=runs, sampling_rate=rate)


def shifted(record: Record, offsets: Mapping[str, tuple[float, float]]) -> Record:
    """The record with each channel advanced by its clock offset.

    Time histories are turned in the frequency domain, which moves a band-limited signal by any fraction of a
    sample; the ends, where the record wraps round, are dropped.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    offsets : mapping
        Channel name, and "input", to (seconds, std); seconds positive where the channel is late. A clock that
        is not named stays.

    Returns
    -------
    TimeRecord or FrfRecord
    """
    late = np.array([offsets.get(channel.name, (0.0, 0.0))[0] for channel in record.channels])
    of_input = offsets.get("input", (0.0, 0.0))[0]
    if isinstance(record, FrfRecord):
        turn = np.exp(2j * np.pi * record.frequencies[:, None] * (late - of_input)[None, :])
        frf_runs = tuple(FrfRun(run.responses * turn, run.floor, run.name) for run in record.runs)
        return dataclasses.replace(record, runs=frf_runs)
    runs = tuple(_shifted_run(run, late, of_input, record) for run in record.runs)
    return dataclasses.replace(record, runs=runs)


def _shifted_run(run: Run, late: Floats, of_input: float, record: TimeRecord) -> Run:
    rate = record.sampling_rate
    edge = int(np.ceil(rate * max(np.abs(late).max(), abs(of_input)))) + 8
    responses = _advanced(run.responses, late, rate)[edge:-edge]
    excitation = run.excitation
    if excitation is not None:
        excitation = _advanced(excitation[:, None], np.array([of_input]), rate)[edge:-edge, 0]
    return dataclasses.replace(run, responses=responses, excitation=excitation)


def _advanced(values: Floats, seconds: Floats, rate: float) -> Floats:
    # A straight line through the ends is taken off first: the jump where the record wraps would ring.
    line = np.linspace(values[0], values[-1], len(values))
    spectrum = np.fft.rfft(values - line, axis=0)
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)
    turned = spectrum * np.exp(2j * np.pi * frequencies[:, None] * seconds[None, :])
    slope = (values[-1] - values[0]) / (len(values) - 1)
    return np.asarray(np.fft.irfft(turned, n=len(values), axis=0) + line + slope * rate * seconds)


SINC_TERMS = 48
"""Samples that a value between two samples is made of; a windowed sinc of so many is flat to 0.9 of half the rate."""


def in_step(record: TimeRecord, late: Mapping[str, tuple[float, float]]) -> TimeRecord:
    """The record with clocks that are late, and run slow, set right.

    Parameters
    ----------
    record : TimeRecord
    late : mapping
        Channel name, and "input", to (seconds at the start of the record, seconds more in each second after).

    Returns
    -------
    TimeRecord
        Its runs without the ends for which some channel has no samples.
    """
    if not any(drift for _, drift in late.values()):
        return shifted(record, {name: (seconds, 0.0) for name, (seconds, _) in late.items()})  # type: ignore[return-value]
    rate, started, runs = record.sampling_rate, 0, []
    for run in record.runs:
        index = np.arange(run.samples)
        moved = {name: rate * (a + b * (started + index) / rate) for name, (a, b) in late.items()}
        edge = int(np.ceil(max(float(np.abs(each).max()) for each in moved.values()))) + SINC_TERMS // 2
        inner = slice(edge, run.samples - edge)
        responses = run.responses[inner].copy()
        for column, channel in enumerate(record.channels):
            if channel.name in moved:
                responses[:, column] = _between(run.responses[:, column], (index + moved[channel.name])[inner])
        excitation = run.excitation
        if excitation is not None:
            place = index + moved["input"] if "input" in moved else None
            excitation = excitation[inner] if place is None else _between(excitation, place[inner])
        runs.append(dataclasses.replace(run, responses=responses, excitation=excitation))
        started += run.samples
    return dataclasses.replace(record, runs=tuple(runs))


def _between(values: Floats, places: Floats) -> Floats:
    """Values at places between the samples, by a windowed sinc."""
    whole = np.floor(places).astype(np.int64)
    offset = np.arange(1 - SINC_TERMS // 2, SINC_TERMS // 2 + 1)
    distance = (places - whole)[:, None] - offset[None, :]
    weight = np.sinc(distance) * np.cos(np.pi * distance / (SINC_TERMS + 2)) ** 2
    near = np.clip(whole[:, None] + offset[None, :], 0, len(values) - 1)
    return np.asarray(np.einsum("kj,kj->k", values[near], weight))
