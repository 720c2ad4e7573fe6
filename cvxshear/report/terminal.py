"""Arrange descriptions of results for a terminal, for plain text, and for a notebook."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table as Grid
from rich.text import Text

from cvxshear.backends import Solver
from cvxshear.data import noise_kinds
from cvxshear.effects import catalogue
from cvxshear.fit.results import Identification
from cvxshear.loop import VERDICTS
from cvxshear.records import ModalResult
from cvxshear.report.describe import Facts, Points, Row, Section, Sentence, Table, describe, line
from cvxshear.report.describe.from_records import doubts_section, poles_table
from cvxshear.report.describe.identified import damping_section
from cvxshear.report.describe.vocabulary import plain_rows
from cvxshear.response import IdentifiedDamping
from cvxshear.screening import FileFinding
from cvxshear.util.errors import printable
from cvxshear.util.quantities import AUTOMATIC, Units

COLUMN_GAP = 2
"""Number of spaces between columns."""

NARROWEST = 18
"""Smallest width of a wrapped column of words, in characters."""


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
        rows = (row.cells for row in self.found.rows)
        columns = [[printable(cell) for cell in column] for column in zip(self.found.head, *rows, strict=True)]
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
        # of
        # numbers therefore get a fixed width, and the columns of words get the rest.
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


def plain_table(
    title: str, *columns: str, words: tuple[int, ...] = (0,), rows: Iterable[Sequence[str]] = ()
) -> HouseTable:
    """Lay out a table in the house style: words to the left, numbers to the right, no box."""
    return HouseTable(Table("", title, columns, plain_rows(rows), words))


STYLES = {"strong": "bold", "warning": "yellow", "mistake": "bold red", "": ""}

PAGE = 80
"""Width of plain text in characters."""


def shown(result: object, units: Units = AUTOMATIC) -> Iterator[RenderableType]:
    """Render a result for a terminal: its headline and the sections of the short report.

    Parameters
    ----------
    result : object
        Result of a type that `describe` supports.
    units : Units, optional
        Units of the quantities.
    """
    document = describe(result, units)
    yield Text(printable(document.headline), style="bold")
    for section in document.brief:
        yield from _section(section)


def identification(
    result: Identification, beside: Identification | None = None, units: Units = AUTOMATIC
) -> Iterator[RenderableType]:
    """Render an identification, and the frames of another one for comparison."""
    yield from shown(result, units)
    if beside is not None:
        yield Text(f"\nFor comparison: method {beside.method}, each configuration by itself", style="bold")
        for section in describe(beside, units).sections:
            if section.key.startswith("part-"):
                yield from _section(section)


def doubts(found: Sequence[FileFinding]) -> Iterator[RenderableType]:
    """Render the warnings of a computed result."""
    yield from _section(doubts_section(found))


def poles(results: Sequence[ModalResult]) -> Iterator[RenderableType]:
    """Tabulate the numbered poles of each record, to choose modes from by hand."""
    return (_table(poles_table(result)) for result in results)


def damping(found: IdentifiedDamping) -> Iterator[RenderableType]:
    """Render the damping of a frame below the frame itself."""
    yield from _section(damping_section(found))


def listed_backends(listed: Sequence[Solver]) -> Iterator[RenderableType]:
    """Tabulate the installed backends with the version of their solver, and the way to install the others."""
    there = [(x.name, x.package or "this library", x.version or "–", x.through or "–") for x in listed if x.installed]
    yield plain_table("installed", "backend", "solver", "version", "called by", rows=there)
    if missing := [(each.name, each.how_to_get) for each in listed if not each.installed]:
        yield Text("")
        yield plain_table("not installed", "backend", "how to get it", words=(0, 1), rows=missing)


def catalogued() -> Iterator[RenderableType]:
    """Tabulate the catalogue of effects, the kinds of data with their noise, and the verdicts."""
    yield plain_table("Effects", "name", "what it is", words=(0, 1), rows=((x.name, x.summary) for x in catalogue()))
    kinds = []
    for kind in noise_kinds().values():
        (usual, most), unit = kind.sized(1.0, kind.largest / kind.default)
        kinds.append((kind.plural, f"{usual:g} {unit}", f"{most:g} {unit}", kind.reason))
    yield Text("")
    head = ("kind", "std where none is declared", "largest std", "why")
    yield plain_table("Kinds of data", *head, words=(0, 3), rows=kinds)
    yield Text("")
    verdicts = ((x.name, x.sentence) for x in VERDICTS.values())
    yield plain_table("Verdicts", "name", "what it means", words=(0, 1), rows=verdicts)


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


def _section(section: Section) -> Iterator[RenderableType]:
    if section.title:
        yield Text("")
        yield Text(printable(section.title), style="bold underline")
    for place, part in enumerate(section.parts):
        if place and isinstance(part, Table):
            yield Text("")
        yield _part(part)


def _part(part: Sentence | Points | Facts | Table) -> RenderableType:
    if isinstance(part, Sentence):
        return Text(printable(part.text), style=STYLES[part.tone])
    if isinstance(part, Points):
        return _grid([("-", each) for each in part.texts], 1)
    if isinstance(part, Facts):
        return _grid(part.pairs, 2)
    return _table(part)


def _grid(pairs: Iterator[tuple[str, str]] | list[tuple[str, str]] | tuple[tuple[str, str], ...], gap: int) -> Grid:
    """Lay out names or marks and their texts in two columns; wrapped texts stay in their column."""
    grid = Grid.grid(padding=(0, gap, 0, 0))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, said in pairs:
        grid.add_row(Text(printable(name)), Text(printable(said)))
    return grid


def _table(found: Table) -> RenderableType:
    if found.brief is None or len(found.rows) <= found.brief + 1:
        return HouseTable(found)
    more = Row((f"and {len(found.rows) - found.brief} more", *([""] * (len(found.head) - 1))))
    return HouseTable(replace(found, rows=(*found.rows[: found.brief], more)))


def line_of(result: object) -> str:
    """Write a result in one short line."""
    return printable(line(result))


FIRST_SECTION = "verdict"
"""Key of the section that a notebook illustrates with its figures."""


def notebook_html(result: object) -> str:
    """Write a result as a piece of HTML: the figure of its verdict, if any, and its tables."""
    from cvxshear.report.pages import environment  # noqa: PLC0415 - jinja2 is loaded where a page is made

    return environment().get_template("notebook.html").render(document=describe(result), pictures=_pictures(result))


def _pictures(result: object) -> list[tuple[str, str]]:
    """Draw a result's figures as PNG with their alternative texts: ids of several SVGs in a notebook would clash."""
    from cvxshear.report.figures.figure_table import applicable  # noqa: PLC0415 - loads matplotlib
    from cvxshear.report.figures.style import encoded  # noqa: PLC0415

    return [
        (entry.alternative_of(result), base64.b64encode(encoded(entry.draw(result), "png")).decode())
        for entry in applicable(result)
        if entry.section == FIRST_SECTION
    ]


def drawn(result: Any, name: str) -> Any:
    """Draw a figure of a result by its name; an empty name draws the first figure."""
    from cvxshear.report import figures  # noqa: PLC0415 - loads matplotlib

    first = next(iter(figures.figures_of(type(result))), "")
    return figures.drawn_figure(name or first, result)


def picked(result: Any, record_file: Any) -> Any:
    """Open the stabilization diagram, in which a click chooses a pole."""
    from cvxshear.report.figures import picked_poles  # noqa: PLC0415 - loads matplotlib

    return picked_poles.opened(result, record_file)
