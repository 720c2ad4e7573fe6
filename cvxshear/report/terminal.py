"""Descriptions of results arranged for a terminal, and for plain text."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence

from rich.console import Console, RenderableType
from rich.table import Table as Grid
from rich.text import Text

from cvxshear.backends import ListedBackend
from cvxshear.methods import Identification
from cvxshear.report.describe import Document, Facts, Points, Section, Sentence, Table, describe
from cvxshear.report.describe.damping import damping_section
from cvxshear.report.describe.screening import doubts_section
from cvxshear.report.house_table import HouseTable, plain_table
from cvxshear.response import IdentifiedDamping
from cvxshear.screening import Finding
from cvxshear.util.quantities import AUTOMATIC, Units
from cvxshear.util.text import printable

__all__ = [
    "HouseTable",
    "damping",
    "doubts",
    "identification",
    "listed_backends",
    "plain_table",
    "rendered",
    "shown",
    "text",
]

STYLES = {"strong": "bold", "warning": "yellow", "mistake": "bold red", "": ""}

PAGE = 80
"""Columns of plain text."""


def shown(result: object, units: Units = AUTOMATIC) -> Iterator[RenderableType]:
    """A result for a terminal.

    Parameters
    ----------
    result : object
        Of a type that `describe` knows.
    units : Units, optional
        In which quantities are shown.
    """
    yield from rendered(describe(result, units))


def rendered(document: Document) -> Iterator[RenderableType]:
    """A description for a terminal: its headline, and every section but those of a full report."""
    yield Text(printable(document.headline), style="bold")
    for section in document.brief:
        yield from _section(section)


def identification(
    result: Identification, beside: Identification | None = None, units: Units = AUTOMATIC
) -> Iterator[RenderableType]:
    """An identification, and the frames of another one for comparison."""
    yield from shown(result, units)
    if beside is not None:
        yield Text(f"\nFor comparison: method {beside.method}, each configuration by itself", style="bold")
        for section in describe(beside, units).sections:
            if section.key.startswith("part-"):
                yield from _section(section)


def doubts(found: Sequence[Finding]) -> Iterator[RenderableType]:
    """Doubts above a result that was computed all the same."""
    yield from _section(doubts_section(found))


def damping(found: IdentifiedDamping) -> Iterator[RenderableType]:
    """The damping of a frame below the frame itself."""
    yield from _section(damping_section(found))


def listed_backends(listed: Sequence[ListedBackend]) -> Iterator[RenderableType]:
    """Which backends are installed, with the version of their solver, and how to get the others."""
    there = plain_table("installed", "backend", "solver", "version", "called by")
    missing = plain_table("not installed", "backend", "how to get it", words=(0, 1))
    for each in listed:
        if each.installed:
            there.add_row(each.name, each.solver or "this library", each.version or "–", each.through or "–")
        else:
            missing.add_row(each.name, each.how_to_get)
    yield there
    if missing.row_count:
        yield Text("")
        yield missing


def text(result: object, width: int = PAGE) -> str:
    """A result as plain text, folded to a width."""
    console = Console(file=io.StringIO(), width=width, color_system=None, highlight=False, markup=False, emoji=False)
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
    """Names, or marks, with texts beside them that hang where they are wrapped."""
    grid = Grid.grid(padding=(0, gap, 0, 0))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, said in pairs:
        grid.add_row(Text(printable(name)), Text(printable(said)))
    return grid


def _table(of: Table) -> RenderableType:
    table = plain_table(of.title, *of.head, words=of.words)
    brief = len(of.rows) if of.brief is None or len(of.rows) <= of.brief + 1 else of.brief
    for row in of.rows[:brief]:
        table.add_row(*row.cells)
    if brief < len(of.rows):
        table.add_row(f"and {len(of.rows) - brief} more", *([""] * (len(of.head) - 1)))
    return table
