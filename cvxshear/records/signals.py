"""What is done to the samples of a record before anything is made of them: trend off, decimated, clocks right."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from scipy import signal

from cvxshear.records.record import FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

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


def _mapped(record: TimeRecord, change: Callable[[Floats], Floats], rate: float) -> TimeRecord:
    runs = tuple(
        Run(
            change(run.responses),
            None if run.excitation is None else change(run.excitation[:, None])[:, 0],
            run.floor,
            run.name,
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
    return Run(responses, excitation, run.floor, run.name)


def _advanced(values: Floats, seconds: Floats, rate: float) -> Floats:
    # A straight line through the ends is taken off first: the jump where the record wraps would ring.
    line = np.linspace(values[0], values[-1], len(values))
    spectrum = np.fft.rfft(values - line, axis=0)
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)
    turned = spectrum * np.exp(2j * np.pi * frequencies[:, None] * seconds[None, :])
    slope = (values[-1] - values[0]) / (len(values) - 1)
    return np.asarray(np.fft.irfft(turned, n=len(values), axis=0) + line + slope * rate * seconds)
