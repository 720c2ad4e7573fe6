"""Modes from tables and files that other programs write, in place of lists in a measurement file.

A table has one row a mode and a header that names its columns:

    mode; frequency, Hz; damping; frequency std, Hz; floor 1; floor 2; floor 3; floor 1 std; ...

Deviations without a unit are relative: "frequency std" to the frequency, "floor 1 std" to the mode's largest entry.
Only the frequency and one floor at least must be there; an empty cell of a shape is an entry that was not measured.
Shapes that carry the scale say so by their unit, "floor 1, 1/sqrt(kg)".
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.io.csv import read_rows
from cvxshear.io.formats import LARGEST_FILE
from cvxshear.io.spreadsheets import read_xlsx_rows
from cvxshear.util import checks
from cvxshear.util.errors import InputError

TOO_LARGE_TABLE = "too many for a table of modes; is it a record?"
ABSOLUTE = "frequency_std, Hz"
"""Deviations of frequencies that a table gives in Hz; a configuration has them relative to the frequencies."""
COLUMNS = {
    "mode": "modes", "frequency": "frequencies", "frequency hz": "frequencies", "f": "frequencies",
    "f hz": "frequencies", "frequency std": "frequency_std", "frequency std hz": ABSOLUTE, "damping": "damping_ratios",
    "damping ratio": "damping_ratios",
}  # fmt: skip
"""Header texts, in lower case without punctuation, and the keys of a configuration that they fill."""

Cell = str | float | None
Rows = list[tuple[int, list[Cell]]]


def read_mode_csv(path: str | Path) -> dict[str, Any]:
    """Read the modes of a table in a CSV file.

    Parameters
    ----------
    path : str or Path
        Cells are separated by semicolons, tabs or commas: the first of these that the header has. With another
        separator than a comma, numbers may have a decimal comma. Lines that begin with # are comments.

    Returns
    -------
    dict
        Keys of a table [[configuration]].

    Raises
    ------
    InputError
        Naming the file, the line and the column.
    """
    rows: Rows = [(number, list(cells)) for number, cells in read_rows(path, LARGEST_FILE, TOO_LARGE_TABLE)]
    return _modes_of(rows, str(path))


def read_mode_xlsx(path: str | Path) -> dict[str, Any]:
    """Read the modes of a table on the first sheet of a workbook.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    dict
        Keys of a table [[configuration]].

    Raises
    ------
    InputError
        Naming the file, the row and the column; where openpyxl (the extra `xlsx`) is not installed.
    """
    rows: Rows = list(read_xlsx_rows(path, LARGEST_FILE, TOO_LARGE_TABLE))
    return _modes_of(rows, str(path))


def _modes_of(rows: Rows, source: str) -> dict[str, Any]:
    """Return the keys of a configuration that a table's rows hold, the header first."""
    if len(rows) < 2:
        raise InputError(f"{source} holds no modes: a header that names the columns, and a row a mode, are needed")
    header = [str(cell or "") for cell in rows[0][1]]
    keys, entries, stds, scaled, std_scaled = _columns(header, source)
    values = [[_number(cell, number, name, source) for cell, name in zip(row, header, strict=True)]
              for number, row in _padded(rows[1:], len(header), source)]  # fmt: skip
    table = np.array(values)
    result: dict[str, Any] = {
        "measured_floors": sorted(entries),
        "mode_shapes": [[row[entries[floor]] for floor in sorted(entries)] for row in values],
    }
    if scaled:
        result["mass_normalized"] = True
    if stds:
        lacking = sorted(set(entries) - set(stds))
        if lacking:
            raise InputError(f"{source} has no std for floor {lacking[0]}, and one for others; give each one, or none")
        entry_std = np.array([[row[stds[floor]] for floor in sorted(entries)] for row in values])
        largest = np.nanmax(np.abs(result["mode_shapes"]), axis=1, keepdims=True) if std_scaled else 1.0
        result["mode_shape_std"] = (entry_std / largest).tolist()
    for key, place in keys.items():
        column = table[:, place]
        # A mode does not need a damping ratio.
        needed = key != "damping_ratios" or np.all(np.isnan(column))
        if needed and np.any(np.isnan(column)):
            number = rows[1 + int(np.flatnonzero(np.isnan(column))[0])][0]
            raise InputError(f'{source}, line {number}: column "{header[place]}" is empty')
        result[key] = [int(value) for value in column] if key == "modes" else column.tolist()
    if ABSOLUTE in result:
        result["frequency_std"] = (np.array(result.pop(ABSOLUTE)) / result["frequencies"]).tolist()
    return result


def _columns(header: Sequence[str], source: str) -> tuple[dict[str, int], dict[int, int], dict[int, int], bool, bool]:
    """Places of the columns: by key of a configuration, of the entries by floor, of their deviations by floor.

    Last, whether the entries and their deviations have the unit 1/sqrt(kg); deviations without a unit are
    relative to the mode's largest entry.
    """
    scaled: set[bool] = set()
    std_scaled: set[bool] = set()
    keys: dict[str, int] = {}
    entries: dict[int, int] = {}
    stds: dict[int, int] = {}
    for place, name in enumerate(header):
        plain = " ".join(re.sub(r"[^a-z0-9%]+", " ", name.lower()).split())
        floor = re.fullmatch(r"floor ?(\d+)( std)?( 1 (?:sqrt )?kg)?", plain)
        if plain in COLUMNS:
            taken = COLUMNS[plain] in keys
            keys[COLUMNS[plain]] = place
        elif floor:
            several = stds if floor[2] else entries
            taken = int(floor[1]) in several
            several[int(floor[1])] = place
            (std_scaled if floor[2] else scaled).add(floor[3] is not None)
        else:
            # Do not quote a file that is not a table of modes: the user may have named the wrong file.
            shown = f'column "{name[:60]}"' if keys or entries else f"column {place + 1}"
            raise InputError(
                f"{source}: {shown} is not one of a table of modes: mode, frequency, frequency std, damping, "
                "floor 1, floor 1 std, floor 2, ..."
            )
        if taken:
            raise InputError(f'{source}: the column "{name}" is there twice')
    if "frequencies" not in keys or not entries:
        raise InputError(f'{source} needs a column "frequency" and one "floor 1", "floor 2", ... a measured floor')
    if len(scaled) > 1 or len(std_scaled) > 1:
        raise InputError(f"{source}: some floors are in 1/sqrt(kg), others have no unit; give all of them the same")
    return keys, entries, stds, True in scaled, True in std_scaled


def _padded(rows: Rows, width: int, source: str) -> Rows:
    """Rows of one length; missing cells at the end of a row are empty."""
    for number, row in rows:
        if any(cell not in (None, "") for cell in row[width:]):
            raise InputError(f"{source}, line {number} has more cells than the header has columns, {width}")
    return [(number, [*row[:width], *[None] * (width - len(row))]) for number, row in rows]


def _number(cell: Cell, number: int, name: str, source: str) -> float:
    """Read a cell's number; nan where it is empty."""
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return math.nan
    try:
        return float(cell)
    except (TypeError, ValueError):
        said = checks.shown(cell)
        raise InputError(f'{source}, line {number}: column "{name}" holds {said}, which is not a number') from None
