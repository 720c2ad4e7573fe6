"""The reproduction on a terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cvxshear.paper.layout import columns, lines
from cvxshear.paper.results import Reproduction, Section


def render(reproduction: Reproduction) -> RenderableType:
    """Every section as a table with its notes below, the summary at the end."""
    shown: list[RenderableType] = []
    for section in reproduction.sections:
        shown += [_table(section), *(Text(note) for note in section.notes), Text()]
    return Group(*shown, Text(reproduction.summary))


def _table(section: Section) -> Table:
    table = Table(title=Text(section.title, style="bold"), title_justify="left")
    for header, numeric in columns(section):
        table.add_column(header, justify="right" if numeric else "left")
    for line in lines(section):
        # As Text, since rich would read the brackets of "Ref. [17]" as a style.
        table.add_row(*(Text(cell) for cell in line))
    return table
