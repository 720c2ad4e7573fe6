"""Files to fill in: a measurement file with every key explained, and a record file begun from a logger's own file.

Their texts stand in the folder `blank`; a record file marks what follows from the names and numbers of its columns.
"""

import dataclasses
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import tomli_w

from cvxshear.files.columns import LIMIT, Columns
from cvxshear.files.csv import preamble_of
from cvxshear.files.formats import format_of, read_columns, read_modes_of
from cvxshear.files.inputs import named_after
from cvxshear.files.record_file import FREQUENCY_NAMES
from cvxshear.records.stamps import TIME_UNITS, UNEVEN_STEP, sampling_rate_of
from cvxshear.util import checks
from cvxshear.util.checks import MOST_STORIES
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import CHANNEL_UNITS, counted
from cvxshear.util.text import escaped, printable
from cvxshear.util.typing import Floats

MASS, STIFFNESS, PULL = 10.0, 10e3, 100.0
"""Floor mass (kg) and story stiffness (N/m) of the frame that stands for the user's, and a pull at its top (N)."""

TOTAL = "total_mass = {total}  # kg, all floors without added mass; not needed with two different added masses"
"""The line that a new file has where its modes are made up."""

TO_FILL_IN = """\
total_mass = 1.0  # kg, all floors without added mass: FILL IN, or give two configurations with different added masses;
# {file} does not tell how heavy the frame is, and with 1 kg masses and stiffnesses come out per kilogram of it"""

CARRIED = "# total_mass is not needed: the shapes carry the scale, 1/sqrt(kg)"


def _blank(name: str) -> str:
    return resources.files("cvxshear.files").joinpath("blank", name).read_text(encoding="utf-8")


def template(stories: int = 3) -> str:
    """Write a measurement file of a frame of equal stories, with every key explained.

    What is not needed stands as a comment.

    Parameters
    ----------
    stories : int, optional

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.
    """
    checks.whole(stories, "stories", least=1, most=MOST_STORIES)
    # Modes of equal floors of 10 kg on equal stories of 10 kN/m: sine waves, in closed form.
    angle = (2 * np.arange(1, stories + 1) - 1) * np.pi / (2 * stories + 1)
    shapes = np.sin(np.outer(angle, np.arange(1, stories + 1)))
    frequencies = np.sqrt(STIFFNESS / MASS) * 2 * np.sin(angle / 2) / (2 * np.pi)
    lists = _blank("modes.toml").format(
        floors=_listed(np.arange(1, stories + 1), "d"),
        frequencies=_listed(frequencies, ".4f"),
        rows="\n".join(f"    {_listed(shape, '.4f')}," for shape in shapes / abs(shapes).max(axis=1, keepdims=True)),
    )
    return _filled(lists, stories, TOTAL)


def template_from(modes: str | Path, folder: str | Path = ".") -> str:
    """Write a measurement file whose modes are read from a table or a universal file.

    Parameters
    ----------
    modes : str or Path
        Of one of the formats in `files.formats.FORMATS` that hold modes.
    folder : str or Path, optional
        Where the measurement file will stand; it names the other from there.

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.

    Raises
    ------
    InputError
        Where the file cannot be read.
    """
    key, found = read_modes_of(modes)
    named = toml_line(key, os.path.relpath(modes, folder))
    total = CARRIED if found.get("mass_normalized") else TO_FILL_IN.replace("{file}", printable(Path(modes).name))
    text = _filled(f"{named}  # frequencies and mode shapes", max(found["measured_floors"]), total)
    for given in ("frequency_std", "mode_shape_std"):
        # What the table says itself need not be said here.
        text = text.replace(f"\n{given} =", f"\n# {given} =") if given in found else text
    return text


def toml_line(key: str, name: str) -> str:
    """Write a line of TOML that names a file, from the folder that the line stands in.

    Raises
    ------
    InputError
        Where the name has bytes that are no text, which TOML cannot hold.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{name}: a name that is no UTF-8 text cannot stand in TOML; rename the file") from None
    return escaped(tomli_w.dumps({key: name.replace(os.sep, "/")})).rstrip("\n")


def _filled(modes: str, stories: int, total: str) -> str:
    return _blank("measurement.toml").format(
        stories=stories,
        total=total.replace("{total}", f"{MASS * stories:.1f}"),
        heights=_listed(np.full(stories, 3.0), ".1f"),
        masses=_listed(np.full(stories, MASS), ".1f"),
        added=_listed(np.zeros(stories), ".1f"),
        modes=modes,
        force=_listed(np.eye(stories)[-1] * PULL, ".1f"),
        displacement=_listed(np.arange(1, stories + 1) * PULL / STIFFNESS, ".3f"),
    )


def _listed(values: Floats | np.ndarray, shown: str) -> str:
    return "[" + ", ".join(format(value, shown) for value in values) + "]"


_WORDS = tomllib.loads(_blank("words.toml"))
TIME, GROUND, FORCE, ROOF, NO_MOTION, BASEMENT, NTH_FLOOR, AXIS, BRACKETED, ENDING, RATE = (
    re.compile(pattern, re.IGNORECASE) for pattern in _WORDS["name"].values()
)
"""What columns, their units and the sampling rate in a preamble look like; the file explains each, in this order."""

NUMBER = re.compile(r"\d+")

ASCENDING = 0.99
"""Share of the steps of a column of time that are not negative; a handful may be torn."""


@dataclass(frozen=True)
class Guess:
    """What the name and the numbers of a column suggest.

    Parameters
    ----------
    column : str
    unit : str or None
        Of `CHANNEL_UNITS`, None where the file says none.
    role : str
        "ground", "force" or "floor".
    floor : int
    sure : bool
        Whether a number in the name says the floor, and not the order of the columns.
    axis : str
    said : str
        The unit as the file spells it, where it is not one of `CHANNEL_UNITS`.
    why : str
        What else the floor follows from, and what it would be otherwise.
    """

    column: str
    unit: str | None
    role: str
    floor: int
    sure: bool
    axis: str
    said: str = ""
    why: str = ""


def record_template(data: str | Path | Sequence[str | Path], folder: str | Path = ".") -> str:
    """Write a record file for the samples in a logger's files, every guess marked as one.

    Parameters
    ----------
    data : str or Path, or sequence of them
        Of one of the formats in `files.formats.FORMATS` that hold columns; several files, with the same columns, are
        the runs of one record: hits of a hammer, releases, or repetitions of one shaking.
    folder : str or Path, optional
        Where the record file will stand; it names the other from there.

    Returns
    -------
    str
        TOML. `read_record` takes it as it stands where the file shows its sampling rate.

    Raises
    ------
    InputError
        Where a file cannot be read, holds no column of numbers besides time, or other columns than the first.
    """
    path, *others = [Path(data)] if isinstance(data, str | Path) else [Path(each) for each in data]
    columns = read_columns(path, LIMIT)
    for other in others:
        if missing := sorted(set(columns.names) - set(names := read_columns(other, LIMIT).names)):
            raise InputError(
                f'{other} has no column "{missing[0]}", which {path} has; it has {", ".join(names[:12])}. The files of '
                "one record have the same columns; begin a record file for each where they are records of their own"
            )
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
    several = len(axes) > 1
    if several:
        rate += f'\naxis = "{axes[0]}"  # GUESSED: the direction of test, of those below'
    top = max(1, *(each.floor for each in guesses))
    hit = next((each.floor for each in guesses if each.role == "force" and each.sure and each.floor > 0), top)
    left = [
        f"\n# Left out, no motion by its name: {printable(each)}\n"
        for each in columns.names
        if NO_MOTION.search(each) and each != time
    ]
    return _blank("record.toml").format(
        masses=", ".join(["0.0"] * top), stories=top + 1,
        file=printable(path.name) + (f" and {len(others)} more" if others else ""),
        name=toml_line("x", named_after(path))[4:], kind=kind, why=why, rate=rate,
        source="" if others else toml_line("file", os.path.relpath(path, folder)) + "\n",
        channels="".join((*(_channel(each, hit, several=several) for each in guesses), *left)),
        runs=_runs([path, *others], folder, kind, hit) if others else "",
    )  # fmt: skip


def _runs(files: Sequence[Path], folder: str | Path, kind: str, hit: int) -> str:
    """Write a table for each file of a record."""
    where = (
        f"\ninput_floor = {hit}  # GUESSED, no file says it: the floor that was hit in this file: CHECK"
        if kind == "force"
        else ""
    )
    return "".join(f"\n[[run]]\n{toml_line('file', os.path.relpath(each, folder))}{where}\n" for each in files)


def _time_column(columns: Columns) -> str | None:
    """Find the column that is called so and ascends; where none is called so, the first if it ascends in even steps."""
    called = [name for name in columns.names if TIME.match(name.strip())]
    # Of a date and a time of the day the one that changes from sample to sample.
    steps_of = {name: _steps(columns, name) for name in (*called, *columns.names[:1])}
    for name, steps in sorted(
        steps_of.items(), key=lambda each: (each[0] not in called, -np.count_nonzero(each[1] > 0))
    ):
        if steps.size == 0 or np.mean(steps >= 0) < ASCENDING:
            continue
        usual = np.median(steps)
        # Steps of 1 count the samples.
        even = np.mean(np.abs(steps - usual) < UNEVEN_STEP * usual) > ASCENDING
        if name in called or (usual > 0 and usual != 1.0 and even):
            return name
    return None


def _steps(columns: Columns, name: str) -> Floats:
    values = columns.values[:, columns.names.index(name)]
    return np.asarray(np.diff(values[np.isfinite(values)]))


def _rate(columns: Columns, time: str | None, preamble: str) -> str:
    """Write the lines that say how the record was sampled."""
    if time is None and columns.stated_rate is not None:
        name, rate = columns.stated_rate
        return f"sampling_rate = {rate:.9g}  # Hz, GUESSED from {toml_line('x', name)[4:]} in the file"
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
        rate = sampling_rate_of(values[np.isfinite(values)], columns, "time")
        return f"{line}  # GUESSED: it ticks at {rate:.6g} Hz, {len(values) / rate:.4g} s long{more}"
    except InputError:
        steps = np.diff(values[np.isfinite(values)])
        usual = np.median(steps)
        others = counted(int(np.count_nonzero(np.abs(steps - usual) > UNEVEN_STEP * usual)), "other step")
        return f"{line}  # GUESSED: mostly steps of {usual:.4g} s, and {others}; gaps part a record into runs{more}"


def _unit(columns: Columns, name: str) -> tuple[str, str]:
    """Find the unit that a line of units or the header says, as it is called here and as it is spelled there."""
    said = columns.units[columns.names.index(name)] if columns.units else ""
    candidates = [said] if said else [found[1] or found[2] or "" for found in BRACKETED.finditer(name)]
    if not said and (found := ENDING.search(name)):
        candidates.append(re.sub(r"_?p?s2", "/s2", found[1]))
    known = [(unit, each) for each in candidates if (unit := _known_unit(each))]
    # "Level 3 N" is to the north: of a last word only a unit of acceleration is taken for one.
    last = name.rsplit(maxsplit=1)[-1] if " " in name.strip() else ""
    if not said and CHANNEL_UNITS.get(_known_unit(last), ("",))[0] == "acceleration":
        known.append((_known_unit(last), last))
    return known[-1] if known else ("", candidates[0] if candidates else "")


def _known_unit(said: str) -> str:
    """Name a unit as it is called here; empty where none is known by that name."""
    plain = re.sub(r"[\s*^]", "", said.strip().replace("²", "2").replace("**", ""))
    known = {each.lower(): each for each in (*CHANNEL_UNITS, *TIME_UNITS)}
    lower = plain.lower()
    return str(_WORDS["unit"].get(lower, plain if plain in CHANNEL_UNITS else known.get(lower, "")))


def _guesses(columns: Columns, names: Sequence[str]) -> list[Guess]:
    """Tell what each column is, those that hold no number left out."""
    found: list[Guess] = []
    for name in names:
        if NO_MOTION.search(name) or not np.isfinite(columns.values[:, columns.names.index(name)]).any():
            continue
        unit, said = _unit(columns, name)
        bare = ENDING.sub("", BRACKETED.sub("", name))
        force = bool(FORCE.search(bare)) or (unit in CHANNEL_UNITS and CHANNEL_UNITS[unit][0] == "force")
        ground = not force and bool(GROUND.search(bare.replace("_", " ")) or BASEMENT.search(bare))
        number = NUMBER.findall(bare)
        axis = AXIS.search(bare)
        floor = 0 if ground else int(number[-1]) if number and 0 < int(number[-1]) < 200 else -1
        role = "force" if force else "ground" if ground else "floor"
        found.append(
            Guess(name, unit if unit in CHANNEL_UNITS else None, role, floor, floor >= 0,
                  (axis[1] or axis[2]).lower() if axis else "x", "" if unit in CHANNEL_UNITS else said)
        )  # fmt: skip
    found = _as_in_japan(found)
    # Columns without a number stand in order on the floors that no number says; a roof above all others.
    named = {each.floor for each in found if each.role == "floor"}
    free = iter(sorted(set(range(1, len(found) + max({0, *named}) + 1)) - named))
    result = []
    for each in sorted(found, key=lambda each: bool(each.floor < 0 and ROOF.search(each.column))):
        floor = each.floor
        if each.role == "floor" and floor < 0:
            floor = next(free) if not ROOF.search(each.column) else max({0, *named}) + 1
            named.add(floor)
        result.append(dataclasses.replace(each, floor=floor))
    return sorted(result, key=lambda each: names.index(each.column))


def _as_in_japan(found: Sequence[Guess]) -> list[Guess]:
    """Count 2F as the first floor above ground where 1F or a basement stands for the ground, and no other column."""
    called = [NTH_FLOOR.search(BRACKETED.sub("", each.column)) if each.role == "floor" else None for each in found]
    numbers = [int(each[1] or each[2]) if each else 0 for each in called]
    basement = [bool(each.role == "ground" and BASEMENT.search(each.column)) for each in found]
    grounds = [each for each in found if each.role == "ground"]
    roof = any(ROOF.search(each.column) for each in found)
    at_ground = numbers.count(1) == 1 and roof and not grounds
    if not any(numbers) or not (at_ground or (len(grounds) == 1 and any(basement) and 1 not in numbers)):
        why = "; {} where 1F is at the ground, as in Japan"
        pairs = zip(found, numbers, strict=True)
        return [dataclasses.replace(each, why=why.format(n - 1)) if n > 1 else each for each, n in pairs]
    return [
        each if not number
        else dataclasses.replace(each, role="ground", floor=0, why=" (1F, as in Japan; 1 where it is above ground)")
        if number == 1
        else dataclasses.replace(each, floor=number - 1, why=f", counted as in Japan; {number} if 1F is above ground")
        for each, number in zip(found, numbers, strict=True)
    ]  # fmt: skip


def _channel(guess: Guess, hit: int, *, several: bool) -> str:
    lines = ["", "[[channel]]", toml_line("column", guess.column)]
    if guess.role == "force":
        sure = "from the name" if guess.sure and guess.floor > 0 else "as the top, no name says where the force acts"
        lines += [f"floor = {hit}  # GUESSED {sure}: CHECK", 'quantity = "force"  # GUESSED from the header']
    elif guess.role == "ground":
        lines.append(f"floor = 0  # GUESSED from the name: the ground{guess.why}")
    else:
        roof = "name: above the others" if ROOF.search(guess.column) else "order of the columns"
        lines.append(f"floor = {guess.floor}  # GUESSED from the {'name' if guess.sure else roof}{guess.why}")
    if guess.unit is not None:
        lines.append(f'unit = "{guess.unit}"  # GUESSED from the header')
    else:
        usual = "N" if guess.role == "force" else "m/s2"
        said = f"; the file says {printable(guess.said)!r}" if guess.said else ""
        known = ", ".join(list(CHANNEL_UNITS)[:7])
        lines.append(f'# unit = "g"  # FILL IN where it is not {usual}{said}: {known}, ...')
    if several and guess.role != "force":
        lines.append(f'axis = "{guess.axis}"  # GUESSED from the name')
    lines.append("# sign = -1  # where the sensor points the other way; calibration = 1.0: a factor on the column")
    return "\n".join(lines) + "\n"
