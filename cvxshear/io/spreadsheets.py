"""Tables of spreadsheet programs: cells are written as CSV or as a workbook, workbooks and tables of modes are read.

A table of modes, in place of lists in a measurement file, has one row a mode and a header that names its columns:

    mode; frequency, Hz; damping; frequency std, Hz; floor 1; floor 2; floor 3; floor 1 std; ...

Deviations without a unit are relative: "frequency std" to the frequency, "floor 1 std" to the mode's largest entry.
Only the frequency and one floor at least must be there; an empty cell of a shape is an entry that was not measured.
Shapes that carry the scale say so by their unit, "floor 1, 1/sqrt(kg)".
"""

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cvxshear.io.csv import Columns, columns_of, read_csv
from cvxshear.io.formats import LARGEST_FILE, TOO_LARGE, read_bytes, reading
from cvxshear.util.errors import InputError, optional, printable
from cvxshear.util.typing import Json
from cvxshear.util.writing import cell_text, write_file

Cell = str | float | int | None

#: Largest length of the title of a sheet, letters: Excel takes 31, and openpyxl numbers titles that come twice.
LONGEST_TITLE = 28

#: Largest length of a cell, letters (Excel).
LONGEST_CELL = 32_767

#: Title that Excel reserves.
RESERVED = "history"

TOO_LARGE_TABLE = "too many for a table of modes; is it a record?"
#: Key of deviations in Hz; those of a configuration are relative to the frequencies.
ABSOLUTE = "frequency_std, Hz"
#: Header texts, in lower case without punctuation, and the keys of a configuration that they fill.
COLUMNS = {
    "mode": "modes", "frequency": "frequencies", "frequency hz": "frequencies", "f": "frequencies",
    "f hz": "frequencies", "frequency std": "frequency_std", "frequency std hz": ABSOLUTE, "damping": "damping_ratios",
    "damping ratio": "damping_ratios",
}  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """One table.

    Parameters
    ----------
    title : str
    header : tuple of str
    rows : list of tuple
        None and nan give an empty cell.
    """

    title: str
    header: tuple[str, ...]
    rows: list[tuple[Cell, ...]]


def write_csv(path: str | Path, sheets: Sequence[Sheet]) -> None:
    """Write the first table, or all tables with its header; the rows of several tables begin with their titles.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    alike = [sheet for sheet in sheets if sheet.header == sheets[0].header]
    if len(alike) > 1:
        rows = [(sheet.title, *row) for sheet in alike for row in sheet.rows]
        write_file(path, csv_text(("configuration", *alike[0].header), rows))
    else:
        write_file(path, csv_text(sheets[0].header, sheets[0].rows))


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """Write a table as comma-separated text, numbers to their last digit."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([_plain(cell) for cell in row] for row in (header, *rows))
    return text.getvalue()


def write_xlsx(path: str | Path, sheets: Sequence[Sheet]) -> None:
    """Write every table to a sheet of its own.

    Raises
    ------
    InputError
        If openpyxl (the extra `xlsx`) is not installed, or the file cannot be written.
    """
    write_file(path, workbook(sheets))


def workbook(sheets: Iterable[Sheet]) -> bytes:
    """Write the content of a workbook, each table on a sheet of its own.

    Raises
    ------
    InputError
        If openpyxl (the extra `xlsx`) is not installed.
    """
    book = load_openpyxl().Workbook()
    book.remove(book.active)
    for sheet in sheets:
        page = book.create_sheet(_title(sheet.title))
        for row in (sheet.header, *sheet.rows):
            page.append(tuple(map(_plain, row)))
        for cell in next(page.rows, ()):
            page.column_dimensions[cell.column_letter].width = len(str(cell.value)) + 2
        page.freeze_panes = "A2"
    content = io.BytesIO()
    book.save(content)
    return content.getvalue()


def read_xlsx(path: str | Path, limit: float, remedy: str = TOO_LARGE, words: Sequence[str] | None = None) -> Columns:
    """Read the columns of a workbook's first sheet, with a preamble, units and stamps as in delimited text.

    Parameters
    ----------
    path : str or Path
    limit : float
        Bytes, as for `read_csv`.
    remedy, words : optional
        As for `read_csv`.

    Raises
    ------
    InputError
        If openpyxl (the extra `xlsx`) is not installed, or the file is no workbook or too large.
    """
    openpyxl = load_openpyxl()
    content = io.BytesIO(read_bytes(Path(path), limit, remedy))
    with reading(path, "a workbook"):
        book = openpyxl.load_workbook(content, read_only=True, data_only=True)
        rows = ["\t".join(map(_as_text, row)) for row in book.worksheets[0].iter_rows(values_only=True)]
    return columns_of(rows, str(path), words)


def _as_text(cell: object) -> str:
    if isinstance(cell, datetime):
        return cell.isoformat(sep=" ")
    if isinstance(cell, str):
        return " ".join(cell.replace('"', " ").split())
    return "" if cell is None else str(cell)


def load_openpyxl() -> Any:
    """Import the package that reads and writes workbooks.

    Raises
    ------
    InputError
        If it is not installed.
    """
    return optional("openpyxl", "workbooks need")


def _title(name: str) -> str:
    """Remove forbidden characters from the title of a sheet."""
    plain = re.sub(r"[\\/*?:\[\]]", " ", printable(name))[:LONGEST_TITLE].strip(" '") or "sheet"
    return f"{plain} 2" if plain.lower() == RESERVED else plain


def _plain(cell: Cell) -> Cell:
    if isinstance(cell, str):
        return cell_text(cell)[:LONGEST_CELL]
    return None if cell is None or (isinstance(cell, float) and not math.isfinite(cell)) else cell


def read_mode_csv(path: str | Path) -> Json:
    """Read the modes of a table in a CSV file.

    Parameters
    ----------
    path : str or Path
        Separators, decimal commas and comments as in `read_csv`.

    Returns
    -------
    dict
        Keys of a table [[configuration]].

    Raises
    ------
    InputError
        The message names the file, the line and the column.
    """
    return _modes_of(read_csv(path, LARGEST_FILE, TOO_LARGE_TABLE, words=()))


def read_mode_xlsx(path: str | Path) -> Json:
    """Read the modes of a table on the first sheet of a workbook, as `read_mode_csv` does."""
    return _modes_of(read_xlsx(path, LARGEST_FILE, TOO_LARGE_TABLE, words=()))


def _modes_of(columns: Columns) -> Json:
    """Return the keys of a configuration that a table holds; empty lines at its end do not count."""
    filled = np.flatnonzero(np.isfinite(columns.values).any(axis=1))
    columns = columns.rows(slice(int(np.max(filled, initial=-1)) + 1))
    source, values = columns.source, columns.values
    found = _places(columns, _mode_key, "a table of modes: mode, frequency, frequency std, damping, floor 1, ...")
    places = {key: place for (key, floor, _), place in found.items() if floor == 0}
    entries, stds = (
        {floor: place for (key, floor, _), place in found.items() if key == what} for what in ("entry", "std")
    )
    units = {(key, unit) for key, floor, unit in found if floor}
    if "frequencies" not in places or not entries:
        raise InputError(f'{source} needs a column "frequency" and one "floor 1", "floor 2", ... a measured floor')
    if len(units) > len({key for key, _ in units}):
        raise InputError(f"{source}: some floors are in 1/sqrt(kg), others have no unit; give all of them the same")
    floors = sorted(entries)
    shapes = values[:, [entries[floor] for floor in floors]]
    result: Json = {"measured_floors": floors, "mode_shapes": shapes.tolist()}
    if ("entry", True) in units:
        result["mass_normalized"] = True
    if stds:
        if lacking := sorted(set(entries) - set(stds)):
            raise InputError(f"{source} has no std for floor {lacking[0]}, and one for others; give each one, or none")
        # Deviations without a unit are relative to the mode's largest entry.
        largest = np.nanmax(np.abs(shapes), axis=1, keepdims=True) if ("std", True) in units else 1.0
        result["mode_shape_std"] = (values[:, [stds[floor] for floor in floors]] / largest).tolist()
    for key, place in places.items():
        column = values[:, place]
        # A mode does not need a damping ratio.
        if key != "damping_ratios" or np.all(np.isnan(column)):
            _refuse_empty(columns, place)
        result[key] = column.astype(int).tolist() if key == "modes" else column.tolist()
    if ABSOLUTE in result:
        result["frequency_std"] = (np.array(result.pop(ABSOLUTE)) / result["frequencies"]).tolist()
    return result


def _refuse_empty(columns: Columns, place: int) -> None:
    if (missing := np.flatnonzero(np.isnan(columns.values[:, place]))).size:
        where = f'{columns.at(int(missing[0]))}: column "{columns.names[place]}"'
        raise InputError(f"{where} is empty; fill it in, or leave the line out")


Key = TypeVar("Key")


def _places(columns: Columns, key_of: Callable[[str], Key | None], known: str) -> dict[Key, int]:
    """Find the place of each column by the key of its name, in lower case without punctuation."""
    places: dict[Key, int] = {}
    for place, name in enumerate(columns.names):
        key = key_of(" ".join(re.sub(r"[^a-z0-9%]+", " ", name.lower()).split()))
        if key is None:
            raise InputError(f'{columns.source}: column "{name[:60]}" is not one of {known}')
        if key in places:
            raise InputError(f'{columns.source}: the column "{name}" is there twice')
        places[key] = place
    return places


def _mode_key(name: str) -> tuple[str, int, bool] | None:
    """Return the key of a configuration, or "entry" or "std" with the floor and whether the unit is 1/sqrt(kg)."""
    if floor := re.fullmatch(r"floor ?([1-9]\d*)( std)?( 1 (?:sqrt )?kg)?", name):
        return "std" if floor[2] else "entry", int(floor[1]), floor[3] is not None
    return (COLUMNS[name], 0, False) if name in COLUMNS else None


#: Header of a column of repeated tests: the frequency of a mode, or the entry of a mode's shape at a floor.
REPEATED = re.compile(r"(?:(?:frequency|f) ?([1-9]\d*)(?: hz)?|shape ?([1-9]\d*) ([1-9]\d*))")


def _test_key(name: str) -> tuple[int, int] | None:
    """Return the mode, with the floor of a shape's entry or 0 for a frequency; (0, 0) for the block."""
    if not (found := REPEATED.fullmatch(name)):
        return (0, 0) if name == "block" else None
    return (int(found[1]), 0) if found[1] else (int(found[2]), int(found[3]))


def read_repeats(path: str | Path) -> Json:
    """Read repeated tests from a table: a row a test, columns "frequency 1", ..., "shape 1 3" (mode, floor), "block".

    Parameters
    ----------
    path : str or Path
        Separators and comments as in `read_mode_csv`.

    Returns
    -------
    dict
        Keys of a table [[configuration]]: repeats, modes and, with shapes, measured_floors.

    Raises
    ------
    InputError
        The message names the file, the line and the column.
    """
    columns = read_csv(path, LARGEST_FILE, TOO_LARGE_TABLE, words=("block",))
    places = _places(columns, _test_key, 'repeated tests: "frequency 1", ..., "shape 1 3" (mode, floor), "block"')
    at_block = places.pop((0, 0), None)
    modes, floors = (sorted({key[at] for key in places if bool(key[1]) == bool(at)}) for at in (0, 1))
    if not modes or any(mode not in modes for mode, _ in places):
        raise InputError(f'{path!s} needs a column "frequency 1", "frequency 2", ... for each mode')
    for mode in modes:
        _refuse_empty(columns, places[mode, 0])
    values = np.pad(columns.values, ((0, 0), (0, 1)), constant_values=np.nan)
    repeats: Json = {"frequencies": values[:, [places[mode, 0] for mode in modes]].tolist()}
    result: Json = {"repeats": repeats, "modes": modes}
    if floors:
        entries = [[places.get((mode, floor), -1) for floor in floors] for mode in modes]
        repeats["mode_shapes"], result["measured_floors"] = values[:, entries].tolist(), floors
    if at_block is not None:
        repeats["block"] = columns.words[columns.names[at_block]]
    return result
