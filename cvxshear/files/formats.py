"""The table of formats: which endings a kind of file has, what it is called, and what reads it.

A format of one's own is one more line of it: `register(Format(...))`. It is then taken by record files, by the key of
its name in a measurement file, and by `cvxshear new`, whose help lists it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cvxshear.files.columns import Columns
from cvxshear.files.csv import read_csv
from cvxshear.files.mat import read_mat
from cvxshear.files.mode_tables import read_mode_csv, read_mode_uff, read_mode_xlsx
from cvxshear.files.npz import read_npz
from cvxshear.files.spreadsheets import read_xlsx
from cvxshear.files.uff import read_uff
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import listed

ANY_TEXT = (".txt", ".dat", ".asc")
"""Endings that tell nothing of what a text holds."""


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Parameters
    ----------
    name : str
        The key of a [[configuration]] that names such a file, where it holds modes.
    endings : tuple of str
        In small letters, with the dot; the first is the usual one.
    words : str
        What such a file is called: "a workbook".
    columns : callable, optional
        (path, limit in bytes) to `Columns`: what reads time histories and frequency response functions from it.
    modes : callable, optional
        (path) to the keys of a table [[configuration]]: what reads modes from it.
    """

    name: str
    endings: tuple[str, ...]
    words: str
    columns: Callable[[Path, float], Columns] | None = None
    modes: Callable[[str | Path], dict[str, Any]] | None = None


FORMATS: list[Format] = [
    Format("csv", (".csv", ".txt", ".dat", ".tsv", ".asc"), "delimited text", read_csv, read_mode_csv),
    Format("gz", (".csv.gz", ".txt.gz", ".tsv.gz"), "delimited text compressed by gzip", read_csv),
    Format("xlsx", (".xlsx",), "a workbook", read_xlsx, read_mode_xlsx),
    Format("mat", (".mat",), "a MAT file", read_mat),
    Format("npz", (".npz", ".npy"), "arrays of NumPy", read_npz),
    Format("uff", (".uff", ".unv", ".u58", ".u55"), "a universal file", lambda path, limit: read_uff(path, limit)[0],
           read_mode_uff),
]  # fmt: skip
"""Every kind of file that is read, in the order in which messages and help list them."""


def register(added: Format) -> None:
    """Add a format; one of the same name is replaced.

    Raises
    ------
    InputError
        Where an ending is another format's.
    """
    for other in FORMATS:
        shared = set(other.endings) & set(added.endings)
        if shared and other.name != added.name:
            raise InputError(f"the ending {min(shared)} is that of {other.words} already")
    FORMATS[:] = [each for each in FORMATS if each.name != added.name] + [added]


def format_of(path: str | Path) -> Format | None:
    """The format that a file's ending tells; None where it tells none."""
    name = Path(path).name.lower()
    return next((each for each in FORMATS if any(name.endswith(ending) for ending in each.endings)), None)


def endings_of(reader: str) -> str:
    """The usual endings of the formats that have a reader, for messages and help: ".csv, .xlsx or .uff".

    Parameters
    ----------
    reader : str
        "columns" or "modes".
    """
    return listed([each.endings[0] for each in FORMATS if getattr(each, reader) is not None], "or")


def read_columns(path: Path, limit: float) -> Columns:
    """The columns of a file of samples; one whose ending is none of the table's is read as delimited text.

    Raises
    ------
    InputError
        Where the file cannot be read.
    """
    found = format_of(path)
    return (read_csv if found is None or found.columns is None else found.columns)(path, limit)


def read_modes_of(path: str | Path) -> tuple[str, dict[str, Any]]:
    """The key that names a file of modes, and the keys of a table [[configuration]] that it holds.

    Raises
    ------
    InputError
        Where such files hold no modes, or this one cannot be read.
    """
    found = format_of(path)
    if found is None or found.modes is None:
        raise InputError(f"{path!s}: modes are read from files that end in {endings_of('modes')}")
    return found.name, found.modes(path)


def refuse_data(path: Path) -> None:
    """Refuse a file of samples in place of the record file that says what they are of.

    Raises
    ------
    InputError
        Saying how to begin a record file.
    """
    found = format_of(path)
    # TOML may stand in any .txt, and is found there.
    if found is not None and found.columns is not None and path.suffix.lower() not in ANY_TEXT:
        raise InputError(
            f"{path} is {found.words}, which does not say which column is which floor: 'cvxshear new --record {path} "
            f"-o {path.name.split('.')[0]}.toml' writes a record file with the columns that it finds, to fill in, and "
            "that is what the command takes"
        )


def with_modes_read(declared: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The tables of a measurement file, the files that its configurations name read.

    Parameters
    ----------
    declared : dict
    folder : Path
        Where the files are looked for.

    Returns
    -------
    dict
        What a configuration says itself goes before what its file says.

    Raises
    ------
    InputError
        Naming the configuration, and what is wrong with its file.
    """
    tables = declared.get("configuration")
    if not isinstance(tables, list):
        return dict(declared)
    return {**declared, "configuration": [_resolved(table, place, folder) for place, table in enumerate(tables, 1)]}


def naming_keys() -> Iterator[str]:
    """Keys of tables whose values are names of other files."""
    yield "file"
    yield from (each.name for each in FORMATS if each.modes is not None)


def _resolved(table: object, place: int, folder: Path) -> object:
    readers = {each.name: each.modes for each in FORMATS if each.modes is not None}
    named = [key for key in readers if isinstance(table, Mapping) and key in table]
    if not named or not isinstance(table, Mapping):
        return table
    where = f"configuration {place}"
    said = [*named, *(key for key in ("frequencies", "mode_shapes") if key in table)]
    if len(said) > 1:
        raise InputError(f"{where}: {' and '.join(said)} all say what the modes are; give one")
    key = named[0]
    file = folder / checks.text(table[key], f"{where}: {key}")
    return {**readers[key](file), **{name: value for name, value in table.items() if name != key}}
