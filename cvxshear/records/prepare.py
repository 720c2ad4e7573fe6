"""From a record to the source of its Hankel matrix: trend off, decimated to the band, cut into blocks."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from cvxshear.records import continuous
from cvxshear.records.frf import FrfSource, ImpulseSource, hit_spectra, hit_times, reach, table_spectra
from cvxshear.records.picking import Sweep
from cvxshear.records.realization import Impulse, Source
from cvxshear.records.record import FrfRecord, Record, Run, TimeRecord
from cvxshear.records.signals import decimated, detrended, struck, without_offset
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError, UnsuitableError
from cvxshear.util.quantities import listed
from cvxshear.util.typing import Floats, Ints

MODAL_METHODS = ("era", "okid", "subspace", "ssi")
BLOCKS = 20
"""Pieces of a continuous record: Student's t of 19 degrees of freedom widens the deviations by 7 % only, and a piece
still holds many periods of the lowest mode."""

LONGEST_PULSE = 0.25
"""Part of a run between its first and last hit that asks to part them: half of it would otherwise go unused."""


def default_method(record: Record) -> str:
    """Return the method that suits the record's input."""
    return _suited(record)[0]


def source_of(record: Record, method: str, *, blocks: int = BLOCKS) -> Source:
    """Bring the record's data into the form the method needs.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    method : str
        "era", "okid", "subspace" or "ssi".
    blocks : int, optional
        Pieces that a long record is cut into.

    Returns
    -------
    Source

    Raises
    ------
    UnsuitableError
        Where the method cannot use the record's input; names one that can.
    """
    checks.choice(method, MODAL_METHODS, "method")
    checks.whole(blocks, "blocks", least=4, most=200)
    suited = _suited(record)
    if method not in suited:
        kind = "frequency response functions" if isinstance(record, FrfRecord) else f'input = "{record.input}"'
        raise UnsuitableError(f'method "{method}" cannot use {kind}; use "{suited[0]}"')
    if isinstance(record, FrfRecord):
        highest = np.inf if record.band is None else 1.25 * record.band[1]
        spectra, samples = table_spectra(record, highest)
        return FrfSource(spectra, samples * record.step, samples, wrapped=not record.truncated)
    if method == "era":
        return _decays(record) if record.input == "free_decay" else _hits(record)
    record = decimated(detrended(record))
    if method == "ssi":
        after = 2 * continuous.SSI_ROWS
        pieces = [run.responses[start : stop + after] for run, start, stop in _cuts(record, blocks, 0, after)]
        return continuous.CovarianceSource(pieces, record.sampling_rate)
    return _driven(record, method, blocks)


def _suited(record: Record) -> tuple[str, ...]:
    """List the methods that can use the record's input, the one that suits it best first."""
    if isinstance(record, FrfRecord):
        return ("era",)
    if record.input == "force":
        return ("era", "subspace", "okid") if struck(record) else ("subspace", "okid", "era")
    return {"none": ("ssi",), "free_decay": ("era", "ssi"), "base": ("subspace", "okid")}[record.input]


def _hits(record: TimeRecord) -> FrfSource:
    record = without_offset(record)
    _refuse_several_hits(record)
    lowest, highest = (0.0, np.inf) if record.band is None else record.band
    record = decimated(dataclasses.replace(record, band=(lowest, min(highest, reach(record)))))
    spectra, samples = hit_spectra(record)
    return FrfSource(spectra, record.sampling_rate, samples, samples // 2)


def _refuse_several_hits(record: TimeRecord) -> None:
    """Hits in one run act as one pulse as long as the time between them, which leaves little after it."""
    for run in record.runs:
        times = hit_times(run, record.sampling_rate)
        if times[-1] - times[0] > LONGEST_PULSE * run.samples / record.sampling_rate:
            raise InputError(
                f"{run.name} holds {len(times)} hits, at {listed([f'{time:.4g}' for time in times])} s: give each a "
                f"[[run]] of its own in the record file, the first with start = {times[0]:.4g}, end = {times[1]:.4g}, "
                f"the last with start = {times[-1]:.4g}, each with the same file and its input_floor"
            )


def _decays(record: TimeRecord) -> ImpulseSource:
    record = decimated(without_offset(record))
    decays, _ = releases_of(record)
    impulse = Impulse(decays, 0, np.zeros(decays.shape[2], dtype=np.int64))
    return ImpulseSource(impulse, record.sampling_rate, releases=True)


def releases_of(record: TimeRecord) -> tuple[Floats, Ints]:
    """Cut the decay out of each run, shape (samples, channels, runs); the sample that it begins with comes second."""
    runs = without_offset(record).runs
    starts = np.array([_release(run.responses) for run in runs])
    samples = min(run.samples - start for run, start in zip(runs, starts, strict=True))
    pieces = [run.responses[start : start + samples] for run, start in zip(runs, starts, strict=True)]
    return np.stack(pieces, axis=2), starts


def _release(responses: Floats) -> int:
    """Find the first sample of the decay: the last sample above nine tenths of the largest response."""
    size = np.linalg.norm(responses / np.maximum(responses.std(axis=0), 1e-300), axis=1)
    return int(np.flatnonzero(size > 0.9 * size.max())[-1])


def _driven(record: TimeRecord, method: str, blocks: int) -> Source:
    samples = sum(run.samples for run in record.runs)
    lags = continuous.lags_for(record.stories, len(record.channels), samples)
    rows = continuous.rows_for(record.stories, len(record.channels))
    before = lags if method == "okid" else 2 * rows - 1
    pieces = []
    for run, start, stop in _cuts(record, blocks, before, 0):
        if run.excitation is None:
            raise InputError(f"{run.name} lacks the input channel")
        pieces.append((run.excitation[start - before : stop, None], run.responses[start - before : stop]))
    if method == "okid":
        return continuous.OkidSource(pieces, record.sampling_rate, _one_floor(record), lags)
    return continuous.SubspaceSource(pieces, record.sampling_rate, _one_floor(record), rows, lags)


def _one_floor(record: TimeRecord) -> int:
    """Return the floor that all runs are driven at; a regression takes one input."""
    floors = sorted({run.floor for run in record.runs})
    if len(floors) > 1:
        raise UnsuitableError(
            f"runs driven at floors {', '.join(map(str, floors))} cannot share one regression; hand in one record a "
            'floor, or blows, which method "era" takes together'
        )
    return floors[0]


def _cuts(record: TimeRecord, blocks: int, before: int, after: int) -> Iterator[tuple[Run, int, int]]:
    """Blocks of nearly equal length over all runs, each with room for the samples its lags need."""
    usable = [run.samples - before - after for run in record.runs]
    total = sum(max(0, count) for count in usable)
    if total < 4 * (before + after):
        raise InputError(
            f"the record has {sum(run.samples for run in record.runs)} samples at {record.sampling_rate:g} Hz; the "
            f"method needs at least {5 * (before + after)}"
        )
    for run, count in zip(record.runs, usable, strict=True):
        if count < 2:
            continue
        pieces = max(1, round(blocks * count / total))
        edges = (before + np.linspace(0, count, pieces + 1).astype(int)).tolist()
        for start, stop in itertools.pairwise(edges):
            yield run, start, stop


DECIMATION_FACTORS = (2, 4, 8, 16, 32, 64)
"""Steps of the sampling rate: at a factor of two the highest mode is met within LOWEST_SHARE and half the rate."""
LOWEST_SHARE = 0.1
"""Fraction of the sampling rate. With a lower highest mode, the rate is reduced."""

Attempt = Callable[..., tuple[Source, Sweep]]


def settled(record: Record, wanted: int, attempt: Attempt, highest: float = 0.0) -> tuple[Source, Sweep]:
    """Find the sampling rate that suits the modes, and source and sweep at it.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    wanted : int
        Number of modes that would be all.
    attempt : callable
        From a record to its source and sweep.
    highest : float, optional
        Hz that must stay in sight: the highest mode picked by hand.

    Returns
    -------
    source : Source
    sweep : Sweep
    """
    best = attempt(record)
    if record.band is not None or _suits(best, wanted):
        return best
    for factor in DECIMATION_FACTORS:
        band = (0.0, record.sampling_rate / (2.5 * factor))
        if band[1] < highest:
            break
        try:
            trial = attempt(dataclasses.replace(record, band=band))
        except (InputError, NoSolutionError):
            # The record is too short for a lower rate, or has no model there: keep the earlier result.
            break
        if len(trial[1].chosen) < len(best[1].chosen):
            break
        if len(trial[1].chosen) > len(best[1].chosen) or _too_low(best):
            best = trial
        if _suits(best, wanted):
            break
    return best


def _suits(found: tuple[Source, Sweep], wanted: int) -> bool:
    return len(found[1].chosen) == wanted and not _too_low(found)


def _too_low(found: tuple[Source, Sweep]) -> bool:
    source, sweep = found
    return not sweep.chosen or sweep.chosen[-1].frequency < LOWEST_SHARE * source.sampling_rate
