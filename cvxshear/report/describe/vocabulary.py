"""The parts that the description of a result is made of, and the functions that describe a result of any type."""

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
    """Sentences that stand each by itself.

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
    """Names with what is known of them.

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
        As people read them.
    key : str
        Names it in a page.
    exact : tuple
        The numbers behind the cells from the second on; empty where nobody asks for them.
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
        How many rows suffice where there is little room; all where None.
    """

    kind: ClassVar[str] = "table"
    key: str
    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    words: tuple[int, ...] = (0,)
    brief: int | None = None

    def folded(self, most: int) -> tuple[Table, ...]:
        """Several tables, each of the first column and as many of the others as a page has room for."""
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
    """What belongs together.

    Parameters
    ----------
    key : str
        Names it in a page.
    title : str
        Empty where its parts need none.
    parts : tuple
    detail : bool
        Whether a full report alone has it.
    below : bool
        Whether it belongs to the section before it.
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
        Whose result it is.
    headline : str
        What came out, in a sentence.
    sections : tuple of Section
    """

    title: str
    headline: str
    sections: tuple[Section, ...]

    def __getitem__(self, key: str) -> Section:
        """Find the section of a key."""
        return next(section for section in self.sections if section.key == key)

    @property
    def brief(self) -> Iterator[Section]:
        """The sections without those of a full report."""
        return (section for section in self.sections if not section.detail and section.parts)


def plain_rows(cells: Iterable[Sequence[str]]) -> tuple[Row, ...]:
    """Rows of nothing but cells."""
    return tuple(Row(tuple(row)) for row in cells)


def table(
    key: str, title: str, cells: Mapping[str, Iterable[str]], *, words: tuple[int, ...] = (0,), top_first: bool = False
) -> Table:
    """Make a table of whole columns, each below its header; with `top_first` their last entries are the first row."""
    rows = plain_rows(zip(*cells.values(), strict=True))
    return Table(key, title, tuple(cells), rows[::-1] if top_first else rows, words)


@singledispatch
def describe(result: object, units: Units = AUTOMATIC) -> Document:
    """Describe a result: its tables, sentences, and numbers with units.

    Parameters
    ----------
    result : object
    units : Units, optional
        In which quantities are shown; what fits their size where not given.

    Returns
    -------
    Document

    Raises
    ------
    TypeError
        Where nobody has said how a result of this type is described.
    """
    raise TypeError(f"a {type(result).__name__} has no description; register one with describe.register")


@singledispatch
def line(result: object) -> str:
    """Say a result in one short line, such as a prompt shows; by default its description's headline."""
    return f"<{type(result).__name__} {describe(result).headline}>"
