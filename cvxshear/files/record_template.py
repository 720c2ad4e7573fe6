"""A record file to fill in, begun from a logger's own file: the columns that it holds, and what their names suggest."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cvxshear.files.columns import LIMIT, Columns, sampling_rate_of
from cvxshear.files.csv import preamble_of
from cvxshear.files.formats import format_of, read_columns
from cvxshear.files.inputs import named_after
from cvxshear.files.measurement_template import toml_line
from cvxshear.files.record_file import FREQUENCY_NAMES, TIME_UNITS
from cvxshear.files.record_tables import UNITS
from cvxshear.util.errors import InputError
from cvxshear.util.text import printable

TIME = re.compile(r"(time|zeit|t|temps|tiempo|timestamp|date|datetime|elapsed|stamp|seconds)\b", re.IGNORECASE)
GROUND = re.compile(r"ground|base\b|basement|table|platform|input|boden|fundament|sol\b|floor ?0\b", re.IGNORECASE)
FORCE = re.compile(r"force|hammer|impact|shaker|load ?cell|kraft", re.IGNORECASE)
NUMBER = re.compile(r"\d+")
AXIS = re.compile(r"(?:^|[^a-z])([xyz])(?:$|[^a-z])|\d([xyz])$", re.IGNORECASE)
BRACKETED = re.compile(r"[\[(]([^\])]*)[\])]|[,/]\s*([a-zA-Zµ/²^*0-9.]+)\s*$")
"""A unit in a header: "acc [g]", "acc (m/s^2)", "acc, g"."""

RATE = re.compile(
    r"(?:sampl\w*[ _-]?(?:rate|freq\w*)?|\bfs\b|\brate\b|abtastrate)[^\d\n]{0,20}(\d+(?:[.,]\d+)?)", re.IGNORECASE
)
"""A sampling rate in a preamble: "Sampling rate: 256 Hz", "fs = 100"."""

ASCENDING = 0.99
"""Share of the steps of a column of time that are not negative; a handful may be torn."""

EVEN = 0.01
"""Share of the usual step by which steps of a column of time without a name may differ."""

SPELLED = {"m/s/s": "m/s2", "m/sec2": "m/s2", "ms-2": "m/s2", "m.s-2": "m/s2", "mm/s/s": "mm/s2", "cm/s/s": "cm/s2",
           "gals": "gal", "sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "µs": "us", "g's": "g",
           "gn": "g", "kn": "kN", "n": "N"}  # fmt: skip
"""Other spellings of units, in small letters."""

HEAD = """\
# What a logger recorded: which column is which sensor. Begun by 'cvxshear new' from {file};
# lines marked GUESSED follow from names and numbers in that file: check them. FILL IN what only you know.
# Then 'cvxshear check' says what looks wrong, and 'cvxshear modes' finds the modes.

# added_mass = [0.0, 0.0]  # kg on each floor during the record
# state = "bare"  # the state of the frame that was tested; records of one state share its name

[record]
name = {name}
{source}
input = "{kind}"  # GUESSED from {why}: "base", "force", "free_decay", or "none" for ambient vibration
{rate}
# band = [0.5, 20.0]  # Hz, where natural frequencies are looked for
"""

TAIL = """
# [frame]
# total_mass = 1000.0  # kg without added mass: FILL IN, or masses and stiffnesses come out per kilogram of the frame
# story_heights = 3.0  # m
"""


@dataclass(frozen=True)
class Guess:
    """What the name and the numbers of a column suggest.

    Parameters
    ----------
    column : str
    unit : str or None
        Of `UNITS`, None where the file says none.
    role : str
        "ground", "force" or "floor".
    floor : int
    sure : bool
        Whether a number in the name says the floor, and not the order of the columns.
    axis : str
    said : str
        The unit as the file spells it, where it is not one of `UNITS`.
    """

    column: str
    unit: str | None
    role: str
    floor: int
    sure: bool
    axis: str
    said: str = ""


def record_template(data: str | Path, folder: str | Path = ".") -> str:
    """A record file for the samples in a logger's file, every guess marked as one.

    Parameters
    ----------
    data : str or Path
        Of one of the formats in `files.formats.FORMATS` that hold columns.
    folder : str or Path, optional
        Where the record file will stand; it names the other from there.

    Returns
    -------
    str
        TOML. `read_record` takes it as it stands where the file shows its sampling rate.

    Raises
    ------
    InputError
        Where the file cannot be read, or holds no column of numbers besides time.
    """
    path = Path(data)
    columns = read_columns(path, LIMIT)
    if any(name in columns.names for name in FREQUENCY_NAMES):
        raise InputError(
            f"{path} has a column of frequencies, so it holds frequency response functions; docs/modal.md has a record "
            'file for them (kind = "frf")'
        )
    texts = preamble_of(path, LIMIT) if (found := format_of(path)) is None or found.name in ("csv", "gz") else ""
    time = _time_column(columns)
    rate = _rate(columns, time, texts)
    guesses = _guesses(columns, [name for name in columns.names if name != time])
    if not guesses:
        raise InputError(f"{path} has no column of numbers besides the time; is it a record?")
    roles = {each.role for each in guesses}
    kind, why = (
        ("force", "a column that looks like a force") if "force" in roles
        else ("base", "a column that looks like the ground") if "ground" in roles
        else ("none", "no column looking like the ground or a force")
    )  # fmt: skip
    axes = sorted({each.axis for each in guesses if each.role != "force"})
    head = HEAD.format(
        file=printable(path.name), name=toml_line("x", named_after(path))[4:], kind=kind, why=why, rate=rate,
        source=toml_line("file", os.path.relpath(path, folder)),
    )  # fmt: skip
    if len(axes) > 1:
        head += f'axis = "{axes[0]}"  # GUESSED: the direction of test, of those below\n'
    top = max((each.floor for each in guesses), default=1)
    return head + "".join(_channel(each, max(top, 1), several=len(axes) > 1) for each in guesses) + TAIL


def _time_column(columns: Columns) -> str | None:
    """The column that is called so and ascends; where none is called so, the first if it ascends in even steps."""
    called = [name for name in columns.names if TIME.match(name.strip())]
    for name in (*called, *columns.names[:1]):
        values = columns.values[:, columns.names.index(name)]
        steps = np.diff(values[np.isfinite(values)])
        if steps.size == 0 or np.mean(steps >= 0) < ASCENDING:
            continue
        usual = np.median(steps)
        if name in called or (usual > 0 and np.mean(np.abs(steps - usual) < EVEN * usual) > ASCENDING):
            return name
    return None


def _rate(columns: Columns, time: str | None, preamble: str) -> str:
    """The lines that say how the record was sampled."""
    if time is None:
        found = RATE.search(preamble)
        if found is None:
            return "# sampling_rate = 100.0  # Hz: FILL IN, the file has no column of time"
        return f"sampling_rate = {float(found[1].replace(',', '.'))}  # Hz, GUESSED from {toml_line('x', found[0])[4:]}"
    unit = _unit(columns, time)[0]
    unit = unit if unit in TIME_UNITS else "s"
    values = TIME_UNITS[unit] * columns.values[:, columns.names.index(time)]
    line = toml_line("time", time)
    more = "" if unit == "s" else f'\ntime_unit = "{unit}"  # GUESSED from the header'
    try:
        rate = sampling_rate_of(values[np.isfinite(values)], columns, time)
        return f"{line}  # GUESSED: it ticks at {rate:.6g} Hz, {len(values) / rate:.4g} s long{more}"
    except InputError:
        steps = np.diff(values[np.isfinite(values)])
        return f"{line}  # GUESSED: its steps are uneven, {np.median(steps):.4g} s in the middle{more}"


def _unit(columns: Columns, name: str) -> tuple[str, str]:
    """The unit that a line of units or the header says, as it is called here and as it is spelled there."""
    said = columns.units[columns.names.index(name)] if columns.units else ""
    if not said and (found := BRACKETED.search(name)):
        said = found[1] or found[2] or ""
    plain = re.sub(r"[\s*^]", "", said.strip().replace("²", "2").replace("**", ""))
    known = {each.lower(): each for each in (*UNITS, *TIME_UNITS)}
    lower = plain.lower()
    return SPELLED.get(lower, plain if plain in UNITS else known.get(lower, "")), said


def _guesses(columns: Columns, names: Sequence[str]) -> list[Guess]:
    """What each column is, those that hold no number left out."""
    found: list[Guess] = []
    for name in names:
        if not np.isfinite(columns.values[:, columns.names.index(name)]).any():
            continue
        unit, said = _unit(columns, name)
        bare = BRACKETED.sub("", name)
        force = bool(FORCE.search(bare)) or (unit in UNITS and UNITS[unit][0] == "force")
        ground = not force and bool(GROUND.search(bare))
        number = NUMBER.findall(bare)
        axis = AXIS.search(bare)
        floor = 0 if ground else int(number[-1]) if number and 0 < int(number[-1]) < 200 else -1
        role = "force" if force else "ground" if ground else "floor"
        found.append(
            Guess(name, unit if unit in UNITS else None, role, floor, floor >= 0,
                  (axis[1] or axis[2]).lower() if axis else "x", "" if unit in UNITS else said)
        )  # fmt: skip
    # Channels numbered from 0 or without gaps in another count stand in the order of the columns all the same.
    order = 0
    result = []
    for each in found:
        if each.role == "floor" and each.floor < 0:
            order += 1
            each = Guess(each.column, each.unit, each.role, order, False, each.axis, each.said)  # noqa: PLW2901
        result.append(each)
    return result


def _channel(guess: Guess, top: int, *, several: bool) -> str:
    lines = ["", "[[channel]]", toml_line("column", guess.column)]
    if guess.role == "force":
        at = guess.floor if guess.sure and guess.floor > 0 else top
        lines += [f"floor = {at}  # GUESSED: where the force acts", 'quantity = "force"  # GUESSED from the header']
    elif guess.role == "ground":
        lines.append("floor = 0  # GUESSED from the name: the ground")
    else:
        lines.append(f"floor = {guess.floor}  # GUESSED from the {'name' if guess.sure else 'order of the columns'}")
    if guess.unit is not None:
        lines.append(f'unit = "{guess.unit}"  # GUESSED from the header')
    else:
        usual = "N" if guess.role == "force" else "m/s2"
        said = f"; the file says {printable(guess.said)!r}" if guess.said else ""
        lines.append(f'# unit = "g"  # FILL IN where it is not {usual}{said}: {", ".join(list(UNITS)[:7])}, ...')
    if several and guess.role != "force":
        lines.append(f'axis = "{guess.axis}"  # GUESSED from the name')
    lines.append("# sign = -1  # where the sensor points the other way; calibration = 1.0: a factor on the column")
    return "\n".join(lines) + "\n"
