"""Records whose clocks have been set right."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from cvxshear.modal.record import FrfRecord, Record, TimeRecord
from cvxshear.modal.runs import FrfRun, Run
from cvxshear.util.typing import Floats


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
