"""Describe results in words and tables; terminal, page, notebook, spreadsheet and DataFrame show the same description.

The module that describes a type of result is imported at the first result of that type.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from cvxshear.util.quantities import capital

if TYPE_CHECKING:
    from cvxshear.util.typing import Floats

Exact = float | int | str | None

#: Largest number of columns beside the first in one table of values with deviations, by the width of a page.
PAGE_COLUMNS = 6

#: Number of rows of a long table that a terminal shows.
BRIEF_ROWS = 8


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
class Column:
    """A column of a table: texts for people, and exact values for programs.

    Parameters
    ----------
    head : str
        Heading with the displayed unit; empty if only programs read the column.
    texts : tuple of str
        Cells for people.
    words : bool
        Whether the cells are words; other cells are numbers.
    name : str
        Name of the values for programs, such as "floor_mass"; empty if only people read the column.
    values, std : tuple
        Exact values and their standard deviations, in `unit`; `std` is None if the values have none.
    unit : str
        SI unit of the values.
    """

    head: str = ""
    texts: tuple[str, ...] = ()
    words: bool = False
    name: str = ""
    values: tuple[Exact, ...] = ()
    std: tuple[Exact, ...] | None = None
    unit: str = ""

    @property
    def exported(self) -> Iterator[tuple[str, tuple[Exact, ...]]]:
        """Names and values for programs: the values, then their standard deviations."""
        if self.name:
            yield self.name, self.values
            if self.std is not None:
                yield f"{self.name}_std", self.std

    def spelled(self, name: str) -> str:
        """Write an exported name with its unit as the header of a spreadsheet."""
        if self.head and not self.unit and self.std is None:
            return self.head
        words = name.replace("_", " ")
        return f"{words}, {self.unit}" if self.unit else words


@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    key : str
        Names it in a page.
    title : str
    columns : tuple of Column
    foot : tuple of str
        Cells of a last row for people, such as sums; empty without such a row.
    brief : bool
        Whether a terminal shows the first `BRIEF_ROWS` rows only.
    top_first : bool
        Whether people see the last cells in the first row: the top of a frame is above.
    indexed : bool
        Whether the first column is the index of a DataFrame.
    """

    kind: ClassVar[str] = "table"
    key: str
    title: str
    columns: tuple[Column, ...]
    foot: tuple[str, ...] = ()
    brief: bool = False
    top_first: bool = False
    indexed: bool = False

    @property
    def shown(self) -> tuple[Column, ...]:
        """Columns for people."""
        return tuple(column for column in self.columns if column.head)

    @property
    def head(self) -> tuple[str, ...]:
        """Headings for people."""
        return tuple(column.head for column in self.shown)

    @property
    def words(self) -> tuple[int, ...]:
        """Places of the columns of words, zero-based."""
        return tuple(place for place, column in enumerate(self.shown) if column.words)

    @property
    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Rows for people."""
        rows = tuple(zip(*(column.texts for column in self.shown), strict=True))
        return (*(rows[::-1] if self.top_first else rows), *([self.foot] if self.foot else []))

    @property
    def opened(self) -> int:
        """Number of rows that a short display shows; a single further row needs no mark in its place."""
        return min(len(self.rows), BRIEF_ROWS) if self.brief and len(self.rows) > BRIEF_ROWS + 1 else len(self.rows)

    def folded(self, most: int) -> tuple[Table, ...]:
        """Split the table into tables of the first column and at most `most` other columns."""
        first, *others = self.shown
        if len(others) <= most:
            return (self,)
        return tuple(
            replace(
                self,
                key=f"{self.key}-{start + 1}",
                title=f"{self.title}, continued" if start else self.title,
                columns=(first, *others[start : start + most]),
            )
            for start in range(0, len(others), most)
        )


def table(
    key: str, title: str, cells: Mapping[str, Iterable[str]], *, words: tuple[int, ...] = (0,), **options: bool
) -> Table:
    """Make a table for people from the texts of its columns by heading; the options are those of `Table`."""
    columns = (Column(head, tuple(texts), place in words) for place, (head, texts) in enumerate(cells.items()))
    return Table(key, title, tuple(columns), **options)  # type: ignore[arg-type]  # no option is the foot


def table_of_rows(key: str, title: str, head: Sequence[str], rows: Iterable[Sequence[str]], **options: Any) -> Table:
    """Make a table for people from the texts of its rows, with the options of `table`."""
    cells = list(zip(*rows, strict=True)) or [()] * len(head)
    return table(key, title, dict(zip(head, cells, strict=True)), **options)


def places(count: int, head: str = "", name: str = "") -> Column:
    """Make the column of the numbers of floors, stories or modes, from 1."""
    numbers = tuple(range(1, count + 1))
    return Column(head, tuple(map(str, numbers)), words=True, name=name, values=numbers)


def exact(
    name: str,
    values: Floats | Iterable[Exact],
    std: Floats | None = None,
    unit: str = "",
    head: str = "",
    texts: Iterable[str] = (),
) -> Column:
    """Make a column of values for programs; with a heading and texts, people read it too."""
    listed = values.tolist() if hasattr(values, "tolist") else values
    deviations = None if std is None else tuple(std.tolist())
    return Column(head, tuple(texts), name=name, values=tuple(listed), std=deviations, unit=unit)


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
    appendix : bool
        Whether a report shows the section in its appendix.
    """

    key: str
    title: str
    parts: tuple[Block, ...]
    detail: bool = False
    below: bool = False
    appendix: bool = False


#: Attribute with the content of each kind of block.
CONTENT = {"sentence": "text", "points": "texts", "facts": "pairs", "table": "rows"}


def section(key: str, title: str, *parts: Block | str, **options: bool) -> Section:
    """Make a section of the blocks that are not empty; a text stands for a sentence, the options are of `Section`."""
    blocks = (Sentence(part) if isinstance(part, str) else part for part in parts)
    return Section(key, title, tuple(each for each in blocks if getattr(each, CONTENT[each.kind])), **options)


def sentences(texts: Iterable[str]) -> tuple[str, ...]:
    """Write texts as sentences: a capital letter first, a full stop last."""
    return tuple(f"{capital(text)}." for text in texts)


def warnings(texts: Iterable[str]) -> Iterator[Sentence]:
    """Make a warning of each text."""
    return (Sentence(text, "warning") for text in texts)


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
    data : tuple of Table
        Tables for programs, the main one first; the key of a table is the name of its sheet.
    line : str
        Result in one short line for a prompt; if empty, the headline.
    heading : str
        Heading of the page; the page of a loop has the title of its test.
    """

    title: str
    headline: str
    sections: tuple[Section, ...]
    data: tuple[Table, ...] = ()
    line: str = ""
    heading: str = ""

    def __getitem__(self, key: str) -> Section:
        """Return the section with a key."""
        return next(section for section in self.sections if section.key == key)

    @property
    def brief(self) -> Iterator[Section]:
        """Sections of the short report that are not empty."""
        return (section for section in self.sections if not section.detail and section.parts)


#: Module of `report` that describes each type of result.
HOMES = {
    kind: home
    for home, kinds in {
        "identified": "Experiment Identification",
        "from_records": "ModalResult Screening",
        "closed_loop": "LoopResult",
        "responses": "IdentifiedDamping RecordPrediction Reconstruction",
        "studied": "History Plan Reproduction NoiseStudy Comparison",
    }.items()
    for kind in kinds.split()
}


@singledispatch
def describe(result: object) -> Document:
    """Describe a result: its tables, sentences, and numbers with units.

    Parameters
    ----------
    result : object

    Returns
    -------
    Document

    Raises
    ------
    TypeError
        If no description is registered for this type.
    """
    kind = type(result).__name__
    home = f"cvxshear.report.{HOMES.get(kind, '')}"
    if kind not in HOMES or home in sys.modules:
        raise TypeError(f"a {kind} has no description; register one with describe.register")
    import_module(home)
    return describe(result)
