"""Descriptions of results arranged for a terminal, for plain text, and for a notebook."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Column
from rich.table import Table as Grid
from rich.text import Text

from cvxshear.backends import Solver
from cvxshear.data import noise_kinds
from cvxshear.effects import catalogue
from cvxshear.loop import VERDICTS
from cvxshear.methods import Identification
from cvxshear.modal import ModalResult
from cvxshear.report.describe import Facts, Points, Section, Sentence, Table, describe, line
from cvxshear.report.describe.from_records import doubts_section, poles_table
from cvxshear.report.describe.identified import damping_section
from cvxshear.response import IdentifiedDamping
from cvxshear.screening import Finding
from cvxshear.util.errors import optional
from cvxshear.util.quantities import AUTOMATIC, Units
from cvxshear.util.text import printable

COLUMN_GAP = 2
"""Spaces between columns."""

NARROWEST = 18
"""What a column of words keeps of its width at least, where it has as much."""


class HouseTable(Grid):
    """A table without a box; where the terminal is too narrow for it, its columns go below each other in blocks.

    Parameters
    ----------
    heading : str
        Not wrapped to the table's width, as rich would.
    words : tuple of int
        Columns of words, which may be wrapped; the others hold numbers, which may not.
    """

    def __init__(self, heading: str, words: Sequence[int] = (0,)) -> None:
        super().__init__(box=None, pad_edge=False, padding=(0, COLUMN_GAP, 0, 0))
        self.heading = heading
        self.words = tuple(words)

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row; a str is data and no markup."""
        super().add_row(*(Text(printable(each)) if isinstance(each, str) else each for each in cells), **options)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self.heading:
            yield Text(printable(self.heading), style="bold")
        for place, block in enumerate(self._blocks(options.max_width)):
            if place:
                yield Text("")
            yield from super(HouseTable, block).__rich_console__(console, options)

    def _blocks(self, width: int) -> Iterator[HouseTable]:
        """Yield the table, or several of its columns each with its leading words before them."""
        least = [_least(column, at in self.words) for at, column in enumerate(self.columns)]
        if sum(least) + COLUMN_GAP * len(least) <= width:
            yield self._of(range(len(self.columns)), least, width)
            return
        lead = [at for at in range(len(self.columns)) if at in self.words and all(i in self.words for i in range(at))]
        taken = sum(least[at] + COLUMN_GAP for at in lead)
        block, used = list(lead), taken
        for at in range(len(lead), len(self.columns)):
            if len(block) > len(lead) and used + least[at] + COLUMN_GAP > width:
                yield self._of(block, least, width)
                block, used = list(lead), taken
            block.append(at)
            used += least[at] + COLUMN_GAP
        yield self._of(block, least, width)

    def _of(self, columns: Sequence[int], least: Sequence[int], width: int) -> HouseTable:
        """Cut out some of the columns, the numbers never narrower than they are."""
        block = HouseTable("", [place for place, at in enumerate(columns) if at in self.words])
        chosen = [self.columns[at] for at in columns]
        # Where the headers have to be wrapped, rich makes all columns alike, whatever their least width, and cuts what
        # then is too wide: so the columns of numbers are given theirs, and the words have the rest.
        natural = (max(cell_len(str(cell)) for cell in (each.header, *each.cells)) for each in chosen)
        tight = sum(natural) + COLUMN_GAP * len(chosen) > width + COLUMN_GAP
        for at in columns:
            block.add_column(
                self.columns[at].header,
                justify=self.columns[at].justify,
                min_width=least[at],
                width=least[at] if tight and at not in self.words else None,
            )
        for cells in zip(*(self.columns[at].cells for at in columns), strict=True):
            block.add_row(*cells)
        return block


def _least(column: Column, wraps: bool) -> int:
    """Measure the width that a column needs: its longest cell, and the longest word of its header."""
    cells = max((cell_len(str(cell)) for cell in column.cells), default=0)
    header = max((cell_len(word) for word in str(column.header).split()), default=0)
    return max(min(cells, NARROWEST), header) if wraps else max(cells, header)


def plain_table(
    title: str, *columns: str, words: Sequence[int] = (0,), rows: Iterable[Sequence[str]] = ()
) -> HouseTable:
    """Lay out a table in the house style: words to the left, numbers to the right, no box around."""
    table = HouseTable(title, words)
    for place, column in enumerate(columns):
        table.add_column(Text(printable(column)), justify="left" if place in words else "right")
    for row in rows:
        table.add_row(*row)
    return table


STYLES = {"strong": "bold", "warning": "yellow", "mistake": "bold red", "": ""}

PAGE = 80
"""Columns of plain text."""


def shown(result: object, units: Units = AUTOMATIC) -> Iterator[RenderableType]:
    """Render a result for a terminal: its headline, and every section but those of a full report.

    Parameters
    ----------
    result : object
        Of a type that `describe` knows.
    units : Units, optional
        In which quantities are shown.
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


def doubts(found: Sequence[Finding]) -> Iterator[RenderableType]:
    """Doubts above a result that was computed all the same."""
    yield from _section(doubts_section(found))


def poles(results: Sequence[ModalResult]) -> Iterator[RenderableType]:
    """Tabulate the numbered poles of each record, to choose modes from by hand."""
    return (_table(poles_table(result)) for result in results)


def damping(found: IdentifiedDamping) -> Iterator[RenderableType]:
    """Render the damping of a frame below the frame itself."""
    yield from _section(damping_section(found))


def listed_backends(listed: Sequence[Solver]) -> Iterator[RenderableType]:
    """Which backends are installed, with the version of their solver, and how to get the others."""
    there = plain_table("installed", "backend", "solver", "version", "called by")
    missing = plain_table("not installed", "backend", "how to get it", words=(0, 1))
    for each in listed:
        if each.installed:
            there.add_row(each.name, each.package or "this library", each.version or "–", each.through or "–")
        else:
            missing.add_row(each.name, each.how_to_get)
    yield there
    if missing.row_count:
        yield Text("")
        yield missing


def catalogued() -> Iterator[RenderableType]:
    """Tabulate the effects that are looked for, the kinds of data with their noise, and the verdicts."""
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
    # A console that finds itself in a notebook would show an empty block of its own there.
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
    """Names, or marks, with texts beside them that hang where they are wrapped."""
    grid = Grid.grid(padding=(0, gap, 0, 0))
    grid.add_column(no_wrap=True)
    grid.add_column()
    for name, said in pairs:
        grid.add_row(Text(printable(name)), Text(printable(said)))
    return grid


def _table(found: Table) -> RenderableType:
    brief = len(found.rows) if found.brief is None or len(found.rows) <= found.brief + 1 else found.brief
    table = plain_table(found.title, *found.head, words=found.words, rows=(row.cells for row in found.rows[:brief]))
    if brief < len(found.rows):
        table.add_row(f"and {len(found.rows) - brief} more", *([""] * (len(found.head) - 1)))
    return table


def line_of(result: object) -> str:
    """Write a result in one short line."""
    return printable(line(result))


FIRST_SECTION = "verdict"
"""Section of a description whose figures a notebook shows with the tables."""


def notebook_html(result: object) -> str:
    """Write a result as a piece of HTML: its tables, and above them the picture of its verdict where it has one."""
    try:
        from cvxshear.report.pages import environment  # noqa: PLC0415 - jinja2 is optional
    except ImportError:
        return f"<pre>{html.escape(text(result))}</pre>"
    return environment().get_template("notebook.html").render(document=describe(result), pictures=_pictures(result))


def _pictures(result: object) -> list[tuple[str, str]]:
    """Draw a result's pictures, each with what it shows, as PNG: ids of several SVGs in a notebook would clash."""
    try:
        from cvxshear.report.figures.figure_table import applicable  # noqa: PLC0415 - matplotlib is optional
        from cvxshear.report.figures.style import encoded  # noqa: PLC0415
    except ImportError:
        return []
    return [
        (entry.alternative_of(result), base64.b64encode(encoded(entry.draw(result), "png")).decode())
        for entry in applicable(result)
        if entry.section == FIRST_SECTION
    ]


def drawn(result: Any, name: str) -> Any:
    """Draw a figure of a result by its name, the first one where it is empty."""
    figures = optional("cvxshear.report.figures", "figures need", "matplotlib")
    first = next(iter(figures.figures_of(type(result))), "")
    return figures.drawn_figure(name or first, result)


def picked(result: Any, record_file: Any) -> Any:
    """Open the diagram of modes in which poles are chosen by clicking."""
    needs = "choosing poles in a diagram needs"
    return optional("cvxshear.report.figures.picked_poles", needs, "matplotlib").opened(result, record_file)
