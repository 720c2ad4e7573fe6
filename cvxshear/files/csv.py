"""Reader of delimited text: a header that names the columns, then numbers."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from cvxshear.files.columns import LIMIT, TOO_LARGE, Columns
from cvxshear.files.reading import MEGABYTE, read_bytes
from cvxshear.util.checks import shown
from cvxshear.util.errors import InputError

SEPARATORS = (";", "\t", ",")
MOST_COLUMNS = 10_000


def read_csv(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read delimited text.

    The first line that is neither empty nor a comment (#) is the header. Cells are separated by semicolons,
    tabs, commas or blanks, whichever the header has, in that order; a decimal comma is understood where the
    separator is not a comma.

    Parameters
    ----------
    path : str or Path
    limit : float, optional
        Bytes that the file, and the numbers in it, may have.

    Returns
    -------
    Columns
        With nan where a cell is empty or says nan, for the caller to judge: not every column is used.

    Raises
    ------
    InputError
        Where the file is empty, too large, has no header, or a cell is not a number, naming the column and the line.
    """
    path = Path(path)
    where = str(path)
    numbered = enumerate(_text(path, limit), 1)
    lines = ((number, line) for number, line in numbered if line.strip() and line.lstrip()[0] != "#")
    first, header = next(lines, (0, ""))
    if not header:
        raise InputError(f"{where} is empty; a record has a header that names its columns, and a line a sample")
    separator = next((mark for mark in SEPARATORS if mark in header), None)
    names = tuple(cell.strip() for cell in _cells(header, separator, f"{where}, line {first}"))
    if all(_is_number(name) for name in names):
        raise InputError(f"{where}, line {first}: the first line must name the columns, it holds numbers")
    if len(names) > MOST_COLUMNS:
        raise InputError(f"{where}, line {first} names {len(names)} columns; {MOST_COLUMNS} are the most that are read")
    return _columns(lines, separator, names, where, limit)


def _columns(
    lines: Iterator[tuple[int, str]], separator: str | None, names: tuple[str, ...], where: str, limit: float
) -> Columns:
    numbers = array("q")
    values = array("d")
    for number, text in lines:
        line = text if separator == "," else text.replace(",", ".")
        cells = _cells(line, separator, f"{where}, line {number}")
        if len(cells) != len(names):
            raise InputError(
                f"{where}, line {number} has {len(cells)} cells where the header names {len(names)} columns "
                f'("{names[-1]}" is the last)'
            )
        values.extend(_row(cells, line, names, f"{where}, line {number}"))
        numbers.append(number)
        if len(values) * values.itemsize > limit:
            raise InputError(f"{where} holds more than {limit / MEGABYTE:g} MB of numbers; {TOO_LARGE}")
    if not numbers:
        raise InputError(f"{where} has a header and no samples")
    table = np.frombuffer(values, dtype=np.float64).reshape(len(numbers), len(names))
    return Columns(where, names, table, np.frombuffer(numbers, dtype=np.int64))


def _row(cells: list[str], line: str, names: tuple[str, ...], where: str) -> list[float]:
    # Python's float takes 1_000 for a thousand.
    if "_" not in line:
        with suppress(ValueError):
            return [float(cell) for cell in cells]
    return [_cell(cell, f'{where}: channel "{name}"') for cell, name in zip(cells, names, strict=True)]


def _cells(line: str, separator: str | None, where: str) -> list[str]:
    if separator is None:
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True))
    except csv.Error as error:
        raise InputError(f"{where} is no line of a table: {error}") from None


def _text(path: Path, limit: float) -> Iterable[str]:
    """The lines of the file."""
    content = read_bytes(path, limit, TOO_LARGE)
    try:
        content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path!s} is not UTF-8 text (byte {error.start}); is it a CSV file, and saved as UTF-8?"
        ) from None
    # A list of all lines would take several times the file's size.
    return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig")


def _cell(cell: str, where: str) -> float:
    cell = cell.strip()
    if not cell:
        return math.nan
    if "_" not in cell:
        with suppress(ValueError):
            return float(cell)
    raise InputError(f"{where} holds {shown(cell)}, which is not a number")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
