"""The tables of a record file: channels, runs, and the samples of a run between gaps."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.io.csv import Columns
from cvxshear.io.formats import refuse_data
from cvxshear.io.toml import parse, read_text
from cvxshear.measurement.experiment import MOST_STORIES
from cvxshear.records.data_frames import FEWEST_SAMPLES, TIME_NAMES, TIME_UNITS, sampling_rate_of, sound_pieces
from cvxshear.records.record import RECORDED_QUANTITIES, Channel
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import CHANNEL_UNITS, counted
from cvxshear.util.typing import Bools, Floats

CHANNEL_KEYS = ("column", "floor", "axis", "sign", "calibration", "quantity", "unit", "position", "direction")
RUN_KEYS = ("file", "name", "input_floor", "start", "end")
PASSED_ON = ("frame", "prior", "added_mass", "state")

#: Longest step without a gap, as a multiple of the usual step. A longer step lost a sample, for any rounding.
LONG_STEP = 1.75

#: Largest share of long steps that are gaps. More long steps are another sampling rate, which is refused.
MOST_GAPS = 0.01


@dataclass(frozen=True)
class ChannelDeclaration(Channel):
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

    @property
    def responds(self) -> bool:
        """Whether the channel measures a floor."""
        return self.floor > 0 and self.quantity != "force"


def tables_of(path: Path) -> tuple[Mapping[str, Any], list[int]]:
    """Read the tables of a record file, and the line of each channel."""
    refuse_data(path)
    text = read_text(path)
    declared = parse(text, path)
    if "configuration" in declared and "record" not in declared:
        raise InputError(
            f"{path} is a measurement file (it has [[configuration]]), not a record file: its modes are found already; "
            f"'cvxshear identify {path}' and 'cvxshear loop {path}' take it"
        )
    keys = ["record", "channel", "run", *PASSED_ON]
    return checks.keys(declared, keys, ["record", "channel"], str(path)), _lines_of(text, "channel")


@contextmanager
def placed(path: Path) -> Iterator[None]:
    """Put the name of the file before the messages of errors."""
    try:
        yield
    except InputError as error:
        message = str(error)
        # Errors of other readers name their own files.
        raise type(error)(message if message.startswith(str(path.parent)) else f"{path}: {message}") from error


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
        floor = checks.whole(one.get("floor", 0), f"{where}: floor", least=0, most=MOST_STORIES)
        axis = checks.text(one.get("axis", "x"), f"{where}: axis")
        stands = f"line {line} of {path.name}" if line else ""
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
    quantity = checks.choice(given, ("force", *RECORDED_QUANTITIES), f"{where}: quantity")
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


def driver_of(channels: list[ChannelDeclaration], kind: str) -> ChannelDeclaration | None:
    """Find the channel that measures the input."""
    ground = [item for item in channels if item.floor == 0 and item.quantity != "force"]
    forces = [item for item in channels if item.quantity == "force"]
    if kind == "base":
        if len(ground) != 1:
            raise InputError(f'input = "base" needs one channel on the ground (floor = 0), there are {len(ground)}')
        return ground[0]
    if kind == "force":
        if len(forces) != 1:
            raise InputError(f'input = "force" needs one channel with quantity = "force", there are {len(forces)}')
        return forces[0]
    return None


def _lines_of(text: str, table: str) -> list[int]:
    """Find the line of each `[[table]]` header."""
    pattern = re.compile(rf"^\s*\[\[\s*{table}\s*\]\]")
    return [number for number, line in enumerate(text.splitlines(), 1) if pattern.match(line)]


def pieces_of(
    columns: Columns,
    needed: Sequence[ChannelDeclaration],
    declared: Mapping[str, Any],
    run: Mapping[str, Any],
    path: Path,
) -> tuple[list[slice], float, str]:
    """Find the longest stretches of a file without gaps, its sampling rate, and a sentence on what was left out.

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
        columns.check(item.name, item.place or path.name)
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
        columns.rows(sound_rows[0]).column(item.name, item.place or path.name)
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
