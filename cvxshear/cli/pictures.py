"""The option --figure of the commands that have several: KIND:OUT, any number of them."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cvxshear.cli.checked import claim
from cvxshear.cli.output import FIGURES, figures_for
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from cvxshear.report.figures.kinds import Figures


def _among_figures(context: typer.Context, option: typer.CallbackParam, asked: list[str] | None) -> list[str] | None:
    """A check of every figure that is to be written, made before the command runs."""
    for text in asked or ():
        if not context.resilient_parsing:
            claim(context, option.opts[0], _path(text), FIGURES)
    return asked


FiguresOut = Annotated[
    list[str] | None,
    typer.Option(
        "--figure",
        help="Draw a figure into this file, .svg, .png or .pdf; which one by its kind, such as mac:OUT.svg.",
        metavar="[KIND:]OUT",
        callback=_among_figures,
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
        Where a kind is unknown, or matplotlib is missing.
    """

    def __init__(self, asked: Sequence[str] | None, result: str) -> None:
        self._wanted: list[tuple[str, str]] = []
        if not asked:
            return
        figures_for(*asked)
        self._figures = _figures_of(result)
        self._wanted = [_split(text, self._figures) for text in asked]

    def of(self, *results: Any) -> list[Callable[[], None]]:
        """What draws and writes each of them."""
        return [partial(self._drawn, kind, path, results) for kind, path in self._wanted]

    def _drawn(self, kind: str, path: str, results: Sequence[Any]) -> None:
        from cvxshear.report.figures import save

        save(self._figures[kind](*results), path)

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


def _path(text: str) -> str:
    """The path of a figure; a colon after one letter belongs to a path of Windows."""
    kind, colon, path = text.partition(":")
    return path if colon and len(kind) > 1 else text


def _split(text: str, figures: Figures) -> tuple[str, str]:
    """Kind and path; the first kind where none is named."""
    path = _path(text)
    if path == text:
        return next(iter(figures)), text
    kind = text[: -len(path) - 1]
    if kind not in figures:
        near = difflib.get_close_matches(kind.lower(), list(figures), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"--figure: there is no figure {kind!r} here; there are {', '.join(figures)}{hint}")
    return kind, path
