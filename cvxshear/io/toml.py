"""The measurement file: an experiment as TOML, read and written."""

import os
import re
import textwrap
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from cvxshear.effects import catalogue
from cvxshear.io.formats import FORMATS, LARGEST_FILE, format_of, named_after, read_bytes, refuse_data
from cvxshear.io.spreadsheets import read_repeats
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import checks
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.errors import InputError, printable
from cvxshear.util.writing import escaped, rows_in_lines, write_file

#: Measured frames in the package: tables of modes, each with its source.
MEASURED_FRAMES = (
    "los-alamos", "mini-flexible-northridge", "mini-flexible-sine", "mini-stiff-northridge", "mini-stiff-sine",
    "southampton", "e-defense", "iasc-asce-x", "iasc-asce-y", "ucl-loosened-joints",
)  # fmt: skip

#: Examples in the package, with their paths.
BUILT_IN = {"paper": ("paper", "paper.toml"), **{name: ("builtin", f"{name}.toml") for name in MEASURED_FRAMES}}

#: A line that begins a table; no line of samples does.
_HEADING = re.compile(r"^[ \t]*\[", re.MULTILINE)


@usual_arithmetic
def load(path: str | Path) -> Experiment:
    """Read a measurement file.

    Parameters
    ----------
    path : str or Path
        A TOML file, or a built-in example: "paper", the published two-story test frame in three configurations;
        "los-alamos", the published frequencies of a three-story structure in nine states; or another of the measured
        frames in `cvxshear.io.toml.MEASURED_FRAMES`. A file of such a name in the current folder is reached as
        "./paper", or as a Path.

    Returns
    -------
    Experiment

    Raises
    ------
    InputError
        The message names the file, the key, the value found and the expected input.
    """
    if is_built_in(path):
        return Experiment.from_dict(tomllib.loads(built_in_text(str(path))), name=str(path))
    if not isinstance(path, str | os.PathLike):
        raise InputError(
            f"load takes the name of a measurement file, not {checks.shown(path)}; a dict goes to Experiment.from_dict"
        )
    path = Path(path)
    declared = read_tables(path)
    if "record" in declared:
        raise InputError(
            f"{path} is a record file (it has a table [record]), not a measurement file: "
            f"'cvxshear modes {path} -o test.toml' makes one of it, and 'cvxshear loop {path}' takes it as it is"
        )
    with checks.named(str(path)):
        experiment = Experiment.from_dict(with_modes_read(declared, path.parent), name=named_after(path))
        known = {effect.name: effect for effect in catalogue()}
        for each in experiment.expected:
            effect = known[checks.choice(each.name, list(known), "effect: name")]
            places = [] if effect.unavailable(experiment) else effect.places(experiment)
            if places and not any(each.concerns(each.name, vars(place)) for place in places):
                said = {key: getattr(each, key) for key in ("floor", "to", "story", "state")}
                given = ", ".join(f"{key} = {value}" for key, value in said.items() if value is not None)
                nearest = max(places, key=lambda place: sum(getattr(place, key) == said[key] for key in said))
                there = nearest.describe() or "the whole frame"
                raise InputError(f"effect {each.name}: {given} is no place of it; one is: {there}")
    return experiment


def read_tables(path: Path) -> dict[str, object]:
    """Read the tables of a TOML file, and refuse a file of samples."""
    refuse_data(path)
    return parse(read_text(path), path)


def is_built_in(path: object) -> bool:
    """Return whether this is the name of an example in the package."""
    return isinstance(path, str) and path in BUILT_IN


def built_in_text(name: str) -> str:
    """Read the text of an example in the package."""
    return resources.files("cvxshear").joinpath(*BUILT_IN[name]).read_text(encoding="utf-8")


def read_text(path: Path) -> str:
    """Read the text of a file that a user named."""
    *most, last = BUILT_IN
    absent = f"the built-in examples are called {', '.join(most)} and {last}"
    content = read_bytes(path, LARGEST_FILE, "too many for a measurement file", absent=absent)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        refuse_data(path, toml=False)
        raise InputError(f"{path} is not UTF-8 text (byte {error.start}); is it a TOML file, saved as UTF-8?") from None


def parse(text: str, path: Path) -> dict[str, object]:
    """Parse the tables of a TOML text."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        if not _HEADING.search(text):
            refuse_data(path, toml=False)
        raise InputError(f"{path} is not valid TOML: {error}") from None


def is_record_file(path: str | Path) -> bool:
    """Return whether a TOML file is a record file (it has a table [record]) and not a measurement file.

    Parameters
    ----------
    path : str or Path
        Or the name of a built-in example, as in `load`.

    Raises
    ------
    InputError
        If the file cannot be read or is not TOML.
    """
    return not is_built_in(path) and "record" in read_tables(Path(path))


def files_of(path: str | Path) -> tuple[Path, ...]:
    """List the files that a measurement or a record file is made of: itself, and those that its tables name.

    Parameters
    ----------
    path : str or Path
        Or the name of a built-in example, made of none. A result's JSON names no other file.

    Raises
    ------
    InputError
        If the file cannot be read or is not TOML.
    """
    if is_built_in(path):
        return ()
    path = Path(path)
    try:
        declared = parse(read_text(path), path)
    except InputError:
        # A result's JSON names no other file, nor does a file of samples, which the command will refuse.
        if path.suffix.lower() != ".json" and format_of(path) is None:
            raise
        return (path,)
    tables: list[object] = []
    for value in declared.values():
        tables += value if isinstance(value, list) else [value]
    keys = ("file", "repeats", *(each.name for each in FORMATS if each.modes is not None))
    named = [each.get(key) for each in tables if isinstance(each, dict) for key in keys]
    return (path, *(path.parent / name for name in named if isinstance(name, str)))


def with_modes_read(declared: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the tables of a measurement file, with the modes of the files that its configurations name.

    Parameters
    ----------
    declared : dict
    folder : Path
        Folder of the files.

    Returns
    -------
    dict
        What a configuration says itself goes before what its file says.

    Raises
    ------
    InputError
        The message names the configuration, and what is wrong with its file.
    """
    tables = declared.get("configuration")
    if not isinstance(tables, list):
        return dict(declared)
    return {**declared, "configuration": [_resolved(table, place, folder) for place, table in enumerate(tables, 1)]}


def _resolved(table: object, place: int, folder: Path) -> object:
    readers = {each.name: each.read_modes for each in FORMATS if each.modes is not None} | {"repeats": read_repeats}
    if not isinstance(table, Mapping) or isinstance(table.get("repeats"), Mapping):
        return table
    if not (named := [key for key in readers if key in table]):
        return table
    where = f"configuration {place}"
    replaced = ("frequencies",) if named == ["repeats"] else ("frequencies", "mode_shapes")
    said = [*named, *(key for key in replaced if key in table)]
    if len(said) > 1:
        raise InputError(f"{where}: {' and '.join(said)} all say what the modes are; give one")
    key = named[0]
    file = folder / checks.text(table[key], f"{where}: {key}")
    return {**readers[key](file), **{name: value for name, value in table.items() if name != key}}


#: Significant digits of written numbers; no record has more.
WRITTEN_DIGITS = 8


def write_measurement(path: str | Path, declared: Mapping[str, Any], comments: Iterable[str] = ()) -> None:
    """Write a dict of the measurement file's shape as TOML.

    Parameters
    ----------
    path : str or Path
        Replaced where it exists, and only once the whole file has been written.
    declared : dict
        Tables, lists of tables, and in them texts, numbers, flags and lists of numbers.
    comments : iterable of str, optional
        Lines for the head of the file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    head = [
        # A line break in a comment must not end it.
        f"# {line}\n"
        for comment in comments
        for line in textwrap.wrap(
            printable(" ".join(comment.split())), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
    ]  # fmt: skip
    text = rows_in_lines(escaped(tomli_w.dumps(_plain(declared))))
    write_file(path, "".join([*head, "\n" * bool(head), text]))


def _plain(value: Any) -> Any:
    """Convert the value to Python's own types, numbers rounded."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return float(f"{value:.{WRITTEN_DIGITS}g}") if isinstance(value, float) else value
