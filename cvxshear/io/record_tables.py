"""Record files: what they declare of a record and the frame, and the samples of the files that they name.

A record file is a small TOML text that assigns columns of files to floors and declares the excitation. Its tables are
`[record]` (kind, input, file, sampling rate, ...), one `[[channel]]` for each column used (column, floor, axis, sign,
calibration) and, where there are several files, one `[[run]]` for each; docs/modal.md has them all.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.io.csv import Columns
from cvxshear.io.formats import LIMIT, MEGABYTE, named_after, read_columns, refuse_data
from cvxshear.io.toml import built_in_text, is_built_in, parse, read_text
from cvxshear.records import record as kinds
from cvxshear.records.data_frames import FEWEST_SAMPLES, TIME_NAMES, TIME_UNITS, sampling_rate_of, sound_pieces
from cvxshear.records.motion import differentiated
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import CHANNEL_UNITS, counted
from cvxshear.util.typing import Bools, Floats

RECORD_KEYS = (
    "name", "kind", "input", "input_floor", "file", "sampling_rate", "time", "time_unit", "frequency", "axis",
    "stories", "quantity", "band", "exponential_window", "truncated", "pick", "size_limit",
)  # fmt: skip

FREQUENCY_NAMES = ("frequency", "frequency_hz", "freq", "f", "f_hz", "Frequency", "hz")
CHANNEL_KEYS = ("column", "floor", "axis", "sign", "calibration", "quantity", "unit", "position", "direction")
RUN_KEYS = ("file", "name", "input_floor", "start", "end")
TABLES = ("record", "channel", "run", "frame", "prior", "added_mass", "state")

#: Longest step without a gap, as a multiple of the usual step. A longer step lost a sample, for any rounding.
LONG_STEP = 1.75

#: Largest share of long steps that are gaps. More long steps are another sampling rate, which is refused.
MOST_GAPS = 0.01


@dataclass(frozen=True)
class ChannelDeclaration(kinds.Channel):
    """One channel as the record file declares it, named as its column.

    Parameters
    ----------
    factor : float, optional
        From the column to SI units, sign and calibration included.
    quantity : str, optional
        "force", or one of `RECORDED_QUANTITIES`.
    """

    factor: float = 1.0
    quantity: str = "acceleration"

    def read(self, columns: Columns) -> Floats:
        """Read the channel from the columns of a file, in SI units."""
        return self.factor * columns.column(self.name, self.place)


class RecordFile:
    """A record, and the declarations of its file about the frame; each key is checked separately.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    record : TimeRecord or FrfRecord
        Of a file that `read_record` read.
    notes : tuple of Finding
        Samples that were left out.
    declared : dict
        The table `[record]`.
    frame : dict
        The table `[frame]`, for the measurement file.
    priors : list of dict
        The tables `[[prior]]`, for the measurement file.
    pick : list of float or None
        Hz; frequencies of the modes, chosen by hand.
    files : tuple of Path
        The record file and those it names.
    kind : str
        "time" or "frf".
    input : str
        One of `INPUTS`.
    channels : list of ChannelDeclaration
    runs : list of dict
    name : str
    turns : bool
        Whether the floors turn (frame: motions).
    added_mass : list of float or None
        kg.
    state : str or None

    Raises
    ------
    InputError
    """

    record: kinds.Record
    notes: tuple[kinds.Finding, ...] = ()

    def __init__(self, path: Path) -> None:
        self.path = path
        refuse_data(path)
        text = built_in_text(str(path)) if is_built_in(str(path)) else read_text(path)
        found = parse(text, path)
        if "configuration" in found and "record" not in found:
            raise InputError(
                f"{path} is a measurement file (it has [[configuration]]), not a record file: its modes are found "
                f"already; 'cvxshear identify {path}' and 'cvxshear loop {path}' take it"
            )
        table = checks.keys(found, TABLES, ["record", "channel"], str(path))
        header = re.compile(r"^\s*\[\[\s*channel\s*\]\]")
        lines = [number for number, line in enumerate(text.splitlines(), 1) if header.match(line)]
        with checks.named(str(path)):
            self.frame, self.priors = table.get("frame", {}), table.get("prior", [])
            in_tables = isinstance(self.priors, list) and all(isinstance(prior, Mapping) for prior in self.priors)
            if not isinstance(self.frame, Mapping) or not in_tables:
                raise InputError("frame must be a table [frame], prior a list of tables [[prior]]")
            self.declared = declared = checks.keys(table["record"], RECORD_KEYS, [], "record")
            self.kind = checks.choice(declared.get("kind", "time"), ("time", "frf"), "record: kind")
            for key in ("time", "frequency", "axis"):
                if key in declared:
                    checks.text(declared[key], f"record: {key}")
            self.turns = self.frame.get("motions", ["x"]) != ["x"]
            if self.turns and self.kind == "frf":
                raise InputError("frame: motions: functions of floors that turn are not read; give time histories")
            self.channels = channels_of(table["channel"], declared, path, lines, self.turns)
            self.input = checks.choice(declared.get("input", "none"), kinds.INPUTS, "record: input")
            self.name = checks.text(declared.get("name", named_after(path)), "record: name")
            self.runs = runs_of(table, declared)
            self.files = (path, *(path.parent / run["file"] for run in self.runs))
            state, added, pick = table.get("state"), table.get("added_mass"), declared.get("pick")
            self.state = None if state is None else checks.text(state, "state")
            self.added_mass = None if added is None else checks.vector(added, "added_mass", least=0.0).tolist()
            self.pick = None if pick is None else checks.vector(pick, "record: pick", above=0.0).tolist()

    @property
    def driver(self) -> ChannelDeclaration | None:
        """The channel of the excitation."""
        if self.input not in ("base", "force"):
            return None
        forces = [item for item in self.channels if item.quantity == "force"]
        ground = [item for item in self.channels if item.quantity != "force" and item.floor == 0]
        found = forces if self.input == "force" else ground
        if len(found) != 1:
            what = 'with quantity = "force"' if self.input == "force" else "on the ground (floor = 0)"
            raise InputError(f'input = "{self.input}" needs one channel {what}, there are {len(found)}')
        return found[0]

    def _columns(self, run: Mapping[str, Any]) -> Columns:
        """Read the columns of a run's file."""
        limit = checks.number(self.declared.get("size_limit", LIMIT / MEGABYTE), "record: size_limit (MB)", above=0.0)
        found: Columns = read_columns(self.path.parent / run["file"], MEGABYTE * limit)
        return found

    def _floor(self, place: int, otherwise: int | None = None) -> int:
        """Find the floor of the force of a run; runs are counted from 1."""
        floor = self.runs[place - 1].get("input_floor", self.declared.get("input_floor", otherwise))
        if floor is None:
            raise InputError(f"run {place}: the key 'input_floor' is missing: which floor does the force act on?")
        return checks.whole(floor, f"run {place}: input_floor", least=1, most=checks.MOST_STORIES)

    def _parts(self, needed: Sequence[ChannelDeclaration]) -> Iterator[tuple[int, Mapping[str, Any], str, Columns]]:
        """Read the file of every run; a `*` in the columns' names makes a run of each name that it can stand for."""
        names = [name for name in (*(item.name for item in needed), self.declared.get("time", "")) if "*" in name]
        for place, run in enumerate(self.runs, 1):
            columns, name = self._columns(run), str(run.get("name", Path(run["file"]).name))
            if not names:
                yield place, run, name, columns
                continue
            # scipy.io loads slowly.
            arrays = import_module("cvxshear.io.arrays")
            for star, part in arrays.parts_of(columns, names):
                yield place, run, f"{name} {star}", part

    def _common(self) -> dict[str, Any]:
        """Return the arguments of both kinds of records."""
        declared = self.declared
        return {
            "stories": checks.whole(declared.get("stories", 0), "record: stories", least=0, most=checks.MOST_STORIES),
            "quantity": declared.get("quantity", "acceleration"),
            "band": declared.get("band"),
            "exponential_window": declared.get("exponential_window"),
            "name": self.name,
            "turns": self.turns,
        }

    @property
    def responses(self) -> list[ChannelDeclaration]:
        """The channels on floors."""
        return [item for item in self.channels if item.quantity != "force" and item.floor > 0]

    def pieces(self, needed: Sequence[ChannelDeclaration]) -> tuple[list[Piece], float]:
        """Read every uninterrupted stretch of every run, and the sampling rate, Hz.

        Parameters
        ----------
        needed : sequence of ChannelDeclaration
            Whose columns must hold numbers throughout.

        Raises
        ------
        InputError
            If a file cannot be read, or two were sampled at different rates.
        """
        driver, found, rates = self.driver, [], []
        for place, run, name, columns in self._parts(needed):
            floor = 0 if driver is None or self.input != "force" else self._floor(place, driver.floor or None)
            stretches, rate, left_out = pieces_of(columns, needed, self.declared, run)
            rates.append((rate, columns.source))
            if abs(rate - rates[0][0]) > 1e-3 * rates[0][0]:
                raise InputError(
                    f"{columns.source} is sampled at {rate:.6g} Hz, {rates[0][1]} at {rates[0][0]:.6g} Hz: two "
                    "sampling rates in one record; resample one of them"
                )
            for number, rows in enumerate(stretches, 1):
                part, excitation, noise_from, span = columns.rows(rows), None, None, (None, None)
                if driver is not None:
                    excitation = driver.read(part)
                    if driver.quantity in ("velocity", "displacement"):
                        excitation, noise_from = differentiated(excitation, rate, driver.quantity)
                if rows != slice(0, len(columns.values)):
                    clock = since_first(columns, self.declared)
                    span = (round(clock[rows.start], 9), round(clock[rows.stop - 1], 9))
                called = name if len(stretches) == 1 else f"{name}, piece {number}"
                said = left_out if number == 1 else ""
                found.append(Piece(name, called, part, excitation, floor, span, said, noise_from))
        return found, rates[0][0]

    def time_record(self) -> tuple[kinds.TimeRecord, list[kinds.Finding]]:
        """Read time histories, with a note on each run of which samples are left out."""
        driver, responses, notes = self.driver, self.responses, []
        quantities = {item.quantity for item in responses}
        if len(quantities) > 1:
            raise InputError(f"the responses are {' and '.join(sorted(quantities))}; a record holds one quantity")
        if not responses:
            raise InputError("no channel is on a floor above the ground")
        pieces, rate = self.pieces([*responses, *([] if driver is None else [driver])])
        for piece in pieces:
            if piece.left_out:
                count = sum(each.run == piece.run for each in pieces)
                notes.append(kinds.Finding("pieces", f"{piece.run}: {piece.left_out}", {"pieces": count}))
        limits = [piece.noise_from for piece in pieces if piece.noise_from is not None]
        if limits and driver is not None:
            said = f"the ground was recorded as a {driver.quantity} and is differentiated up to {min(limits):.3g} Hz"
            numbers = {"channel": driver.name, "quantity": driver.quantity, "noise_from": min(limits)}
            notes.append(
                kinds.Finding("ground", f"{said}, where it is above its noise; higher modes are not excited", numbers)
            )
        runs = []
        for each in pieces:
            table = np.column_stack([item.read(each.columns) for item in responses])
            runs.append(kinds.Run(table, each.excitation, each.floor, each.name, *each.span))
        common = {**self._common(), "quantity": quantities.pop()}
        found = kinds.TimeRecord(tuple(responses), **common, runs=tuple(runs), sampling_rate=rate, input=self.input)
        return found, notes

    def frf_record(self) -> kinds.FrfRecord:
        """Read frequency response functions."""
        declared, channels, common = self.declared, self.channels, self._common()
        if declared.get("input", "force") != "force":
            raise InputError('record: frequency response functions have input = "force"')
        made, axes = [], []
        for place, run in enumerate(self.runs, 1):
            columns = self._columns(run)
            name = declared.get("frequency") or next((item for item in FREQUENCY_NAMES if item in columns.names), None)
            if name is None:
                raise InputError(f"record: give frequency, the name of the frequency column of {columns.source}")
            axes.append((columns.column(name, "record: frequency"), columns.source))
            real, imaginary = (
                np.column_stack([replace(item, name=f"{item.name}_{end}").read(columns) for item in channels])
                for end in ("re", "im")
            )
            floor, called = self._floor(place), run.get("name", Path(run["file"]).name)
            made.append(kinds.FrfRun(real + 1j * imaginary, floor, called))
        for axis, source in axes[1:]:
            if axis.shape != axes[0][0].shape or not np.allclose(axis, axes[0][0], rtol=1e-6):
                raise InputError(f"{source} and {axes[0][1]} have different frequency lines; a record has one axis")
        return kinds.FrfRecord(
            tuple(channels), **common, runs=tuple(made), frequencies=axes[0][0],
            truncated=declared.get("truncated", True),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Piece:
    """An uninterrupted stretch of a run.

    Parameters
    ----------
    run, name : str
        Names of the run, and of the piece where it has several.
    columns : Columns
    excitation : ndarray, shape (samples,), or None
        m/s2 or N.
    floor : int
        Floor of the force; 0 without a force.
    span : tuple of (float or None, float or None)
        Start and end in its file, s; None where the piece is all of it.
    left_out : str
        What of the run is in no piece, said by its first one.
    noise_from : float, optional
        Where the excitation was differentiated: the frequency above which it is noise, Hz.
    """

    run: str
    name: str
    columns: Columns
    excitation: Floats | None
    floor: int
    span: tuple[float | None, float | None]
    left_out: str
    noise_from: float | None = None


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
        The message names the file, the key or the channel with its line, and the expected input.
    """
    file = RecordFile(Path(path))
    with checks.named(str(path)):
        if file.kind == "frf":
            file.record = file.frf_record()
        else:
            file.record, notes = file.time_record()
            file.notes = tuple(notes)
    return file


def channels_of(
    tables: object, declared: Mapping[str, Any], path: Path, lines: list[int], turns: bool = False
) -> list[ChannelDeclaration]:
    """Read the tables `[[channel]]`: those along the axis of the record, or of floors that turn all of them."""
    if not isinstance(tables, list) or not tables:
        raise InputError("channel must be a list of tables, one [[channel]] a column")
    found = []
    for place, item in enumerate(tables, 1):
        line = lines[place - 1] if place <= len(lines) else 0
        where = f"line {line}, channel {place}" if line else f"channel {place}"
        one = checks.keys(item, CHANNEL_KEYS, ["column"], where)
        column = checks.text(one["column"], f"{where}: column")
        where = f'{where} ("{column}")'
        unit = None if one.get("unit") is None else checks.choice(one["unit"], tuple(CHANNEL_UNITS), f"{where}: unit")
        quantity, in_si = _quantity(one.get("quantity"), unit, declared.get("quantity"), where)
        if quantity != "force" and "floor" not in one:
            raise InputError(f"{where}: the key 'floor' is missing (0 for the ground)")
        sign = one.get("sign", 1)
        if not isinstance(sign, int | float) or isinstance(sign, bool) or sign not in (1, -1):
            raise InputError(f"{where}: sign must be 1 or -1, not {checks.shown(sign)}")
        factor = sign * in_si * checks.number(one.get("calibration", 1.0), f"{where}: calibration", above=0.0)
        floor = checks.whole(one.get("floor", 0), f"{where}: floor", least=0, most=checks.MOST_STORIES)
        axis = checks.text(one.get("axis", "x"), f"{where}: axis")
        stands = f"line {line} of {path.name}" if line else path.name
        along = one.get("direction", 90.0 if turns and axis == "y" else None)
        stood = one.get("position"), along
        found.append(ChannelDeclaration(column, floor, axis, stands, unit, *stood, factor, quantity))
        for other in found[:-1]:
            if other.name == column:
                raise InputError(f'{stands}: channel "{column}" was declared before, in {other.place}')
    if turns:
        return found
    axes = {item.axis for item in found if item.quantity != "force"}
    wanted = declared.get("axis")
    if wanted is None and len(axes) > 1:
        raise InputError(f"the channels point along {', '.join(sorted(axes))}; say which with record: axis")
    if wanted is not None and wanted not in axes:
        raise InputError(f"record: axis = {checks.shown(wanted)}; the channels point along {', '.join(sorted(axes))}")
    return [item for item in found if item.quantity == "force" or wanted is None or item.axis == wanted]


def _quantity(given: object, unit: str | None, usual: object, where: str) -> tuple[str, float]:
    """Find the quantity of a channel and its unit in SI units. The channel's unit overrides the record's quantity."""
    measured, in_si = ("acceleration", 1.0) if unit is None else CHANNEL_UNITS[unit]
    if given is None:
        given = measured if unit is not None or usual is None else usual
    quantity = checks.choice(given, ("force", *kinds.RECORDED_QUANTITIES), f"{where}: quantity")
    if unit is not None and quantity != measured:
        raise InputError(f"{where}: unit = {unit!r} is one of {measured}, not of {quantity}")
    return quantity, in_si


def runs_of(table: Mapping[str, Any], declared: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the tables `[[run]]`, or the one run that `[record]` names."""
    if "run" in table:
        if "file" in declared:
            raise InputError("give either record: file, or [[run]] tables, not both")
        if not isinstance(table["run"], list) or not table["run"]:
            raise InputError("run must be a list of tables, one [[run]] a file")
        return [_run(item, f"run {place}") for place, item in enumerate(table["run"], 1)]
    if "file" not in declared:
        raise InputError("record: the key 'file' is missing (or [[run]] tables, each with its file)")
    return [_run({"file": declared["file"]}, "record")]


def _run(item: object, where: str) -> Mapping[str, Any]:
    run = checks.keys(item, RUN_KEYS, ["file"], where)
    checks.text(run["file"], f"{where}: file")
    checks.text(run.get("name", "run"), f"{where}: name")
    for key in ("start", "end"):
        if key in run:
            checks.number(run[key], f"{where}: {key} (s since the first sample)", least=0.0)
    if run.get("start", 0.0) >= run.get("end", float("inf")):
        raise InputError(f"{where}: end = {run['end']:g} s must come after start = {run.get('start', 0.0):g} s")
    return run


def pieces_of(
    columns: Columns, needed: Sequence[ChannelDeclaration], declared: Mapping[str, Any], run: Mapping[str, Any]
) -> tuple[list[slice], float, str]:
    """Find the longest stretches of a file without gaps, its sampling rate, and a sentence on what was left out.

    Parameters
    ----------
    columns : Columns
    needed : sequence of ChannelDeclaration
        Whose columns must hold numbers.
    declared, run : dict
        The tables [record] and [[run]]; of the latter, `start` and `end` in s since the first sample.

    Returns
    -------
    pieces : list of slice
        Rows of each piece, in order; one piece without gaps.
    rate : float
        Hz.
    left_out : str
        Empty if all samples are used.

    Raises
    ------
    InputError
        Most of the samples would be left out, or there are no samples between `start` and `end`.
    """
    for item in needed:
        columns.check(item.name, item.place)
    name = time_column_of(declared, columns)
    sound: Bools = np.all(np.isfinite(columns.values[:, [columns.names.index(item.name) for item in needed]]), axis=1)
    breaks: list[int] = []
    if name is None:
        rate = rate_of(declared, columns)
    else:
        time = columns.values[:, columns.names.index(name)]
        sound &= np.isfinite(time)
        steps = np.diff(time[sound])
        jumps = np.flatnonzero(steps > LONG_STEP * np.median(steps)) if steps.size else np.zeros(0, dtype=int)
        if 0 < jumps.size <= MOST_GAPS * len(time) and np.all(steps > 0):
            breaks = np.flatnonzero(sound)[jumps + 1].tolist()
    first, last = _asked(columns, declared, run)
    sound_rows = sound_pieces(sound, breaks, slice(first, last))
    whole = sound_rows == [slice(first, last)]
    for item in needed if whole else ():
        # The reader of the whole record reports other mistakes.
        item.read(columns.rows(sound_rows[0]))
    if name is not None:
        rate = rate_of(declared, columns.rows(max(sound_rows, key=lambda each: each.stop - each.start)))
    if whole:
        return sound_rows, rate, ""
    lost = last - first - sum(each.stop - each.start for each in sound_rows)
    jumped = sum(first < row < last for row in breaks)
    why = [f"{lost} of {last - first} samples are missing or stand between gaps"] if lost else []
    why += [f"the clock jumps {counted(jumped, 'time')}"] if jumped else []
    clock = since_first(columns, declared)
    pieces = ", ".join(f"{clock[each.start]:.4g} to {clock[each.stop - 1]:.4g} s" for each in sound_rows)
    return sound_rows, rate, f"{', '.join(why)}; the longest sound pieces are used as runs of their own: {pieces}"


def since_first(columns: Columns, declared: Mapping[str, Any]) -> Floats:
    """Return the time of each sample since the first, s, by the time column if there is one."""
    name = time_column_of(declared, columns)
    if name is None:
        return np.arange(len(columns.values)) / rate_of(declared, columns)
    time = seconds_of(declared, columns.values[:, columns.names.index(name)])
    return np.asarray(np.maximum.accumulate(np.nan_to_num(time - time[np.isfinite(time)][0], nan=0.0)))


def _asked(columns: Columns, declared: Mapping[str, Any], run: Mapping[str, Any]) -> tuple[int, int]:
    """Return the rows from `start` to `end` of a run: the first, and the one after the last."""
    if not {"start", "end"} & set(run):
        return 0, len(columns.values)
    time = since_first(columns, declared)
    first, last = np.searchsorted(time, [run.get("start", 0.0), run.get("end", np.inf)])
    if last - first < FEWEST_SAMPLES:
        raise InputError(
            f"{columns.source} has {last - first} samples between start and end of the run; it lasts {time[-1]:.4g} s "
            f"from its first sample, and at least {FEWEST_SAMPLES} samples are needed"
        )
    return int(first), int(last)


def rate_of(declared: Mapping[str, Any], columns: Columns) -> float:
    """Find the sampling rate from the time column, from the declaration if both agree, or from a number in the file."""
    name = time_column_of(declared, columns)
    said = declared.get("sampling_rate")
    if said is not None:
        said = checks.number(said, "record: sampling_rate", above=0.0)
    if name is None:
        if said is not None:
            return said
        if columns.stated_rate is not None:
            return columns.stated_rate[1]
        raise InputError(f"record: give sampling_rate, in Hz, or time, the name of the time column of {columns.source}")
    time = seconds_of(declared, columns.column(name, "record: time"))
    return sampling_rate_of(time, columns, f'column "{name}"', said)


def time_column_of(declared: Mapping[str, Any], columns: Columns) -> str | None:
    """Find the name of the time column: the declared or a usual name; None without a time column."""
    name = declared.get("time") or next((item for item in TIME_NAMES if item in columns.names), None)
    if name is not None:
        columns.check(name, "record: time")
    return name


def seconds_of(declared: Mapping[str, Any], time: Floats) -> Floats:
    """Return a time column in s."""
    unit = checks.choice(declared.get("time_unit", "s"), tuple(TIME_UNITS), "record: time_unit")
    return time * TIME_UNITS[unit]
