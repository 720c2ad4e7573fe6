"""Functions of frequency from a record, and their coherence.

Driven records have frequency response functions, H1 with the spectra averaged over hits or over Welch's segments;
ambient ones have half-spectra, the transforms of the covariances at positive lags, which are sums of the same
poles (Peeters and Van der Auweraer 2005).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy

from cvxshear.records.frf import Spectra, hit_spectra, table_spectra
from cvxshear.records.prepare import detrended, struck, without_offset
from cvxshear.records.record import FrfRecord, Record, TimeRecord
from cvxshear.util.typing import Complexes, Floats, Ints

LINES = 512
"""Lines of a continuous record over the range that is shown: fine enough to see, averaged as often as that allows."""
FEWEST_SEGMENTS = 8
"""Of a continuous record; with fewer averages its coherence says nothing."""
LAG_WINDOW = 0.01
"""Value of the exponential window on covariances at the last lag; the window reduces noise."""


@dataclass(frozen=True, eq=False)
class Functions:
    """Functions of frequency that a record shows.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, above zero.
    values : array of complex, shape (lines, outputs, inputs)
        Response over force or over base acceleration; half-spectra against the reference floors where no input was
        measured.
    floors : array of int, shape (outputs,)
    inputs : array of int, shape (inputs,)
        Floor of each force, 0 the ground; for half-spectra the reference floors.
    driven : bool
        Whether an input was measured.
    coherence : array, shape (lines, outputs, inputs), or None
        Coherence of each response with the input or, without a measured input, with the reference; None without
        averages.
    quantity : str
        What the responses are.
    decay : float
        What an exponential window added to the decay rate of every pole in these functions, 1/s.
    """

    frequencies: Floats
    values: Complexes
    floors: Ints
    inputs: Ints
    driven: bool
    coherence: Floats | None
    quantity: str
    decay: float = 0.0

    def up_to(self, highest: float) -> Functions:
        """Leave out the lines above a frequency, Hz."""
        kept = self.frequencies <= highest
        coherence = None if self.coherence is None else self.coherence[kept]
        return dataclasses.replace(
            self, frequencies=self.frequencies[kept], values=self.values[kept], coherence=coherence
        )

    @property
    def indicator(self) -> Floats:
        """Complex mode indicator function, shape (lines, min(outputs, inputs)): the singular values at each line.

        Shih, Tsuei, Allemang and Brown 1988. For half-spectra the singular values of their Hermitian part stand
        for those of the spectra (Brincker, Zhang and Andersen 2001).
        """
        return np.asarray(np.linalg.svd(self.values, compute_uv=False))


def measured_functions(record: Record, highest: float) -> Functions:
    """Estimate the functions of frequency that a record shows.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    highest : float
        Hz; lines above it are left out.

    Returns
    -------
    Functions
    """
    rate = record.sampling_rate
    if isinstance(record, FrfRecord):
        spectra, _ = table_spectra(record)
        lines = record.step * np.arange(len(spectra[0].force_force), dtype=np.float64)
        found = _of_spectra(record, spectra, lines, averaged=False)
    elif struck(record):
        spectra, samples = hit_spectra(without_offset(record))
        several = min(np.unique([item.floor for item in spectra], return_counts=True)[1]) > 1
        found = _of_spectra(record, spectra, _lines(samples, rate), averaged=several)
    elif record.input in ("force", "base"):
        record, segment = detrended(record), _segment(record, highest)
        spectra = []
        for run in record.runs:
            assert run.excitation is not None
            cross, power = welch(np.column_stack([run.excitation, run.responses]), 0, rate, segment)
            spectra.append(Spectra(cross[:, 1:], power[:, 0], power[:, 1:], run.floor))
        found = _of_spectra(record, spectra, _lines(segment, rate), averaged=True)
    else:
        found = _of_undriven(detrended(record), _segment(record, highest))
    return found.up_to(highest)


def _of_spectra(record: Record, spectra: list[Spectra], lines: Floats, *, averaged: bool) -> Functions:
    """Functions of a driven record, summed over what was recorded at each driving floor."""
    floors = np.unique([item.floor for item in spectra]).astype(np.int64)
    values, coherence = [], []
    for floor in floors:
        hits = [item for item in spectra if item.floor == floor]
        cross = np.sum([hit.response_force for hit in hits], axis=0)
        force = np.sum([hit.force_force for hit in hits], axis=0)[:, None]
        response = np.sum([hit.response_response for hit in hits], axis=0)
        values.append(cross / force)
        coherence.append(_ratio(np.abs(cross) ** 2, force * response))
    functions, seen = np.stack(values, axis=2)[1:], np.stack(coherence, axis=2)[1:] if averaged else None
    decay = 0.0 if record.exponential_window is None else 1.0 / record.exponential_window
    return Functions(lines[1:], functions, record.floors, floors, True, seen, record.quantity, decay)


def _of_undriven(record: TimeRecord, segment: int) -> Functions:
    """Half-spectra and coherence against the highest floor."""
    reference = len(record.channels) - 1
    spectra = [welch(run.responses, reference, record.sampling_rate, segment) for run in record.runs]
    cross, power = (np.sum([item[part] for item in spectra], axis=0) for part in (0, 1))
    lags = np.fft.irfft(cross, axis=0)[: segment // 2]
    # Positive lags alone, the sharp cut at the end softened; the zero lag counts half.
    lags[0] *= 0.5
    decay = -np.log(LAG_WINDOW) / len(lags)
    window = np.exp(-decay * np.arange(len(lags)))
    halves = np.fft.rfft(lags * window[:, None], n=segment, axis=0)
    coherence = _ratio(np.abs(cross) ** 2, power[:, [reference]] * power)
    coherence[:, reference] = np.nan
    lines, functions, seen = _lines(segment, record.sampling_rate)[1:], halves[1:, :, None], coherence[1:, :, None]
    against, a_second = record.floors[[reference]], float(decay * record.sampling_rate)
    return Functions(lines, functions, record.floors, against, False, seen, record.quantity, a_second)


def _lines(samples: int, rate: float) -> Floats:
    return rate / samples * np.arange(samples // 2 + 1, dtype=np.float64)


def _segment(record: TimeRecord, highest: float) -> int:
    """Choose an even number of samples for each segment, small enough for several segments in the runs."""
    samples = min(run.samples for run in record.runs)
    wanted = LINES * record.sampling_rate / min(highest, record.sampling_rate / 2)
    return max(64, int(min(wanted, 2 * samples / FEWEST_SEGMENTS))) // 2 * 2


def welch(columns: Floats, reference: int, rate: float, segment: int) -> tuple[Complexes, Floats]:
    """Cross-spectra of all columns with one, and their own spectra, each of shape (lines, columns)."""
    part = min(segment, len(columns))
    _, cross = scipy.signal.csd(columns[:, [reference]], columns, rate, nperseg=part, nfft=segment, axis=0)
    _, power = scipy.signal.welch(columns, rate, nperseg=part, nfft=segment, axis=0)
    return np.asarray(cross), np.asarray(power)


def _ratio(above: Floats, below: Floats) -> Floats:
    return np.asarray(np.divide(above, below, out=np.zeros_like(above), where=below > 0))
