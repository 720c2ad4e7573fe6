"""Which columns a section has and how its figures are written, whatever they are written on."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.paper import tables
from cvxshear.paper.results import Row, Section

MORE_DIGITS = 2
"""Recomputed figures are shown with so many decimals more than the printed ones."""


def columns(section: Section) -> list[tuple[str, bool]]:
    """Headers, and whether figures stand below."""
    random = [("its standard error", True)] if _random(section) else []
    return [
        ("where", False), ("what", False), (section.printed_in, True), ("recomputed", True), *random,
        ("difference", True), ("agreement", False),
    ]  # fmt: skip


def lines(section: Section) -> list[list[str]]:
    """One line a row; a place in the paper is named once."""
    result, before = [], ""
    for row in section.rows:
        result.append([row.where if row.where != before else "", *_cells(row, random=_random(section))])
        before = row.where
    return result


def markdown(sections: Sequence[Section]) -> str:
    """The sections as Markdown, a table each with its notes below."""
    return "\n\n".join(_markdown(section) for section in sections)


def _markdown(section: Section) -> str:
    head = columns(section)
    table = [
        [name for name, _ in head],
        ["---:" if numeric else "---" for _, numeric in head],
        *lines(section),
    ]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in table)
    return "\n\n".join([f"## {section.title}", rows, *section.notes])


def _random(section: Section) -> bool:
    return any(row.std_error is not None for row in section.rows)


def _cells(row: Row, *, random: bool) -> list[str]:
    if row.printed.startswith("about"):
        return [row.what, row.printed, f"{row.recomputed:.2f}", f"{row.std_error or 0.0:.2f}", "", row.verdict]
    count = tables.decimals(row.printed)
    # A count of iterations has no decimals.
    more = 0 if row.what == "iterations" or random else MORE_DIGITS
    error = [f"{row.std_error:.{count}f}" if row.std_error is not None else ""] if random else []
    return [
        row.what, row.printed, _number(row.recomputed, count + more), *error,
        _number(row.difference, count + more, sign=True), row.verdict,
    ]  # fmt: skip


def _number(value: float, count: int, *, sign: bool = False) -> str:
    # Adding zero turns the -0.0 of a rounded number into 0.0.
    rounded = round(value, count) + 0.0
    return f"{rounded:+.{count}f}" if sign and rounded else f"{rounded:.{count}f}"
