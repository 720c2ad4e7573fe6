"""What the tables of a record file say: its channels and runs, checked as they stand."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cvxshear.files.formats import refuse_data
from cvxshear.files.toml import parse, read_text
from cvxshear.measurement.experiment import MOST_STORIES
from cvxshear.records.record import RECORDED_QUANTITIES, Channel
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import CHANNEL_UNITS

CHANNEL_KEYS = ("column", "floor", "axis", "sign", "calibration", "quantity", "unit", "position", "direction")
RUN_KEYS = ("file", "name", "input_floor", "start", "end")
PASSED_ON = ("frame", "prior", "added_mass", "state")


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
        """Whether it measures a floor."""
        return self.floor > 0 and self.quantity != "force"


def tables_of(path: Path) -> tuple[Mapping[str, Any], list[int]]:
    """Read the tables of a record file, and the lines that its channels stand on."""
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
    """Say which file it is that a message is about."""
    try:
        yield
    except InputError as error:
        message = str(error)
        # What the readers of other files say names those.
        raise type(error)(message if message.startswith(str(path.parent)) else f"{path}: {message}") from error


def added_mass_of(table: Mapping[str, Any], path: Path) -> list[float] | None:
    """kg on each floor during the record; None where the file does not say."""
    added = table.get("added_mass")
    if added is None:
        return None
    masses: list[float] = checks.vector(added, f"{path}: added_mass", least=0.0).tolist()
    return masses


def channels_of(tables: object, declared: Mapping[str, Any], path: Path, lines: list[int]) -> list[ChannelDeclaration]:
    """Read what the tables `[[channel]]` declare."""
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
        direction = one.get("position"), one.get("direction")
        found.append(ChannelDeclaration(column, floor, axis, stands, unit, *direction, factor, quantity))
        for other in found[:-1]:
            if other.name == column:
                raise InputError(f'{stands}: channel "{column}" was declared before, in {other.place}')
    axes = {item.axis for item in found if item.quantity != "force"}
    wanted = declared.get("axis")
    if wanted is None and len(axes) > 1:
        raise InputError(f"the channels point along {', '.join(sorted(axes))}; say which with record: axis")
    if wanted is not None and wanted not in axes:
        raise InputError(f"record: axis = {checks.shown(wanted)}; the channels point along {', '.join(sorted(axes))}")
    return [item for item in found if item.quantity == "force" or wanted is None or item.axis == wanted]


def _quantity(given: object, unit: str | None, usual: object, where: str) -> tuple[str, float]:
    """Find what a channel measures, and its unit in SI units: what the unit says goes before what all channels have."""
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
        if ground[0].quantity != "acceleration":
            raise InputError(f'channel "{ground[0].name}": the base input must be an acceleration')
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
