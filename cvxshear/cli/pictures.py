"""The option --figure of the commands that have several: KIND:OUT, any number of them."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cvxshear.cli.output import figures_for
from cvxshear.errors import InputError

if TYPE_CHECKING:
    from cvxshear.report.figures.kinds import Figures

FiguresOut = Annotated[
    list[str] | None,
    typer.Option(
        "--figure",
        help="Draw a figure into this file, .svg, .png or .pdf; which one by its kind, such as mac:OUT.svg.",
        metavar="[KIND:]OUT",
    ),
]


class Pictures:
    """The figures that were asked for, checked before anything runs and drawn once there is a result.

    Parameters
    ----------
    asked : sequence of str, optional
        As typed.
    result : str
        What they are figures of: "closure", "identification" or "records".

    Raises
    ------
    InputError
        Where a kind is unknown, a file name ends in something else, or matplotlib is missing.
    """

    def __init__(self, asked: Sequence[str] | None, result: str) -> None:
        self._wanted: list[tuple[str, str]] = []
        if not asked:
            return
        figures_for(*(text.rpartition(":")[2] for text in asked))
        self._figures = _figures_of(result)
        self._wanted = [_split(text, self._figures) for text in asked]

    def draw(self, *results: Any) -> None:
        """Draw all of them, then write all of them: a figure that cannot be drawn leaves no half of a set."""
        if not self._wanted:
            return
        from cvxshear.report.figures import save

        drawn = [(self._figures[kind](*results), path) for kind, path in self._wanted]
        for figure, path in drawn:
            save(figure, path)

    def __bool__(self) -> bool:
        """Whether any was asked for."""
        return bool(self._wanted)


def _figures_of(result: str) -> Figures:
    from cvxshear.report.figures import kinds

    return {
        "closure": kinds.OF_A_CLOSURE,
        "identification": kinds.OF_AN_IDENTIFICATION,
        "records": kinds.OF_RECORDS,
    }[result]


def _split(text: str, figures: Figures) -> tuple[str, str]:
    """Kind and path; a colon after one letter belongs to a path of Windows."""
    kind, colon, path = text.partition(":")
    if not colon or len(kind) == 1:
        return next(iter(figures)), text
    if kind not in figures:
        near = difflib.get_close_matches(kind.lower(), list(figures), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"--figure: there is no figure {kind!r} here; there are {', '.join(figures)}{hint}")
    return kind, path
