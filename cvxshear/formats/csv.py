"""Reader of delimited text: a header that names the columns, then numbers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from cvxshear.errors import InputError
from cvxshear.formats.columns import Columns
from cvxshear.typing import Floats

LARGEST_FILE = 2_000_000_000
"""Bytes."""
SEPARATORS = (";", "\t", ",")


def read_csv(path: str | Path) -> Columns:
    """Read delimited text.

    The first line that is neither empty nor a comment (#) is the header. Cells are separated by semicolons,
    tabs, commas or blanks, whichever the header has, in that order; a decimal comma is understood where the
    separator is not a comma.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Columns
        With nan where a cell is empty or says nan, for the caller to judge: not every column is used.

    Raises
    ------
    InputError
        Where the file is empty, has no header, or a cell is not a number, naming the column and the line.
    """
    path = Path(path)
    numbered = enumerate(_text(path).splitlines(), 1)
    lines = [(number, text) for number, text in numbered if text.strip() and text.lstrip()[0] != "#"]
    if not lines:
        raise InputError(f"{path} is empty; a record has a header that names its columns, and a line a sample")
    (first, header), *rest = lines
    separator = next((mark for mark in SEPARATORS if mark in header), None)
    names = tuple(cell.strip().strip('"') for cell in header.split(separator))
    if all(_is_number(name) for name in names):
        raise InputError(f"{path}, line {first}: the first line must name the columns, it holds numbers")
    if not rest:
        raise InputError(f"{path} has a header and no samples")
    values = _fast(rest, separator, len(names))
    if values is None:
        values = np.array([_row(text, separator, names, path, number) for number, text in rest])
    return Columns(str(path), names, values, np.array([number for number, _ in rest], dtype=np.int64))


def _text(path: Path) -> str:
    try:
        if path.is_dir():
            raise InputError(f"{path} is a folder; name a file in it")
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} has {path.stat().st_size / 1e6:.0f} MB; cut it into runs")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text (byte {error.start}); is it a CSV file?") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def _fast(rest: list[tuple[int, str]], separator: str | None, width: int) -> Floats | None:
    """All rows at once where every cell is a plain number; None where one is not, and rows are looked at singly."""
    cells = [text.split(separator) for _, text in rest]
    if any(len(row) != width for row in cells):
        return None
    try:
        return np.array(cells, dtype=np.float64)
    except ValueError:
        return None


def _row(text: str, separator: str | None, names: tuple[str, ...], path: Path, number: int) -> list[float]:
    cells = text.split(separator)
    if len(cells) != len(names):
        raise InputError(
            f'{path}, line {number} has {len(cells)} cells where the header names {len(names)} columns ("{names[-1]}" '
            "is the last)"
        )
    return [_cell(cell, separator, name, path, number) for cell, name in zip(cells, names, strict=True)]


def _cell(cell: str, separator: str | None, name: str, path: Path, number: int) -> float:
    cell = cell.strip().strip('"')
    if not cell:
        return math.nan
    try:
        return float(cell.replace(",", ".") if separator != "," else cell)
    except ValueError:
        where = f'{path}, line {number}: channel "{name}"'
        raise InputError(f"{where} holds {cell[:40]!r}, which is not a number") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
