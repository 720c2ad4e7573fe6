"""Tables of spreadsheet programs: workbooks are read here, and cells written, as CSV or as a workbook."""

import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from cvxshear.io.columns import Columns
from cvxshear.io.csv import columns_of
from cvxshear.io.formats import TOO_LARGE, read_bytes
from cvxshear.util.errors import InputError, optional, printable
from cvxshear.util.writing import cell_text, write_file

Cell = str | float | int | None

LONGEST_TITLE = 31
"""Largest length of the title of a sheet, letters (Excel)."""

LONGEST_CELL = 32_767
"""Largest length of a cell, letters (Excel)."""

WIDEST = 28
"""Largest width of a column of a workbook, letters."""

RESERVED = "history"
"""Title that Excel reserves."""


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
    return "".join(",".join(map(_csv_cell, row)) + "\n" for row in (header, *rows))


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
    taken = {RESERVED}
    for sheet in sheets:
        page = book.create_sheet(_title(sheet.title, taken))
        table = [tuple(map(_plain, row)) for row in (sheet.header, *sheet.rows)]
        for row in table:
            page.append(row)
        for column, cells in enumerate(zip(*table, strict=False), 1):
            width = max(len(str(cell)) for cell in cells)
            page.column_dimensions[page.cell(1, column).column_letter].width = min(width, WIDEST) + 2
        page.freeze_panes = "A2"
    content = io.BytesIO()
    book.save(content)
    return content.getvalue()


def read_xlsx_rows(path: str | Path, limit: float, remedy: str) -> list[tuple[int, list[Any]]]:
    """Yield number and cells of each row of a workbook's first sheet that is not empty.

    Parameters
    ----------
    path : str or Path
    limit : float
        Bytes that the file may have.
    remedy : str
        End of the message about a larger file.

    Raises
    ------
    InputError
        If openpyxl (the extra `xlsx`) is not installed, or the file is no workbook or too large.
    """
    openpyxl = load_openpyxl()
    content = io.BytesIO(read_bytes(Path(path), limit, remedy))
    try:
        book = openpyxl.load_workbook(content, read_only=True, data_only=True)
        found = [list(row) for row in book.worksheets[0].iter_rows(values_only=True)]
    except Exception as error:
        # openpyxl raises whatever its parsing of the archive runs into.
        raise InputError(f"{path!s} is not a workbook that can be read ({type(error).__name__})") from None
    return [(number, row) for number, row in enumerate(found, 1) if any(cell not in (None, "") for cell in row)]


def read_xlsx(path: str | Path, limit: float) -> Columns:
    """Read the columns of a workbook's first sheet, with a preamble, units and stamps as in delimited text.

    Parameters
    ----------
    path : str or Path
    limit : float
        Bytes, as for `read_csv`.
    """
    rows = read_xlsx_rows(path, limit, TOO_LARGE)
    lines = {number: "\t".join(map(_as_text, row)) for number, row in rows}
    return columns_of((lines.get(number, "") for number in range(1, max(lines, default=0) + 1)), str(path))


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


def _title(name: str, taken: set[str]) -> str:
    """Remove forbidden characters from the title of a sheet, and make it unique regardless of case."""
    plain = re.sub(r"[\\/*?:\[\]]", " ", printable(name))[:LONGEST_TITLE].strip(" '") or "sheet"
    title, place = plain, 1
    while title.lower() in taken:
        place += 1
        title = f"{plain[: LONGEST_TITLE - len(str(place)) - 1]} {place}"
    taken.add(title.lower())
    return title


def _plain(cell: Cell) -> Cell:
    if isinstance(cell, str):
        return cell_text(cell)[:LONGEST_CELL]
    return None if cell is None or (isinstance(cell, float) and not math.isfinite(cell)) else cell


def _csv_cell(cell: Cell) -> str:
    plain = _plain(cell)
    if not isinstance(plain, str):
        return "" if plain is None else repr(plain)
    # A semicolon or a tab parts cells too, by the program's language.
    if plain != plain.strip() or any(mark in plain for mark in ',;\t"'):
        return '"' + plain.replace('"', '""') + '"'
    return plain
