"""Define the parts of a description, and the functions that describe a result of any type."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import ClassVar

from cvxshear.util.quantities import AUTOMATIC, Units

Exact = float | int | str | None


@dataclass(frozen=True)
class Sentence:
    """A sentence or a short paragraph.

    Parameters
    ----------
    text : str
    tone : str
        "strong", "warning", "mistake", or empty.
    """

    kind: ClassVar[str] = "sentence"
    text: str
    tone: str = ""


@dataclass(frozen=True)
class Points:
    """A list of independent sentences.

    Parameters
    ----------
    key : str
        Names it in a page.
    texts : tuple of str
    """

    kind: ClassVar[str] = "points"
    key: str
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """Pairs of a name and a value.

    Parameters
    ----------
    pairs : tuple of (str, str)
    """

    kind: ClassVar[str] = "facts"
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Parameters
    ----------
    cells : tuple of str
        Texts of the cells.
    key : str
        Names it in a page.
    exact : tuple
        Exact numbers of the cells after the first; empty if they are not needed.
    """

    cells: tuple[str, ...]
    key: str = ""
    exact: tuple[Exact, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    key : str
        Names it in a page.
    title : str
    head : tuple of str
    rows : tuple of Row
    words : tuple of int
        Columns that hold words, zero-based; the others hold numbers.
    brief : int or None
        Number of rows for a short display; None shows all.
    """

    kind: ClassVar[str] = "table"
    key: str
    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    words: tuple[int, ...] = (0,)
    brief: int | None = None

    def folded(self, most: int) -> tuple[Table, ...]:
        """Split the table into tables of the first column and at most `most` other columns."""
        count = len(self.head)
        if count <= most + 1:
            return (self,)
        parts = []
        for first in range(1, count, most):
            title = self.title if first == 1 else f"{self.title}, continued"
            head, *rows = ((row[0], *row[first : first + most]) for row in (self.head, *(r.cells for r in self.rows)))
            parts.append(replace(self, key=f"{self.key}-{first}", title=title, head=head, rows=plain_rows(rows)))
        return tuple(parts)


Block = Sentence | Points | Facts | Table


@dataclass(frozen=True)
class Section:
    """A section of a description.

    Parameters
    ----------
    key : str
        Names it in a page.
    title : str
        Empty if the parts need no title.
    parts : tuple
    detail : bool
        Whether only a full report shows the section.
    below : bool
        Whether the section belongs to the section before it.
    """

    key: str
    title: str
    parts: tuple[Block, ...]
    detail: bool = False
    below: bool = False


@dataclass(frozen=True)
class Document:
    """The description of a result.

    Parameters
    ----------
    title : str
        Name of the frame or record.
    headline : str
        Result in one sentence.
    sections : tuple of Section
    """

    title: str
    headline: str
    sections: tuple[Section, ...]

    def __getitem__(self, key: str) -> Section:
        """Return the section with a key."""
        return next(section for section in self.sections if section.key == key)

    @property
    def brief(self) -> Iterator[Section]:
        """Sections of the short report that are not empty."""
        return (section for section in self.sections if not section.detail and section.parts)


def plain_rows(cells: Iterable[Sequence[str]]) -> tuple[Row, ...]:
    """Make rows that have cells only."""
    return tuple(Row(tuple(row)) for row in cells)


def table(
    key: str, title: str, cells: Mapping[str, Iterable[str]], *, words: tuple[int, ...] = (0,), top_first: bool = False
) -> Table:
    """Make a table from columns with their headers; with `top_first` the last entries form the first row."""
    rows = plain_rows(zip(*cells.values(), strict=True))
    return Table(key, title, tuple(cells), rows[::-1] if top_first else rows, words)


@singledispatch
def describe(result: object, units: Units = AUTOMATIC) -> Document:
    """Describe a result: its tables, sentences, and numbers with units.

    Parameters
    ----------
    result : object
    units : Units, optional
        Units of the quantities. Default: units that fit the sizes.

    Returns
    -------
    Document

    Raises
    ------
    TypeError
        If no description is registered for this type.
    """
    raise TypeError(f"a {type(result).__name__} has no description; register one with describe.register")


@singledispatch
def line(result: object) -> str:
    """Write a result in one short line for a prompt. Default: the headline of its description."""
    return f"<{type(result).__name__} {describe(result).headline}>"
