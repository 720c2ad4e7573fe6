"""The record file: a small TOML text that says which column of which file is which floor, and what drove it.

Its tables are `[record]` (kind, input, file, sampling rate, ...), one `[[channel]]` for each column used
(column, floor, axis, sign, calibration) and, where there are several files, one `[[run]]` for each; docs/modal.md
has them all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.files.columns import LIMIT, Columns, sampling_rate_of
from cvxshear.files.formats import read_columns
from cvxshear.files.inputs import MEGABYTE, named_after
from cvxshear.files.record_tables import (
    ChannelDeclaration,
    added_mass_of,
    channels_of,
    driver_of,
    placed,
    runs_of,
    tables_of,
)
from cvxshear.files.toml import parse, read_text
from cvxshear.measurement.experiment import MOST_STORIES
from cvxshear.records.motion import Drive, Motion
from cvxshear.records.record import FEWEST_SAMPLES, INPUTS, Channel, Finding, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats
from cvxshear.util.writing import write_file

RECORD_KEYS = (
    "name", "kind", "input", "input_floor", "file", "sampling_rate", "time", "time_unit", "frequency", "axis",
    "stories", "quantity", "band", "exponential_window", "truncated", "pick", "size_limit",
)  # fmt: skip
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
"""Units of a time column, s."""

LONG_STEP = 1.75
"""Times the usual step: a longer one has lost a sample at least, whatever the stamps are rounded to."""

MOST_GAPS = 0.01
"""Share of the steps: where more are too long it is no gap but another sampling rate, which is refused."""

LEAST_USED = 0.5
"""Share of the samples that sound pieces must hold: a record that has lost more is for a person to look at."""

HEADER = re.compile(r"^[ \t]*\[record\][ \t]*(#.*)?\n", re.MULTILINE)
NEXT_TABLE = re.compile(r"^[ \t]*\[+\w", re.MULTILINE)
PICK = re.compile(r"^[ \t]*pick[ \t]*=[ \t]*\[[^\]]*\]", re.MULTILINE)
"""Where the table of the record begins and the next one, and what stands in it of poles picked by hand."""

TIME_NAMES = ("time", "time_s", "t", "t_s", "Time", "TIME", "seconds")
FREQUENCY_NAMES = ("frequency", "frequency_hz", "freq", "f", "f_hz", "Frequency", "hz")


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A record, and what its file says of the frame besides.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    frame : dict
        The table `[frame]`, for the measurement file.
    priors : list of dict
        The tables `[[prior]]`, for the measurement file.
    added_mass : list of float, optional
        kg on each floor during the record.
    state : str, optional
        The state of the frame that was tested; records of one state share it.
    pick : list of float, optional
        Hz; frequencies of the modes, chosen by hand.
    files : tuple of Path
        The record file and those it names.
    notes : tuple of Finding
        What was left out of the files' samples.
    """

    record: Record
    frame: Mapping[str, object] = field(default_factory=dict)
    priors: Sequence[Mapping[str, object]] = ()
    added_mass: Sequence[float] | None = None
    state: str | None = None
    pick: Sequence[float] | None = None
    files: tuple[Path, ...] = ()
    notes: tuple[Finding, ...] = ()


def read_record(path: str | Path) -> RecordFile:
    """Read a record file and the files it names.

    Parameters
    ----------
    path : str or Path
        Of the TOML text; the files it names are looked for beside it.

    Returns
    -------
    RecordFile

    Raises
    ------
    InputError
        Naming the file, and the key or the channel and the line, and what would be right.
    """
    path = Path(path)
    table, lines = tables_of(path)
    where = str(path)
    frame = table.get("frame", {})
    priors = table.get("prior", [])
    tables = isinstance(priors, list) and all(isinstance(prior, Mapping) for prior in priors)
    if not isinstance(frame, Mapping) or not tables:
        raise InputError(f"{where}: frame must be a table [frame], prior a list of tables [[prior]]")
    added = added_mass_of(table, path)
    state = None if table.get("state") is None else checks.text(table["state"], f"{where}: state")
    notes: list[Finding] = []
    with placed(path):
        record = _record(table, path, lines, notes)
    files = (path, *(path.parent / run["file"] for run in runs_of(table, table["record"])))
    picked = table["record"].get("pick")
    if picked is not None:
        picked = checks.vector(picked, f"{where}: record: pick", above=0.0).tolist()
    return RecordFile(record, frame, priors, added, state, picked, files, tuple(notes))


def write_pick(path: str | Path, frequencies: Sequence[float]) -> None:
    """Write the frequencies of modes that were chosen by hand into a record file; all else in it stays.

    Parameters
    ----------
    path : str or Path
    frequencies : sequence of float
        Hz.

    Raises
    ------
    InputError
        Where the file has no table `[record]` under a header of its own, or cannot be written.
    """
    path = Path(path)
    text = read_text(path)
    line = f"pick = [{', '.join(f'{frequency:.5g}' for frequency in frequencies)}]"
    header = HEADER.search(text)
    if header is not None:
        end = NEXT_TABLE.search(text, header.end())
        body = text[header.end() : end.start() if end else len(text)]
        changed, count = PICK.subn(line, body, count=1)
        text = text[: header.end()] + (changed if count else f"{line}\n{body}") + (text[end.start() :] if end else "")
    table = parse(text, path).get("record")
    if header is None or not isinstance(table, dict) or len(table.get("pick", ())) != len(frequencies):
        raise InputError(f"{path} has no table [record] that a line could be written into; write there: {line}")
    write_file(path, text)


def _record(table: Mapping[str, Any], path: Path, lines: list[int], notes: list[Finding]) -> Record:
    declared = checks.keys(table["record"], RECORD_KEYS, [], "record")
    kind = checks.choice(declared.get("kind", "time"), ("time", "frf"), "record: kind")
    for key in ("time", "frequency", "axis"):
        if key in declared:
            checks.text(declared[key], f"record: {key}")
    channels = channels_of(table["channel"], declared, path, lines)
    common = {
        "stories": checks.whole(declared.get("stories", 0), "record: stories", least=0, most=MOST_STORIES),
        "quantity": declared.get("quantity", "acceleration"),
        "band": declared.get("band"),
        "exponential_window": declared.get("exponential_window"),
        "name": checks.text(declared.get("name", named_after(path)), "record: name"),
    }
    runs = runs_of(table, declared)
    if kind == "frf":
        return _frf_record(declared, channels, runs, common, path)
    return _time_record(declared, channels, runs, common, path, notes)


def _floor(run: Mapping[str, Any], declared: Mapping[str, Any], otherwise: int | None, place: int) -> int:
    """Where the force of a run acts."""
    floor = run.get("input_floor", declared.get("input_floor", otherwise))
    if floor is None:
        raise InputError(f"run {place}: the key 'input_floor' is missing: which floor does the force act on?")
    return checks.whole(floor, f"run {place}: input_floor", least=1, most=MOST_STORIES)


def columns_of(run: Mapping[str, Any], declared: Mapping[str, Any], path: Path) -> Columns:
    """Read the columns of a run's file."""
    limit = MEGABYTE * checks.number(declared.get("size_limit", LIMIT / MEGABYTE), "record: size_limit (MB)", above=0.0)
    return read_columns(path.parent / run["file"], limit)


def _time_record(
    declared: Mapping[str, Any],
    channels: list[ChannelDeclaration],
    runs: list[Mapping[str, Any]],
    common: Mapping[str, Any],
    path: Path,
    notes: list[Finding],
) -> TimeRecord:
    kind = checks.choice(declared.get("input", "none"), INPUTS, "record: input")
    driver = driver_of(channels, kind)
    responses = [item for item in channels if item is not driver and item.responds]
    quantities = {item.quantity for item in responses}
    if len(quantities) > 1:
        raise InputError(f"the responses are {' and '.join(sorted(quantities))}; a record holds one quantity")
    rates: list[tuple[float, str]] = []
    made = []
    needed = [*responses, *([] if driver is None else [driver])]
    for place, run in enumerate(runs, 1):
        columns = columns_of(run, declared, path)
        name = run.get("name", Path(run["file"]).name)
        floor = 0 if driver is None or kind != "force" else _floor(run, declared, driver.floor or None, place)
        pieces, rate, left_out = pieces_of(columns, needed, declared, run, path)
        rates.append((rate, columns.source))
        if left_out:
            notes.append(Finding("pieces", f"{name}: {left_out}", {"pieces": len(pieces)}))
        for number, rows in enumerate(pieces, 1):
            part = columns.rows(rows)
            excitation = None
            if driver is not None:
                excitation = driver.factor * part.column(driver.column, driver.place or path.name)
            called = name if len(pieces) == 1 else f"{name}, piece {number}"
            whole = rows == slice(0, len(columns.values))
            span = (None, None) if whole else (round(rows.start / rate, 9), round(rows.stop / rate, 9))
            made.append(Run(_table(part, responses, path), excitation, floor, called, *span))
    refuse_two_rates(rates)
    quantity = quantities.pop() if quantities else common["quantity"]
    return TimeRecord(
        _made(responses), **{**common, "quantity": quantity}, runs=tuple(made), sampling_rate=rates[0][0], input=kind
    )


def pieces_of(
    columns: Columns,
    needed: Sequence[ChannelDeclaration],
    declared: Mapping[str, Any],
    run: Mapping[str, Any],
    path: Path,
) -> tuple[list[slice], float, str]:
    """Find the longest stretches of a file without gaps, its sampling rate, and what was left out, in words.

    Parameters
    ----------
    columns : Columns
    needed : sequence of ChannelDeclaration
        Whose columns must hold numbers.
    declared, run : dict
        The tables [record] and [[run]]; of the latter, `start` and `end` in s since the first sample.
    path : Path
        The record file.

    Returns
    -------
    pieces : list of slice
        Of the rows, in their order; one where nothing is missing.
    rate : float
        Hz.
    left_out : str
        Empty where nothing was.

    Raises
    ------
    InputError
        Where most of the samples would be left out, or none is between `start` and `end`.
    """
    for item in needed:
        columns.check(item.column, item.place or path.name)
    name = time_column_of(declared, columns)
    sound: Bools = np.all(np.isfinite(columns.values[:, [columns.names.index(item.column) for item in needed]]), axis=1)
    # A break stands before each row that does not follow the one before.
    breaks = np.zeros(len(columns.values), dtype=np.bool_)
    if name is None:
        rate = rate_of(declared, columns)
    else:
        time = columns.values[:, columns.names.index(name)]
        sound &= np.isfinite(time)
        steps = np.diff(time[sound])
        jumps = np.flatnonzero(steps > LONG_STEP * np.median(steps)) if steps.size else np.zeros(0, dtype=int)
        if 0 < jumps.size <= MOST_GAPS * len(time) and np.all(steps > 0):
            breaks[np.flatnonzero(sound)[jumps + 1]] = True
    first, last = _asked(columns, name, declared, run)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], sound, [False]]).astype(int)) != 0)
    stretches = [slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    pieces = []
    for stretch in stretches:
        cuts = [stretch.start, *(stretch.start + np.flatnonzero(breaks[stretch])).tolist(), stretch.stop]
        pieces += [slice(max(a, first), min(b, last)) for a, b in pairwise(sorted(set(cuts)))]
    lengths = [max(0, each.stop - each.start) for each in pieces]
    longest = max(lengths, default=0)
    kept = [each for each, length in zip(pieces, lengths, strict=True) if length >= max(FEWEST_SAMPLES, longest / 4)]
    wanted, used = last - first, sum(each.stop - each.start for each in kept)
    if used < LEAST_USED * wanted or (not kept and longest == wanted):
        # Whatever is wrong with the whole is said by those who read it.
        kept = [slice(first, last)]
        for item in needed:
            columns.rows(kept[0]).column(item.column, item.place or path.name)
    if name is not None:
        rate = rate_of(declared, columns.rows(max(kept, key=lambda each: each.stop - each.start)))
    if len(kept) == 1 and kept[0] == slice(first, last):
        return kept, rate, ""
    told = ", ".join(f"{each.start / rate:.4g} to {each.stop / rate:.4g} s" for each in kept)
    return kept, rate, (
        f"{wanted - used} of {wanted} samples are missing or stand between gaps; the longest sound pieces are used as "
        f"runs of their own: {told}"
    )  # fmt: skip


def _asked(columns: Columns, name: str | None, declared: Mapping[str, Any], run: Mapping[str, Any]) -> tuple[int, int]:
    """Return the rows from `start` to `end` of a run: the first, and the one after the last."""
    count = len(columns.values)
    if not {"start", "end"} & set(run):
        return 0, count
    if name is None:
        time = np.arange(count) / rate_of(declared, columns)
    else:
        time = seconds_of(declared, columns.values[:, columns.names.index(name)])
        time = np.maximum.accumulate(np.nan_to_num(time - time[np.isfinite(time)][0], nan=0.0))
    first, last = np.searchsorted(time, [run.get("start", 0.0), run.get("end", np.inf)])
    if last - first < FEWEST_SAMPLES:
        raise InputError(
            f"{columns.source} has {last - first} samples between start and end of the run; it lasts {time[-1]:.4g} s "
            f"from its first sample, and at least {FEWEST_SAMPLES} samples are needed"
        )
    return int(first), int(last)


def _made(responses: list[ChannelDeclaration]) -> tuple[Channel, ...]:
    return tuple(
        Channel(item.column, item.floor, item.axis, item.place, item.unit, item.position, item.direction)
        for item in responses
    )


def _table(columns: Columns, responses: list[ChannelDeclaration], path: Path) -> Floats:
    if not responses:
        raise InputError("no channel is on a floor above the ground")
    return np.column_stack([item.factor * columns.column(item.column, item.place or path.name) for item in responses])


def rate_of(declared: Mapping[str, Any], columns: Columns) -> float:
    """Find the sampling rate, from the time column, from the declaration, or from both where they agree."""
    name = time_column_of(declared, columns)
    said = declared.get("sampling_rate")
    if said is not None:
        said = checks.number(said, "record: sampling_rate", above=0.0)
    if name is None:
        if said is None:
            raise InputError(
                f"record: give sampling_rate, in Hz, or time, the name of the time column of {columns.source}"
            )
        return said
    rate = sampling_rate_of(seconds_of(declared, columns.column(name, "record: time")), columns, name, said)
    if said is not None:
        if abs(rate - said) > 0.01 * said:
            raise InputError(
                f'record: sampling_rate = {said:g} Hz, but column "{name}" of {columns.source} ticks at {rate:.6g} Hz'
            )
        return said
    return rate


def time_column_of(declared: Mapping[str, Any], columns: Columns) -> str | None:
    """Find the name of the time column: that declared, or one of the usual names; None where there is none."""
    name = declared.get("time") or next((item for item in TIME_NAMES if item in columns.names), None)
    if name is not None:
        columns.check(name, "record: time")
    return name


def seconds_of(declared: Mapping[str, Any], time: Floats) -> Floats:
    """Return a time column in s."""
    unit = checks.choice(declared.get("time_unit", "s"), tuple(TIME_UNITS), "record: time_unit")
    return time * TIME_UNITS[unit]


def refuse_two_rates(rates: list[tuple[float, str]]) -> None:
    """Raise `InputError` where files of one record were sampled at different rates."""
    for rate, source in rates[1:]:
        if abs(rate - rates[0][0]) > 1e-3 * rates[0][0]:
            raise InputError(
                f"{source} is sampled at {rate:.6g} Hz, {rates[0][1]} at {rates[0][0]:.6g} Hz: two sampling rates in "
                "one record; resample one of them"
            )


def _frf_record(
    declared: Mapping[str, Any],
    channels: list[ChannelDeclaration],
    runs: list[Mapping[str, Any]],
    common: Mapping[str, Any],
    path: Path,
) -> FrfRecord:
    if declared.get("input", "force") != "force":
        raise InputError('record: frequency response functions have input = "force"')
    made, axes = [], []
    for place, run in enumerate(runs, 1):
        columns = columns_of(run, declared, path)
        name = declared.get("frequency") or next((item for item in FREQUENCY_NAMES if item in columns.names), None)
        if name is None:
            raise InputError(f"record: give frequency, the name of the frequency column of {columns.source}")
        axes.append((columns.column(name, "record: frequency"), columns.source))
        floor = _floor(run, declared, None, place)
        responses = np.column_stack([_complex(columns, item, path) for item in channels])
        made.append(FrfRun(responses, floor, run.get("name", Path(run["file"]).name)))
    for axis, source in axes[1:]:
        if axis.shape != axes[0][0].shape or not np.allclose(axis, axes[0][0], rtol=1e-6):
            raise InputError(f"{source} and {axes[0][1]} have different frequency lines; a record has one axis")
    return FrfRecord(
        _made(channels), **common, runs=tuple(made), frequencies=axes[0][0], truncated=declared.get("truncated")
    )


def _complex(columns: Columns, item: ChannelDeclaration, path: Path) -> Any:
    asked = item.place or path.name
    real, imaginary = f"{item.column}_re", f"{item.column}_im"
    return item.factor * (columns.column(real, asked) + 1j * columns.column(imaginary, asked))


def read_motion(path: str | Path) -> Motion:
    """Read what drove a frame from a record file, with the floors' accelerations where it names such channels.

    Parameters
    ----------
    path : str or Path
        As for `read_record`; here a channel of the ground, or of the force, is enough.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        As `read_record` does, and where nothing says what drove the frame.
    """
    path = Path(path)
    table, lines = tables_of(path)
    with placed(path):
        declared = checks.keys(table["record"], RECORD_KEYS, [], "record")
        channels = channels_of(table["channel"], declared, path, lines)
        driver = driver_of(channels, declared.get("input", "none"))
    if driver is None or declared.get("kind", "time") != "time" or any(item.responds for item in channels):
        found = read_record(path)
        return Motion.of(found.record, found.added_mass, found.state)
    with placed(path):
        drives, rates = [], []
        for run in runs_of(table, declared):
            columns = columns_of(run, declared, path)
            pieces, rate, _ = pieces_of(columns, [driver], declared, run, path)
            rates.append((rate, columns.source))
            longest = columns.rows(max(pieces, key=lambda each: each.stop - each.start))
            excitation = driver.factor * longest.column(driver.column, driver.place or path.name)
            floor = run.get("input_floor", declared.get("input_floor", driver.floor))
            drives.append(Drive(excitation, floor, name=run.get("name", Path(run["file"]).name)))
        refuse_two_rates(rates)
        name = checks.text(declared.get("name", path.stem), "record: name")
        added = added_mass_of(table, path)
        return Motion(
            tuple(drives), rates[0][0], declared["input"], added_mass=None if added is None else np.array(added),
            name=name, state=None if table.get("state") is None else checks.text(table["state"], "state"),
        )  # fmt: skip
