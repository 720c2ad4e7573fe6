"""Preparation of a record: trend, decimation, clocks, what a method needs, and functions of frequency for figures.

Driven records have frequency response functions, H1 with the spectra averaged over hits or over Welch's segments.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import scipy

from cvxshear.records import continuous, frf, pole_sweep
from cvxshear.records.record import Channel, Finding, FrfRecord, Record, Run, TimeRecord
from cvxshear.util import checks, quantities
from cvxshear.util.errors import InputError, UnsuitableError
from cvxshear.util.typing import Complexes, Floats, Ints

AnyRecord = TypeVar("AnyRecord", bound=TimeRecord | FrfRecord)

#: A force that does nearly all its work within this share of the run is a blow.
IMPULSIVE = 0.1
#: Fraction of a force's peak. Smaller values are noise of the hammer's sensor; over a long run its energy equals the
#: blow's.
FORCE_SEEN = 0.02


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


def without(record: AnyRecord, findings: Iterable[Finding]) -> AnyRecord:
    """Leave out the channels that findings say are out.

    Raises
    ------
    InputError
        No channel is left.
    """
    out = {item.numbers["channel"] for item in findings if item.numbers.get("out")}
    kept = [column for column, channel in enumerate(record.channels) if channel.name not in out]
    if not kept:
        raise InputError(f"every channel is dead: {', '.join(sorted(out))}")
    return only(record, kept) if out else record


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


#: Samples of the interpolation; a windowed sinc of this length is flat to 0.9 of half the rate.
SINC_TERMS = 48


def in_step(record: TimeRecord, late: Mapping[str, tuple[float, float]]) -> TimeRecord:
    """Set clocks right that are late, and run slow.

    Parameters
    ----------
    record : TimeRecord
    late : mapping
        Channel name, and "input", to (seconds at the start of the record, seconds more in each second after).

    Returns
    -------
    TimeRecord
        Runs without the ends for which some channel has no samples.
    """
    delays = np.array([late.get(name, (0.0, 0.0)) for name in (*(each.name for each in record.channels), "input")])
    started, runs = 0, []
    for run in record.runs:
        inputs = np.zeros((run.samples, 0)) if run.excitation is None else run.excitation[:, None]
        moved = on_time(np.hstack([run.responses, inputs]), delays, record.sampling_rate, started)
        responses, excitation = np.split(moved[np.isfinite(moved).all(axis=1)], [len(record.channels)], axis=1)
        driven = None if run.excitation is None else excitation[:, 0]
        runs.append(dataclasses.replace(run, responses=responses, excitation=driven))
        started += run.samples
    return dataclasses.replace(record, runs=tuple(runs))


def on_time(values: Floats, late: Floats, rate: float, started: int) -> Floats:
    """Remove the delay of each channel; a sample is nan if a sample that its interpolation needs is missing.

    Parameters
    ----------
    values : ndarray, shape (samples, channels)
        nan for missing samples.
    late : ndarray, shape (channels, 2)
        s at the start of the record, and s more in each second after.
    rate : float
        Sampling rate, Hz.
    started : int
        Samples of the record before these.
    """
    result, index = values.copy(), np.arange(len(values))
    for column, own in enumerate(values.T):
        there = np.isfinite(own)
        if late[column].any() and there.any():
            seconds, growth = late[column]
            places = index + rate * seconds + growth * (started + index)
            gaps = (~there).astype(np.uint8)
            unknown = scipy.ndimage.maximum_filter1d(gaps, SINC_TERMS + 1, mode="constant", cval=1)
            near = np.clip(np.round(places).astype(np.int64), 0, len(values) - 1)
            moved = between(np.interp(index, index[there], own[there]), places)
            result[:, column] = np.where(unknown[near].astype(bool), np.nan, moved)
    return result


def between(values: Floats, places: Floats) -> Floats:
    """Values at places between the samples, by a windowed sinc."""
    whole = np.floor(places).astype(np.int64)
    offset = np.arange(1 - SINC_TERMS // 2, SINC_TERMS // 2 + 1)
    distance = (places - whole)[:, None] - offset[None, :]
    weight = np.sinc(distance) * np.cos(np.pi * distance / (SINC_TERMS + 2)) ** 2
    near = np.clip(whole[:, None] + offset[None, :], 0, len(values) - 1)
    return np.asarray(np.einsum("kj,kj->k", values[near], weight))


MODAL_METHODS = ("era", "subspace", "ssi")
#: Pieces of a continuous record: Student's t of 19 degrees of freedom widens the deviations by 7 % only, and a piece
#: still holds many periods of the lowest mode.
BLOCKS = 20

#: Least time, s, between separate hits: a hammer that bounces comes back sooner.
APART = 0.5
#: Part of a run between its first and last hit that asks to part them: half of it would otherwise go unused.
LONGEST_PULSE = 0.25


def source_of(record: Record, method: str, *, blocks: int = BLOCKS) -> pole_sweep.Source:
    """Bring the record's data into the form the method needs.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    method : str
        "era", "subspace" or "ssi".
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
    suited = suited_methods(record)
    if method not in suited:
        kind = "frequency response functions" if isinstance(record, FrfRecord) else f'input = "{record.input}"'
        raise UnsuitableError(f'method "{method}" cannot use {kind}; use "{suited[0]}"')
    if isinstance(record, FrfRecord):
        highest = np.inf if record.band is None else 1.25 * record.band[1]
        spectra, samples = frf.table_spectra(record, highest)
        return frf.FrfSource(spectra, samples * record.step, samples, wrapped=not record.truncated)
    if method == "era":
        return _decays(record) if record.input == "free_decay" else _hits(record)
    record = decimated(detrended(record))
    if method == "ssi":
        after = 2 * continuous.SSI_ROWS
        pieces = [run.responses[start : stop + after] for run, start, stop in _cuts(record, blocks, 0, after)]
        return continuous.CovarianceSource(pieces, record.sampling_rate)
    return _driven(record, blocks)


def suited_methods(record: Record) -> tuple[str, ...]:
    """List the methods that can use the record's input, the one that suits it best first."""
    if isinstance(record, FrfRecord):
        return ("era",)
    if record.input == "force":
        return ("era", "subspace") if struck(record) else ("subspace", "era")
    return {"none": ("ssi",), "free_decay": ("era", "ssi"), "base": ("subspace",)}[record.input]


def _hits(record: TimeRecord) -> frf.FrfSource:
    record = without_offset(record)
    _refuse_several_hits(record)
    lowest, highest = (0.0, np.inf) if record.band is None else record.band
    record = decimated(dataclasses.replace(record, band=(lowest, min(highest, frf.reach(record)))))
    spectra, samples = frf.hit_spectra(record)
    return frf.FrfSource(spectra, record.sampling_rate, samples, samples // 2)


def _refuse_several_hits(record: TimeRecord) -> None:
    """Hits in one run act as one pulse as long as the time between them, which leaves little after it."""
    for run in record.runs:
        assert run.excitation is not None
        force = np.abs(run.excitation)
        loud = np.flatnonzero(force > 0.25 * force.max()) / record.sampling_rate
        times = loud[np.append(True, np.diff(loud) > APART)].tolist()
        if times and times[-1] - times[0] > LONGEST_PULSE * run.samples / record.sampling_rate:
            said = quantities.listed([f"{time:.4g}" for time in times])
            raise InputError(
                f"{run.name} holds {len(times)} hits, at {said} s: give each a "
                f"[[run]] of its own in the record file, with its start (a little before the hit), its end, the same "
                "file and its input_floor"
            )


def _decays(record: TimeRecord) -> frf.ImpulseSource:
    record = decimated(without_offset(record))
    starts = [_release(run.responses) for run in record.runs]
    samples = min(run.samples - start for run, start in zip(record.runs, starts, strict=True))
    decays = [run.responses[start : start + samples] for run, start in zip(record.runs, starts, strict=True)]
    impulse = pole_sweep.Impulse(np.stack(decays, axis=2), 0, np.zeros(len(decays), dtype=np.int64))
    return frf.ImpulseSource(impulse, record.sampling_rate)


def _release(responses: Floats) -> int:
    """Find the first sample of the decay: the last sample above nine tenths of the largest response."""
    size = np.linalg.norm(responses / np.maximum(responses.std(axis=0), 1e-300), axis=1)
    return int(np.flatnonzero(size > 0.9 * size.max())[-1])


def _driven(record: TimeRecord, blocks: int) -> pole_sweep.Source:
    rows = continuous.rows_for(record.most_modes, len(record.channels))
    before = 2 * rows - 1
    pieces = []
    for run, start, stop in _cuts(record, blocks, before, 0):
        assert run.excitation is not None
        pieces.append((run.excitation[start - before : stop, None], run.responses[start - before : stop]))
    return continuous.SubspaceSource(pieces, record.sampling_rate, _one_floor(record), rows)


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


#: Length, s, of the segments that spectra are averaged over: long beside the delay of a clock, short enough that a
#: record has many. Half and twice the length name the same faults (`python -m tests.studies record_faults --segment`).
SEGMENT = 20.0
#: Of a continuous record; with fewer averages its functions are mostly noise.
FEWEST_SEGMENTS = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Functions:
    """Functions of frequency that a record shows.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, above zero.
    values : array of complex, shape (lines, outputs, inputs)
        Response over force or over base acceleration.
    floors : array of int, shape (outputs,)
    inputs : array of int, shape (inputs,)
        Floor of each force, 0 the ground.
    quantity : str
        What the responses are.
    decay : float
        What an exponential window added to the decay rate of every pole in these functions, 1/s.
    """

    frequencies: Floats
    values: Complexes
    floors: Ints
    inputs: Ints
    quantity: str
    decay: float


def measured_functions(record: Record, highest: float) -> Functions | None:
    """Estimate the functions of frequency that a record shows; None where no input was measured.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    highest : float
        Hz; lines above it are left out.

    Returns
    -------
    Functions or None
    """
    rate = record.sampling_rate
    if isinstance(record, FrfRecord):
        spectra, _ = frf.table_spectra(record)
        lines = record.step * np.arange(len(spectra[0].force_force), dtype=np.float64)
    elif struck(record):
        spectra, samples = frf.hit_spectra(without_offset(record))
        lines = np.asarray(np.fft.rfftfreq(samples, 1.0 / rate), dtype=np.float64)
    elif record.input in ("force", "base"):
        lines, spectra = driven_spectra(record)
    else:
        return None
    floors = np.unique([item.floor for item in spectra]).astype(np.int64)
    values = []
    for floor in floors:
        hits = frf.Spectra.together([item for item in spectra if item.floor == floor])
        values.append(hits.response_force / hits.force_force[:, None])
    kept = (lines > 0) & (lines <= highest)
    whole = np.stack(values, axis=2)[kept]
    return Functions(lines[kept], whole, record.floors, floors, record.quantity, record.window_decay)


def driven_spectra(record: TimeRecord) -> tuple[Floats, list[frf.Spectra]]:
    """Average the spectra of each run over Welch's segments, a long run counting more; the lines, Hz, come first."""
    record, rate = detrended(record), record.sampling_rate
    shortest = min(run.samples for run in record.runs)
    segment = max(64, int(min(SEGMENT * rate, 2 * shortest / FEWEST_SEGMENTS))) // 2 * 2
    spectra = []
    for run in record.runs:
        assert run.excitation is not None
        columns = np.column_stack([run.excitation, run.responses])
        _, cross = scipy.signal.csd(columns[:, [0]], columns, rate, nperseg=segment, axis=0)
        _, power = scipy.signal.welch(columns, rate, nperseg=segment, axis=0)
        cross, power = run.samples * cross, run.samples * power
        spectra.append(frf.Spectra(cross[:, 1:], power[:, 0], power[:, 1:], run.floor))
    return np.asarray(np.fft.rfftfreq(segment, 1.0 / rate), dtype=np.float64), spectra
