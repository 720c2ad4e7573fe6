"""Tables of named columns, and the reader of delimited text from loggers, spreadsheets and other programs.

Before the line that names the columns there may be a preamble, after it a line of units; cells are separated by
semicolons, tabs, commas or blanks; a decimal comma is understood where no comma separates. Stamps of time, with or
without a date, become seconds since the first; a column of dates alone is left out.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import chain, islice
from pathlib import Path

import numpy as np

from cvxshear.io.formats import LIMIT, MEGABYTE, TOO_LARGE, read_bytes
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of equal length.

    Parameters
    ----------
    source : str
        The file, for messages.
    names : tuple of str
    values : array, shape (rows, columns)
    lines : array of int, shape (rows,), optional
        The line of the file that each row stands on; None for a binary file.
    units : tuple of str, optional
        Unit of each column, from a line of units; empty without such a line.
    stated_rate : tuple of (str, float), optional
        A lone number of the file that gives the sampling rate: its name, and the rate in Hz.
    arrays : dict, optional
        Every vector and lone number of a file of arrays by its name, of whatever length.
    words : dict, optional
        Cells of the columns that hold words, by the name of the column.
    preamble : str, optional
        Lines of the text before the names of the columns.
    """

    source: str
    names: tuple[str, ...]
    values: Floats
    lines: Ints | None = None
    units: tuple[str, ...] = ()
    stated_rate: tuple[str, float] | None = None
    arrays: Mapping[str, Floats] = field(default_factory=dict)
    words: Mapping[str, Sequence[str]] = field(default_factory=dict)
    preamble: str = ""

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise InputError(f'{self.source} has two columns named "{name}"')
            seen.add(name)

    def at(self, row: int) -> str:
        """Name the place of a row for a message: its line or its sample."""
        if self.lines is None:
            return f"{self.source}, sample {row + 1}"
        return f"{self.source}, line {int(self.lines[row])}"

    def rows(self, which: slice) -> Columns:
        """Keep some of the rows."""
        lines = None if self.lines is None else self.lines[which]
        return replace(self, values=self.values[which], lines=lines)

    def check(self, name: str, asked: str) -> None:
        """Raise `InputError` if there is no such column; `asked` names the user of the column."""
        if name not in self.names:
            shown = ", ".join(each[:60] for each in self.names[:12]) + (", ..." if len(self.names) > 12 else "")
            raise InputError(f'{asked}: {self.source} has no column "{name[:60]}"; it has {shown}')

    def column(self, name: str, asked: str) -> Floats:
        """Return the values of a column after a check that they are finite, shape (rows,).

        Parameters
        ----------
        name : str
        asked : str
            The user of the column, for messages.
        """
        self.check(name, asked)
        values = self.values[:, self.names.index(name)]
        bad = np.flatnonzero(~(np.abs(values) <= checks.LARGEST))
        if bad.size:
            raise InputError(
                f'{self.at(int(bad[0]))}: column "{name}" holds {values[bad[0]]} ({bad.size} such values in '
                "all); mend the record or cut it before that line"
            )
        return checks.frozen(values.copy())


#: Separators of cells, in the order of the search; None means blanks.
SEPARATORS = (";", "\t", ",", None)

#: Lines within which the header and the first line of numbers must stand.
LONGEST_HEAD = 400

#: A cell of a line of units: "s", "m/s2", "[g]", "mm/s^2", "-", or nothing.
UNIT = re.compile(r"[\[(]?\s*(?:[a-zA-Zµ°%]{1,4}(?:[/·^*²0-9-]{1,4}[a-zA-Z]{0,3}){0,3}|-|)\s*[\])]?")

#: A date by itself: 2024-03-12, 12.03.2024, 3/12/24.
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.](?:\d{4}|\d\d)")

#: A time of day with 24 hours or with AM and PM, with or without a date before it.
STAMP = re.compile(
    rf"(?:(?P<date>{DATE.pattern})[T ] *)?(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d(?:[.,:]\d+)?))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?(?:Z|[+-]\d\d:?\d\d)?"
)

ISO_DATE = re.compile(r"\d{4}-\d\d-\d\d")
#: Seconds of a day.
DAY = 86_400.0

Line = tuple[int, str]


@dataclass(frozen=True)
class Layout:
    """Separator of the cells of a text, and its lines before the numbers.

    Parameters
    ----------
    separator : str or None
        None for blanks.
    names : tuple of str
    line : int
        The line of the names.
    units : tuple of str
        Unit of each column, from a line of units; empty without such a line.
    first : int
        The line of the first numbers; 0 if there are no numbers.
    """

    separator: str | None
    names: tuple[str, ...]
    line: int
    units: tuple[str, ...] = ()
    first: int = 0


def read_csv(
    path: str | Path, limit: float = LIMIT, remedy: str = TOO_LARGE, words: Sequence[str] | None = None
) -> Columns:
    """Read delimited text.

    Parameters
    ----------
    path : str or Path
        UTF-8, UTF-16 with its mark, or Latin-1; may be compressed by gzip.
    limit : float, optional
        Bytes that the file, inflated, may have.
    remedy : str, optional
        End of the message about a larger file.
    words : sequence of str, optional
        For a table whose first line names the columns: those that hold words, in small letters.

    Returns
    -------
    Columns
        Empty cells are nan. The caller checks the columns that it uses.

    Raises
    ------
    InputError
        If the file is empty, too large, has no header, or a cell is not a number, naming the column and the line.
    """
    return columns_of(_text(Path(path), limit, remedy), str(path), words)


def columns_of(text: Iterable[str], where: str, words: Sequence[str] | None = None) -> Columns:
    """Read the columns of a text, line by line, as `read_csv` does.

    Parameters
    ----------
    text : iterable of str
    where : str
        The file, for messages.
    words : sequence of str, optional
        As for `read_csv`.
    """
    lines = ((number, line) for number, line in enumerate(text, 1) if line.strip())
    head = list(islice(lines, LONGEST_HEAD))
    layout = layout_of(head, where) if words is None else _first_line(head, where)
    after = (each for each in chain(head, lines) if each[0] >= (layout.first or layout.line + 1))
    found = _columns((each for each in after if not _comment(each[1])), layout, where, words or ())
    return replace(found, preamble="".join(line for number, line in head if number < layout.line))


def layout_of(head: Sequence[Line], where: str) -> Layout:
    """Find the layout of a text from its first lines.

    Parameters
    ----------
    head : sequence of (int, str)
        Line numbers and lines that are not empty.
    where : str
        The file, for messages.
    """
    for place, (number, line) in enumerate(head):
        if _comment(line):
            continue
        # "1,2" is one number with a decimal comma or two numbers. Take two numbers if the header has enough columns.
        counts = {separator: _numbers_in(line, separator) for separator in SEPARATORS}
        for separator in sorted((each for each in SEPARATORS if counts[each]), key=lambda each: -counts[each]):
            found = _header(head[:place], separator, counts[separator])
            if found is not None:
                return Layout(separator, *found, number)
    return _first_line(head, where)


def _first_line(head: Sequence[Line], where: str) -> Layout:
    """Take the first line as the header if the numbers below do not identify one; later checks report the mistake.

    Semicolons, tabs and commas inside quotation marks are part of a name.
    """
    if not (plain := [each for each in head if not _comment(each[1])]):
        raise InputError(f"{where} is empty; a table has a header that names its columns, and a line a sample or mode")
    number, text = plain[0]
    bare = re.sub(r'"[^"]*"', "", text)
    separator = next((mark for mark in SEPARATORS if mark and mark in bare), None)
    names = tuple(cell.strip() for cell in _cells(text, separator, f"{where}, line {number}"))
    if all(_is_number(name) for name in names):
        raise InputError(f"{where}, line {number}: the first line must name the columns, it holds numbers")
    return Layout(separator, names, number)


def _header(
    before: Sequence[Line], separator: str | None, count: int
) -> tuple[tuple[str, ...], int, tuple[str, ...]] | None:
    """Find names, their line, and units in the lines right before the first numbers; None if no line fits."""
    fitting: list[tuple[int, tuple[str, ...]]] = []
    for number, line in reversed(before[-3:]):
        # A tab at the start of a line of units means that the time column has no unit.
        cells = _split(line.lstrip(" ").removeprefix("#").strip("\r\n"), separator)
        # Whoever ends each line with a separator ends all of them so; a quotation mark that is left begins a name.
        if cells is None or len(cells) != count or any('"' in cell for cell in cells):
            break
        fitting.append((number, tuple(cell.strip() for cell in cells)))
    named = [(n, cells) for n, cells in fitting if not all(_is_datum(each.replace(",", ".")) for each in cells)]
    if not named:
        return None
    units: tuple[str, ...] = ()
    if len(named) > 1 and all(UNIT.fullmatch(cell) for cell in named[0][1]) and any(named[0][1]):
        units = tuple(cell.strip("[]() ") for cell in named[0][1])
        named = named[1:]
    return named[0][1], named[0][0], units


def _numbers_in(line: str, separator: str | None) -> int:
    """Count the cells of a line of numbers, stamps and empty cells with at least one number; 0 for another line."""
    cells = _split(line if separator == "," else line.replace(",", "."), separator)
    if not cells or not all(_is_datum(cell.strip()) for cell in cells):
        return 0
    return len(cells) if any(_is_number(cell) for cell in cells) else 0


def _columns(lines: Iterable[Line], layout: Layout, where: str, words: Sequence[str]) -> Columns:
    names = layout.names
    texts: dict[int, list[str]] = {place: [] for place, name in enumerate(names) if name.lower() in words}
    numbers: list[int] = []
    rows: list[list[float]] = []
    stamps: list[int] = []
    dates: set[int] = set()
    for number, text in lines:
        line = text if layout.separator == "," else text.replace(",", ".")
        cells = _cells(line, layout.separator, f"{where}, line {number}")
        if len(cells) != len(names):
            last = f' ("{names[-1]}" is the last)' if numbers else ""
            raise InputError(
                f"{where}, line {number} has {len(cells)} cells where the header names {len(names)} columns{last}"
            )
        for place, found in texts.items():
            found.append(cells[place].strip())
            cells[place] = ""
        if not numbers:
            stamps = [place for place, cell in enumerate(cells) if STAMP.fullmatch(cell.strip())]
            # The time of the day beside it tells all that a record needs, midnight included.
            dates = {place for place, cell in enumerate(cells) if DATE.fullmatch(cell.strip()) and not _is_number(cell)}
        rows.append(_row(cells, line, names, f"{where}, line {number}"))
        numbers.append(number)
    if not numbers:
        raise InputError(f"{where} has a header and no samples")
    table = np.array(rows)
    # Round to microseconds: a double has no more digits for seconds since 1970.
    table[:, stamps] = np.round(table[:, stamps] - table[0, stamps], 6)
    # A clock without a date begins anew at midnight.
    table[:, stamps] += DAY * np.cumsum(np.diff(table[:, stamps], axis=0, prepend=0.0) < -DAY / 2, axis=0)
    # The empty cell after the last separator of every line is not a column.
    kept = [p for p, name in enumerate(names) if p not in dates and (name or not np.isnan(table[:, p]).all())]
    units = tuple(layout.units[p] for p in kept) if layout.units else ()
    said = {names[place]: found for place, found in texts.items()}
    return Columns(where, tuple(names[p] for p in kept), table[:, kept], np.array(numbers), units, words=said)


def _row(cells: list[str], line: str, names: tuple[str, ...], where: str) -> list[float]:
    # Python's float takes 1_000 for a thousand.
    if "_" not in line:
        with suppress(ValueError):
            return [float(cell) for cell in cells]
    return [_cell(cell.strip(), where, name) for cell, name in zip(cells, names, strict=True)]


def _cell(cell: str, where: str, name: str) -> float:
    if not cell or DATE.fullmatch(cell):
        return math.nan
    if _is_number(cell):
        return float(cell)
    if found := STAMP.fullmatch(cell):
        return _seconds(found, where)
    raise InputError(f'{where}: column "{name}" holds {checks.shown(cell)}, which is not a number')


def _seconds(stamp: re.Match[str], where: str) -> float:
    """Read a stamp in s, since midnight or, with an ISO date, since the start of 1970.

    In other dates the day or the month may come first. The date is not needed: the clock shows midnight.
    """
    hour, minute, second = int(stamp["hour"]), int(stamp["minute"]), float(re.sub("[,:]", ".", stamp["second"] or "0"))
    half = (stamp["half"] or "").lower()
    if half and 1 <= hour <= 12:
        hour = hour % 12 + (12 if half == "p" else 0)
    date = stamp["date"] or ""
    try:
        day = datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp() if ISO_DATE.fullmatch(date) else 0.0
        if hour > 23 or minute > 59 or second >= 61:
            raise ValueError(stamp[0])
    except ValueError:
        raise InputError(f"{where} holds {checks.shown(stamp[0])}, which is no date or time") from None
    return day + 3600.0 * hour + 60.0 * minute + second


def _cells(line: str, separator: str | None, where: str) -> list[str]:
    if (found := _split(line, separator)) is None:
        raise InputError(f"{where} is no line of a table: its quotation marks do not close around a cell")
    return found


def _split(line: str, separator: str | None) -> list[str] | None:
    """Split a line into its cells; None if its quotation marks do not close."""
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.strip("\r\n").split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True), [])
    except csv.Error:
        return None


def _text(path: Path, limit: float, remedy: str) -> Iterable[str]:
    """Yield the lines of the file."""
    content = read_bytes(path, limit, remedy)
    if content.startswith(b"\x1f\x8b"):
        content = _inflated(content, path, limit, remedy)
    encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    try:
        content.decode(encoding)
    except UnicodeDecodeError as error:
        # Loggers of the west write Latin-1; its control characters are in no text.
        if encoding == "utf-16" or re.search(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f-\x9f]", content):
            raise InputError(
                f"{path!s} is not UTF-8 text (byte {error.start}); is it a CSV file, and saved as UTF-8?"
            ) from None
        encoding = "latin-1"
    # A list of all lines would take several times the file's size.
    return io.TextIOWrapper(io.BytesIO(content), encoding=encoding)


def _inflated(content: bytes, path: Path, limit: float, remedy: str) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            inflated = file.read(int(limit) + 1)
    except (OSError, EOFError, zlib.error):
        raise InputError(f"{path!s} is a damaged gzip file") from None
    if len(inflated) > limit:
        raise InputError(f"{path!s} inflates to more than {limit / MEGABYTE:g} MB; {remedy}")
    return inflated


def _comment(line: str) -> bool:
    return line.lstrip()[0] == "#"


def _is_datum(cell: str) -> bool:
    return bool(not cell or _is_number(cell) or STAMP.fullmatch(cell) or DATE.fullmatch(cell))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
