"""Arrange descriptions of results for a terminal, plain text, a notebook, pandas, and a spreadsheet program."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table as Grid
from rich.text import Text

from cvxshear.report.blocks import Facts, Points, Section, Sentence, Table, describe, table_of_rows
from cvxshear.util.errors import UnsuitableError, printable
from cvxshear.util.quantities import column_name
from cvxshear.util.results import data_frame

if TYPE_CHECKING:
    import pandas as pd

    from cvxshear.io.spreadsheets import Sheet

#: Number of spaces between columns.
COLUMN_GAP = 2

#: Smallest width of a wrapped column of words, in characters.
NARROWEST = 18


@dataclass(frozen=True)
class HouseTable:
    """A table without a box; on a narrow terminal its columns are split into blocks below each other.

    Columns of words may be wrapped; columns of numbers are not.

    Parameters
    ----------
    found : Table
    """

    found: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self.found.title:
            yield Text(printable(self.found.title), style="bold")
        rows, opened = self.found.rows, self.found.opened
        if opened < len(rows):
            rows = (*rows[:opened], (f"and {len(rows) - opened} more", *([""] * (len(self.found.head) - 1))))
        columns = [[printable(cell) for cell in cells] for cells in zip(self.found.head, *rows, strict=True)]
        least = [_least(column, at in self.found.words) for at, column in enumerate(columns)]
        for place, block in enumerate(self._blocks(least, options.max_width)):
            if place:
                yield Text("")
            yield self._grid({at: columns[at] for at in block}, least, options.max_width)

    def _blocks(self, least: Sequence[int], width: int) -> Iterator[list[int]]:
        """Split the columns into blocks that fit the width; each block starts with the leading columns of words."""
        lead = list(takewhile(lambda at: at in self.found.words, range(len(least))))
        block = list(lead)
        for at in range(len(lead), len(least)):
            if len(block) > len(lead) and sum(least[each] + COLUMN_GAP for each in (*block, at)) > width:
                yield block
                block = list(lead)
            block.append(at)
        yield block

    def _grid(self, columns: Mapping[int, Sequence[str]], least: Sequence[int], width: int) -> Grid:
        """Lay out some of the columns; columns of numbers keep their full width."""
        # If rich must wrap headers, it ignores least widths, makes all columns equal and cuts wide cells. The columns
        # of numbers therefore get a fixed width, and the columns of words get the rest.
        tight = sum(max(map(cell_len, cells)) + COLUMN_GAP for cells in columns.values()) > width + COLUMN_GAP
        grid = Grid(box=None, pad_edge=False, padding=(0, COLUMN_GAP, 0, 0))
        for at, (head, *_) in columns.items():
            word = at in self.found.words
            fixed = None if word or not tight else least[at]
            grid.add_column(Text(head), justify="left" if word else "right", min_width=least[at], width=fixed)
        for cells in zip(*(each[1:] for each in columns.values()), strict=True):
            grid.add_row(*map(Text, cells))
        return grid


def _least(column: Sequence[str], wraps: bool) -> int:
    """Measure the least width of a column: its longest cell, and the longest word of its header."""
    cells = max(map(cell_len, column[1:]), default=0)
    header = max(map(cell_len, column[0].split()), default=0)
    return max(min(cells, NARROWEST), header) if wraps else max(cells, header)


def plain_table(title: str, *head: str, rows: Iterable[Sequence[str]], words: tuple[int, ...] = (0,)) -> HouseTable:
    """Lay out a table in the house style: words to the left, numbers to the right, no box."""
    return HouseTable(table_of_rows("", title, head, rows, words=words))


STYLES = {"strong": "bold", "warning": "yellow", "mistake": "bold red", "": ""}

#: Width of plain text in characters.
PAGE = 80


def shown(result: object) -> Iterator[RenderableType]:
    """Render a result for a terminal: its headline and the sections of the short report.

    Parameters
    ----------
    result : object
        Result of a type that `describe` supports.
    """
    document = describe(result)
    yield Text(printable(document.headline), style="bold")
    for section in document.brief:
        yield from rendered(section)


def rendered(section: Section) -> Iterator[RenderableType]:
    """Render a section of a description."""
    if section.title:
        yield Text("")
        yield Text(printable(section.title), style="bold underline")
    for place, part in enumerate(section.parts):
        if place and isinstance(part, Table):
            yield Text("")
        yield _part(part)


def text(result: object, width: int = PAGE) -> str:
    """Write a result as plain text, folded to a width."""
    # A rich console in a notebook would display an additional empty block.
    console = Console(
        file=io.StringIO(), width=width, color_system=None, highlight=False, markup=False, emoji=False,
        force_jupyter=False,
    )  # fmt: skip
    with console.capture() as captured:
        for part in shown(result):
            console.print(part)
    return "\n".join(each.rstrip() for each in captured.get().splitlines())


def _part(part: Sentence | Points | Facts | Table) -> RenderableType:
    if isinstance(part, Sentence):
        return Text(printable(part.text), style=STYLES[part.tone])
    if isinstance(part, Points):
        return _grid([("-", each) for each in part.texts], 1)
    if isinstance(part, Facts):
        return _grid(part.pairs, 2)
    return HouseTable(part)


def _grid(pairs: Iterator[tuple[str, str]] | list[tuple[str, str]] | tuple[tuple[str, str], ...], gap: int) -> Grid:
    """Lay out names or marks and their texts in two columns; wrapped texts stay in their column."""
    grid = Grid.grid(padding=(0, gap, 0, 0))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, said in pairs:
        grid.add_row(Text(printable(name)), Text(printable(said)))
    return grid


def line_of(result: object) -> str:
    """Write a result in one short line."""
    document = describe(result)
    return printable(f"<{type(result).__name__} {document.line or document.headline}>")


def sheets_of(*results: object) -> list[Sheet]:
    """Convert the tables of results to sheets of a spreadsheet program.

    Parameters
    ----------
    *results : object
        Results of a type that `describe` supports.
    """
    from cvxshear.io.spreadsheets import Sheet  # noqa: PLC0415 - the formats of files load slowly

    sheets = []
    for each in (table for result in results for table in describe(result).data):
        columns = [(column.spelled(name), values) for column in each.columns for name, values in column.exported]
        rows = list(zip(*(values for _, values in columns), strict=True))
        sheets.append(Sheet(each.key, tuple(header for header, _ in columns), rows))
    return sheets


def data_frame_of(result: object) -> pd.DataFrame:
    """Convert the main table of a result to a table of pandas.

    Raises
    ------
    InputError
        If the result has no table for programs, or pandas is not installed.
    """
    if not (tables := describe(result).data):
        raise UnsuitableError(f"a {type(result).__name__} has no table of numbers; to_dict() returns its values")
    found = {column_name(name, column.unit): values for column in tables[0].columns for name, values in column.exported}
    made = data_frame(found)
    return made.set_index(next(iter(found))) if tables[0].indexed else made


#: Key of the section that a notebook illustrates with its figures.
FIRST_SECTION = "verdict"


def notebook_html(result: object) -> str:
    """Write a result as a piece of HTML: the figure of its verdict, if any, and its tables."""
    # jinja2 and matplotlib are loaded where a page is made.
    from cvxshear.report.figures.style import applicable, encoded  # noqa: PLC0415
    from cvxshear.report.html import environment  # noqa: PLC0415

    # PNG: ids of several SVGs in a notebook would clash.
    pictures = [
        (entry.alternative, base64.b64encode(encoded(entry.draw(result), "png")).decode())
        for entry in applicable(result)
        if entry.section == FIRST_SECTION
    ]
    return environment().get_template("notebook.html").render(document=describe(result), pictures=pictures)


def drawn(result: Any, name: str) -> Any:
    """Draw a figure of a result by its name; an empty name draws the first figure."""
    from cvxshear.report import figures  # noqa: PLC0415 - loads matplotlib

    return figures.drawn_figure(name, result)
