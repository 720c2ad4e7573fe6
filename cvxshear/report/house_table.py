"""Tables in the house style for a terminal: what is too wide is folded, and names are data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Column, Table
from rich.text import Text

from cvxshear.util.text import printable

GAP = 2
"""Spaces between columns."""

NARROWEST = 18
"""What a column of words keeps of its width at least, where it has as much."""


class HouseTable(Table):
    """A table without a box; where the terminal is too narrow for it, its columns go below each other in blocks.

    Parameters
    ----------
    heading : str
        Not wrapped to the table's width, as rich would.
    words : tuple of int
        Columns of words, which may be wrapped; the others hold numbers, which may not.
    """

    def __init__(self, heading: str, words: Sequence[int] = (0,)) -> None:
        super().__init__(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
        self.heading = heading
        self.words = tuple(words)

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """A row; a str is data and no markup."""
        super().add_row(*(Text(printable(each)) if isinstance(each, str) else each for each in cells), **options)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self.heading:
            yield Text(printable(self.heading), style="bold")
        for place, block in enumerate(self._blocks(options.max_width)):
            if place:
                yield Text("")
            yield from super(HouseTable, block).__rich_console__(console, options)

    def _blocks(self, width: int) -> Iterator[HouseTable]:
        """The table, or several of its columns each with its leading words before them."""
        least = [_least(column, self._wraps(at)) for at, column in enumerate(self.columns)]
        if sum(least) + GAP * len(least) <= width:
            yield self._of(range(len(self.columns)), least, width)
            return
        lead = [at for at in range(len(self.columns)) if at in self.words and all(i in self.words for i in range(at))]
        taken = sum(least[at] + GAP for at in lead)
        block, used = list(lead), taken
        for at in range(len(lead), len(self.columns)):
            if len(block) > len(lead) and used + least[at] + GAP > width:
                yield self._of(block, least, width)
                block, used = list(lead), taken
            block.append(at)
            used += least[at] + GAP
        yield self._of(block, least, width)

    def _wraps(self, at: int) -> bool:
        return at in self.words

    def _of(self, columns: Sequence[int], least: Sequence[int], width: int) -> HouseTable:
        """Some of the columns, the numbers never narrower than they are."""
        block = HouseTable("", [place for place, at in enumerate(columns) if at in self.words])
        # Where the headers have to be wrapped, rich makes all columns alike, whatever their least width, and cuts what
        # then is too wide: so the columns of numbers are given theirs, and the words have the rest.
        tight = sum(_natural(self.columns[at]) + GAP for at in columns) > width + GAP
        for at in columns:
            block.add_column(
                self.columns[at].header,
                justify=self.columns[at].justify,
                min_width=least[at],
                width=least[at] if tight and not self._wraps(at) else None,
            )
        for cells in zip(*(self.columns[at].cells for at in columns), strict=True):
            block.add_row(*cells)
        return block


def _natural(column: Column) -> int:
    """The width at which nothing of a column is wrapped."""
    return max(cell_len(str(cell)) for cell in (column.header, *column.cells))


def _least(column: Column, wraps: bool) -> int:
    """The width that a column needs: its longest cell, and the longest word of its header."""
    cells = max((cell_len(str(cell)) for cell in column.cells), default=0)
    header = max((cell_len(word) for word in str(column.header).split()), default=0)
    return max(min(cells, NARROWEST), header) if wraps else max(cells, header)


def plain_table(title: str, *columns: str, words: Sequence[int] = (0,)) -> HouseTable:
    """A table in the house style: words to the left, numbers to the right, no box around."""
    table = HouseTable(title, words)
    for place, column in enumerate(columns):
        table.add_column(Text(printable(column)), justify="left" if place in words else "right")
    return table
