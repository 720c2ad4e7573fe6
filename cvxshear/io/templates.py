"""Files to fill in: a measurement file with every key explained, and a record file begun from a logger's own file.

Their texts are in the folder `blank`. A record file marks the values that were guessed from the names, the units and
the numbers of columns.
"""

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
import tomli_w

from cvxshear.io.csv import Columns
from cvxshear.io.formats import LIMIT, named_after, read_columns, read_modes_of
from cvxshear.io.record_tables import FREQUENCY_NAMES
from cvxshear.records.data_frames import TIME_UNITS, UNEVEN_STEP, sampling_rate_of
from cvxshear.util import checks
from cvxshear.util.errors import InputError, printable
from cvxshear.util.quantities import CHANNEL_UNITS, STANDARD_GRAVITY, counted
from cvxshear.util.typing import Floats
from cvxshear.util.writing import escaped

#: Floor mass (kg) and story stiffness (N/m) of the example frame; the weight of a floor pulls at its top.
MASS, STIFFNESS = 10.0, 10e3


def blank_text(name: str) -> str:
    """Read a text of the folder `blank`."""
    return resources.files("cvxshear.io").joinpath("blank", name).read_text(encoding="utf-8")


def template(stories: int = 3) -> str:
    """Write a measurement file of a frame of equal stories, with every key explained.

    Optional keys are comments.

    Parameters
    ----------
    stories : int, optional

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.
    """
    checks.whole(stories, "stories", least=1, most=checks.MOST_STORIES)
    # Modes of equal floors of 10 kg on equal stories of 10 kN/m: sine waves, in closed form.
    angle = (2 * np.arange(1, stories + 1) - 1) * np.pi / (2 * stories + 1)
    shapes = np.sin(np.outer(angle, np.arange(1, stories + 1)))
    frequencies = np.sqrt(STIFFNESS / MASS) * 2 * np.sin(angle / 2) / (2 * np.pi)
    lists = blank_text("modes.toml").format(
        floors=_listed(np.arange(1, stories + 1), "d"),
        frequencies=_listed(frequencies, ".4f"),
        rows="\n".join(f"    {_listed(shape, '.4f')}," for shape in shapes / abs(shapes).max(axis=1, keepdims=True)),
    )
    return _filled(lists, stories, _WORDS["total"]["example"])


def template_from(modes: str | Path, folder: str | Path = ".") -> str:
    """Write a measurement file whose modes are read from a table or a universal file.

    Parameters
    ----------
    modes : str or Path
        Of one of the formats in `files.formats.FORMATS` that hold modes.
    folder : str or Path, optional
        Folder of the measurement file, which the name of the other file is relative to.

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    key, found = read_modes_of(modes)
    named = toml_line(key, os.path.relpath(modes, folder))
    total = _WORDS["total"]["carried" if found.get("mass_normalized") else "to_fill_in"]
    total = total.replace("{file}", printable(Path(modes).name))
    text = _filled(f"{named}  # frequencies and mode shapes", max(found["measured_floors"]), total)
    for given in ("frequency_std", "mode_shape_std"):
        # Omit the keys that the table itself has.
        text = text.replace(f"\n{given} =", f"\n# {given} =") if given in found else text
    return text


def toml_line(key: str, name: str) -> str:
    """Write a line of TOML that names a file, relative to the folder of the TOML file.

    Raises
    ------
    InputError
        If the name has bytes that are no text, which TOML cannot hold.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{name}: a name that is no UTF-8 text cannot stand in TOML; rename the file") from None
    return escaped(tomli_w.dumps({key: name.replace(os.sep, "/")})).rstrip("\n")


def _filled(modes: str, stories: int, total: str) -> str:
    return blank_text("measurement.toml").format(
        stories=stories,
        total=total.replace("{total}", f"{MASS * stories:.1f}"),
        heights=_listed(np.full(stories, 3.0), ".1f"),
        masses=_listed(np.full(stories, MASS), ".1f"),
        added=_listed(np.zeros(stories), ".1f"),
        modes=modes,
        force=_listed(np.eye(stories)[-1] * MASS * STANDARD_GRAVITY, ".1f"),
        displacement=_listed(np.arange(1, stories + 1) * MASS * STANDARD_GRAVITY / STIFFNESS, ".3f"),
    )


def _listed(values: Floats | np.ndarray, shown: str) -> str:
    return "[" + ", ".join(format(value, shown) for value in values) + "]"


_WORDS = tomllib.loads(blank_text("words.toml"))
#: Patterns of columns, units and sampling rates in a preamble; comments in the file explain each, in this order.
TIME, GROUND, FORCE, ROOF, NO_MOTION, AXIS, BRACKETED, ENDING, RATE = (
    re.compile(pattern, re.IGNORECASE) for pattern in _WORDS["name"].values()
)

NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class Guess:
    """Guess for one column, from its name and its numbers.

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
        What else the floor follows from.
    """

    column: str
    unit: str | None
    role: str
    floor: int
    sure: bool
    axis: str
    said: str = ""
    why: str = ""


def time_column(columns: Columns) -> str | None:
    """Find the ascending column with a name of time, or else the first column if it ascends in even steps."""
    called = [name for name in columns.names if TIME.match(name.strip())]
    # Of a date and a time of the day the one that changes from sample to sample.
    steps_of = {name: _steps(columns, name) for name in (*called, *columns.names[:1])}
    for name, steps in sorted(
        steps_of.items(), key=lambda each: (each[0] not in called, -np.count_nonzero(each[1] > 0))
    ):
        usual = np.median(steps) if steps.size else 0.0
        if name in called:
            if steps.sum() > 0:
                return name
        # Steps of 1 count the samples.
        elif usual > 0 and usual != 1.0 and np.median(np.abs(steps - usual)) < UNEVEN_STEP * usual:
            return name
    return None


def _steps(columns: Columns, name: str) -> Floats:
    values = columns.values[:, columns.names.index(name)]
    return np.asarray(np.diff(values[np.isfinite(values)]))


def said_unit(columns: Columns, name: str) -> tuple[str, str]:
    """Find the unit in a line of units or in the header: its name in the library, and its spelling in the file."""
    said = columns.units[columns.names.index(name)] if columns.units else ""
    candidates = [said] if said else [found[1] or found[2] or "" for found in BRACKETED.finditer(name)]
    if not said and (found := ENDING.search(name)):
        candidates.append(re.sub(r"_?p?s2", "/s2", found[1]))
    known = [(unit, each) for each in candidates if (unit := _known_unit(each))]
    # "Level 3 N" is to the north: of a last word only a unit of acceleration is taken for one.
    last = name.rsplit(maxsplit=1)[-1] if " " in name.strip() else ""
    if not said and CHANNEL_UNITS.get(_known_unit(last), ("",))[0] == "acceleration":
        known.append((_known_unit(last), last))
    # "acc[1]" is the first column of a matrix.
    return known[-1] if known else ("", next((each for each in candidates if not each.isdigit()), ""))


def _known_unit(said: str) -> str:
    """Return the library's name of a unit; empty for an unknown unit."""
    plain = re.sub(r"[\s*^]", "", said.strip().replace("²", "2").replace("**", ""))
    known = {each.lower(): each for each in (*CHANNEL_UNITS, *TIME_UNITS)}
    lower = plain.lower()
    return str(_WORDS["unit"].get(lower, plain if plain in CHANNEL_UNITS else known.get(lower, "")))


def guesses_of(columns: Columns, names: Sequence[str]) -> list[Guess]:
    """Guess the quantity of each column; columns without numbers are left out."""
    found: list[Guess] = []
    for name in names:
        if NO_MOTION.search(name) or not np.isfinite(columns.values[:, columns.names.index(name)]).any():
            continue
        unit, said = said_unit(columns, name)
        known = unit in CHANNEL_UNITS
        bare = ENDING.sub("", BRACKETED.sub("", name))
        force = bool(FORCE.search(bare)) or (known and CHANNEL_UNITS[unit][0] == "force")
        ground = not force and bool(GROUND.search(bare.replace("_", " ")))
        number, axis = NUMBER.findall(bare), AXIS.search(bare)
        floor = 0 if ground else int(number[-1]) if number and 0 < int(number[-1]) < 200 else -1
        role = "force" if force else "ground" if ground else "floor"
        along = (axis[1] or axis[2]).lower() if axis else "x"
        found.append(Guess(name, unit if known else None, role, floor, floor >= 0, along, "" if known else said))
    # Columns without a number get the remaining floors, in order; a roof is above all others.
    named = {each.floor for each in found if each.role == "floor"}
    free = iter(sorted(set(range(1, len(found) + max({0, *named}) + 1)) - named))
    result = []
    for each in sorted(found, key=lambda each: bool(each.floor < 0 and ROOF.search(each.column))):
        floor, why = each.floor, ""
        if each.role == "floor" and floor < 0:
            floor = next(free) if not ROOF.search(each.column) else max({0, *named}) + 1
            if ROOF.search(each.column) and len(named) < floor - 1:
                why = ", as low as it can be: CHECK how many stories there are"
            named.add(floor)
        result.append(replace(each, floor=floor, why=why))
    return sorted(result, key=lambda each: names.index(each.column))


def record_template(data: str | Path | Sequence[str | Path], folder: str | Path = ".") -> str:
    """Write a record file for the samples in a logger's files, with a mark at every guess.

    Parameters
    ----------
    data : str or Path, or sequence of them
        Of one of the formats in `files.formats.FORMATS` that hold columns; several files, with the same columns, are
        the runs of one record: hits of a hammer, releases, or repetitions of one shaking.
    folder : str or Path, optional
        Folder of the record file, which the names of the other files are relative to.

    Returns
    -------
    str
        TOML. `read_record` takes it as it stands where the file shows its sampling rate.

    Raises
    ------
    InputError
        If a file cannot be read, holds no column of numbers besides time, or other columns than the first.
    """
    path, *others = [Path(data)] if isinstance(data, str | Path) else [Path(each) for each in data]
    columns: Columns = read_columns(path, LIMIT)
    for other in others:
        if missing := sorted(set(columns.names) - set(names := read_columns(other, LIMIT).names)):
            raise InputError(
                f'{other} has no column "{missing[0]}", which {path} has; it has {", ".join(names[:12])}. The files of '
                "one record have the same columns; begin a record file for each where they are records of their own"
            )
    frequency = next((name for name in FREQUENCY_NAMES if name in columns.names), None)
    if frequency is not None:
        columns, time = _functions(columns, path), None
        rate = f"{toml_line('frequency', frequency)}  # GUESSED from the name"
    else:
        time = time_column(columns)
        rate = _rate(columns, time)
    if not (guesses := guesses_of(columns, [name for name in columns.names if name != time])):
        raise InputError(f"{path} has no column of numbers besides the time; is it a record?")
    roles = {each.role for each in guesses}
    kind, why = (
        ("frf", "the column of frequencies") if frequency is not None
        else ("force", "a column that looks like a force") if "force" in roles
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
    given = (
        f'kind = "frf"  # GUESSED from {why}' if kind == "frf"
        else f'input = "{kind}"  # GUESSED from {why}: "base", "force", "free_decay", or "none" for ambient vibration'
    )  # fmt: skip
    files = [path, *others] if others or kind == "frf" else []
    return blank_text("record.toml").format(
        masses=", ".join(["0.0"] * top), stories=top + 1,
        file=printable(path.name) + (f" and {len(others)} more" if others else ""),
        name=toml_line("x", named_after(path))[4:], kind=given, rate=rate,
        source="" if files else toml_line("file", os.path.relpath(path, folder)) + "\n",
        channels="".join((*(_channel(each, hit, several=several) for each in guesses), *left)),
        runs=_runs(files, folder, kind, hit, top) if files else "",
    )  # fmt: skip


def _functions(columns: Columns, path: Path) -> Columns:
    """Keep one column for each pair of real and imaginary parts, with the name of the channel."""
    kept = [i for i, name in enumerate(columns.names) if name.endswith("_re") and f"{name[:-3]}_im" in columns.names]
    if not kept:
        raise InputError(f"{path} has a column of frequencies, and no pair of columns such as floor1_re and floor1_im")
    names = tuple(columns.names[i].removesuffix("_re") for i in kept)
    units = tuple(columns.units[i] for i in kept) if columns.units else columns.units
    return replace(columns, names=names, values=columns.values[:, kept], units=units)


def _runs(files: Sequence[Path], folder: str | Path, kind: str, hit: int, top: int) -> str:
    """Write a table for each file of a record."""
    written = []
    # With one file of functions for each floor, each file has the force at its floor.
    by_order = (kind, len(files)) == ("frf", top)
    for place, each in enumerate(files, 1):
        written += ["", "[[run]]", toml_line("file", os.path.relpath(each, folder))]
        if kind in ("force", "frf"):
            floor, why = (place, "from the order of the files") if by_order else (hit, "no file says it")
            written.append(f"input_floor = {floor}  # GUESSED, {why}: the floor that was hit in this file: CHECK")
    return "\n".join(written) + "\n"


def _rate(columns: Columns, time: str | None) -> str:
    """Write the lines about the sampling of the record."""
    if time is None and columns.stated_rate is not None:
        name, rate = columns.stated_rate
        return f"sampling_rate = {rate:.9g}  # Hz, GUESSED from {toml_line('x', name)[4:]} in the file"
    if time is None:
        if not (found := RATE.search(columns.preamble)):
            return "# sampling_rate = 100.0  # Hz: FILL IN, the file has no column of time"
        return f"sampling_rate = {float(found[1].replace(',', '.'))}  # Hz, GUESSED from {toml_line('x', found[0])[4:]}"
    unit = said_unit(columns, time)[0]
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


def _channel(guess: Guess, hit: int, *, several: bool) -> str:
    known = ", ".join(list(CHANNEL_UNITS)[:7])
    usual = "N" if guess.role == "force" else "m/s2"
    said = f"; the file says {printable(guess.said)!r}" if guess.said else ""
    named = "name" if guess.sure else "name: above the others" if ROOF.search(guess.column) else "order of the columns"
    floor = {
        "force": f"floor = {hit}  # GUESSED "
        + ("from the name" if guess.sure and guess.floor > 0 else "as the top, no name says where the force acts")
        + ': CHECK\nquantity = "force"  # GUESSED from the header',
        "ground": "floor = 0  # GUESSED from the name: the ground",
        "floor": f"floor = {guess.floor}  # GUESSED from the {named}{guess.why}",
    }
    return blank_text("channel.toml").format(
        column=toml_line("column", guess.column),
        floor=floor[guess.role],
        unit=f'# unit = "g"  # FILL IN where it is not {usual}{said}: {known}, ...' if guess.unit is None
        else f'unit = "{guess.unit}"  # GUESSED from the header',
        axis=f'axis = "{guess.axis}"  # GUESSED from the name\n' if several and guess.role != "force" else "",
    )  # fmt: skip
