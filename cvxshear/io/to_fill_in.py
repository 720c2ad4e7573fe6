"""Files to fill in: a measurement file with every key explained, and a record file begun from a logger's own file.

Their texts are in the folder `blank`. A record file marks the values that were guessed from names and numbers.
"""

import dataclasses
import os
import re
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np
import tomli_w

from cvxshear.io.columns import Columns
from cvxshear.io.csv import preamble_of
from cvxshear.io.formats import LIMIT, format_of, named_after, read_columns, read_modes_of
from cvxshear.io.guesses import (
    FORCE,
    HIT_FLOOR,
    NO_MOTION,
    RATE,
    RELEASE,
    ROOF,
    Guess,
    blank_text,
    guesses_of,
    said_unit,
    time_column,
)
from cvxshear.io.record_file import FREQUENCY_NAMES
from cvxshear.records.data_frames import TIME_UNITS, UNEVEN_STEP, sampling_rate_of
from cvxshear.util import checks
from cvxshear.util.checks import MOST_STORIES
from cvxshear.util.errors import InputError, printable
from cvxshear.util.quantities import CHANNEL_UNITS, counted
from cvxshear.util.typing import Floats
from cvxshear.util.writing import escaped

MASS, STIFFNESS, PULL = 10.0, 10e3, 100.0
"""Floor mass (kg) and story stiffness (N/m) of the example frame, and a pull at its top (N)."""

TOTAL = "total_mass = {total}  # kg, all floors without added mass; not needed with two different added masses"
"""The line that a new file has where its modes are made up."""

TO_FILL_IN = """\
total_mass = 1.0  # kg, all floors without added mass: FILL IN, or give two configurations with different added masses;
# {file} does not tell how heavy the frame is, and with 1 kg masses and stiffnesses come out per kilogram of it"""

CARRIED = "# total_mass is not needed: the shapes carry the scale, 1/sqrt(kg)"


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
    checks.whole(stories, "stories", least=1, most=MOST_STORIES)
    # Modes of equal floors of 10 kg on equal stories of 10 kN/m: sine waves, in closed form.
    angle = (2 * np.arange(1, stories + 1) - 1) * np.pi / (2 * stories + 1)
    shapes = np.sin(np.outer(angle, np.arange(1, stories + 1)))
    frequencies = np.sqrt(STIFFNESS / MASS) * 2 * np.sin(angle / 2) / (2 * np.pi)
    lists = blank_text("modes.toml").format(
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
        # Omit the keys that the table itself has.
        text = text.replace(f"\n{given} =", f"\n# {given} =") if given in found else text
    return text


def toml_line(key: str, name: str) -> str:
    """Write a line of TOML that names a file, relative to the folder of the TOML file.

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
    return blank_text("measurement.toml").format(
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
    frequency = next((name for name in FREQUENCY_NAMES if name in columns.names), None)
    if frequency is not None:
        columns, time = _functions(columns, path), None
        rate = f"{toml_line('frequency', frequency)}  # GUESSED from the name"
    else:
        time = time_column(columns)
        rate = _rate(columns, time, _preamble(path))
    guesses = guesses_of(columns, [name for name in columns.names if name != time])
    if not guesses:
        raise InputError(f"{path} has no column of numbers besides the time; is it a record?")
    roles = {each.role for each in guesses}
    kind, why = (
        ("frf", "the column of frequencies") if frequency is not None
        else ("force", "a column that looks like a force") if "force" in roles
        else ("base", "a column that looks like the ground") if "ground" in roles
        else ("free_decay", "the name of the file") if RELEASE.search(path.stem)
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
        name=toml_line("x", _common_name([path, *others]))[4:], kind=given, rate=rate,
        source="" if files else toml_line("file", os.path.relpath(path, folder)) + "\n",
        channels="".join((*(_channel(each, hit, several=several) for each in guesses), *left)),
        runs=_runs(files, folder, kind, hit, top) if files else "",
    )  # fmt: skip


def _functions(columns: Columns, path: Path) -> Columns:
    """Keep of a file of functions one column for each pair of real and imaginary parts, called as a channel is."""
    kept = [i for i, name in enumerate(columns.names) if name.endswith("_re") and f"{name[:-3]}_im" in columns.names]
    if not kept:
        raise InputError(f"{path} has a column of frequencies, and no pair of columns such as floor1_re and floor1_im")
    names = tuple(columns.names[i].removesuffix("_re") for i in kept)
    units = tuple(columns.units[i] for i in kept) if columns.units else columns.units
    return dataclasses.replace(columns, names=names, values=columns.values[:, kept], units=units)


def _preamble(path: Path) -> str:
    return preamble_of(path, LIMIT) if (found := format_of(path)) is None or found.name in ("csv", "gz") else ""


def _common_name(files: Sequence[Path]) -> str:
    """Name a record after what the names of its files have in common, without a part of a word or a number."""
    names = [named_after(each) for each in files]
    common = "".join(letters[0] for letters in takewhile(lambda each: len(set(each)) == 1, zip(*names, strict=False)))
    if len(files) > 1:
        common = re.sub(r"[\W_]+$", "", re.sub(r"(?<=[\W_])[^\W_]*$", "", common).rstrip("0123456789"))
    return common or names[0]


def _runs(files: Sequence[Path], folder: str | Path, kind: str, hit: int, top: int) -> str:
    """Write a table for each file of a record."""
    written = []
    for place, each in enumerate(files, 1):
        written += ["", "[[run]]", toml_line("file", os.path.relpath(each, folder))]
        if kind in ("force", "frf"):
            # A hammer record has several hits at a floor. With one file of functions for each floor, each file has the
            # force at its floor.
            unsaid = (
                (place, "from the order of the files")
                if (kind, len(files)) == ("frf", top)
                else (hit, "no file says it")
            )
            floor, why = _hit_floor(each, top) or unsaid
            written.append(f"input_floor = {floor}  # GUESSED, {why}: the floor that was hit in this file: CHECK")
    return "\n".join(written) + "\n"


def _hit_floor(path: Path, top: int) -> tuple[int, str] | None:
    """Find the floor that was hit in the name of a file, or in a line of its preamble that speaks of a force."""
    force_lines = [line for line in _preamble(path).splitlines() if FORCE.search(line)]
    for text, why in ((path.stem, "from its name"), *((line, "from its preamble") for line in force_lines)):
        found = HIT_FLOOR.search(text)
        if found is not None and 0 < int(found[1] or found[2]) <= top:
            return int(found[1] or found[2]), why
    return None


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
