"""The option --figure of the commands that have several: KIND:OUT, any number of them."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cvxshear.cli.checked import claim
from cvxshear.cli.output import FIGURES, figures_for, show
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from cvxshear.report.figures import FigureEntry


LIST = "list"
"""What stands in place of a figure to print which there are."""


def _among_figures(context: typer.Context, option: typer.CallbackParam, asked: list[str] | None) -> list[str] | None:
    """A check of every figure that is to be written, made before the command runs."""
    for text in asked or ():
        if not context.resilient_parsing and text != LIST:
            claim(context, option.opts[0], _path(text), FIGURES)
    return asked


FiguresOut = Annotated[
    list[str] | None,
    typer.Option(
        "--figure",
        help="Draw a figure into this file, .svg, .png or .pdf; which one by its kind, such as mac:OUT.svg. "
        "'list' prints the kinds.",
        metavar="[KIND:]OUT",
        callback=_among_figures,
    ),
]


class Pictures:
    """The figures that were asked for, checked before anything runs and drawn once there is a result.

    Parameters
    ----------
    asked : sequence of str, optional
        As typed; "list" alone prints the figures that there are and ends the command.
    result : type
        Of what they are figures, such as `Closure`.

    Raises
    ------
    InputError
        Where a kind is unknown, or matplotlib is missing.
    """

    def __init__(self, asked: Sequence[str] | None, result: type) -> None:
        self._wanted: list[tuple[FigureEntry, str]] = []
        if not asked:
            return
        if LIST in asked:
            figures_for("list.svg")
            _list(result)
            raise typer.Exit
        figures_for(*map(_path, asked))
        from cvxshear.report.figures import figures_of

        self._wanted = [_split(text, figures_of(result)) for text in asked]

    def of(self, *results: Any) -> list[Callable[[], None]]:
        """What draws and writes each of them."""
        return [partial(self._drawn, entry.name, path, results) for entry, path in self._wanted]

    def _drawn(self, name: str, path: str, results: Sequence[Any]) -> None:
        from cvxshear.report.figures import drawn_figure, save

        save(drawn_figure(name, *results), path)

    def __bool__(self) -> bool:
        """Whether any was asked for."""
        return bool(self._wanted)


def _list(result: type) -> None:
    """Print the table of figures."""
    from cvxshear.report.figures import figures_of
    from cvxshear.report.terminal import plain_table

    table = plain_table(
        "Figures: --figure KIND:OUT.svg, .png or .pdf", "kind", "what it shows", "needs", words=(0, 1, 2)
    )
    for name, entry in figures_of(result).items():
        table.add_row(name, entry.title, entry.needs)
    show([table])


def _path(text: str) -> str:
    """The path of a figure; a colon after one letter belongs to a path of Windows."""
    kind, colon, path = text.partition(":")
    return path if colon and len(kind) > 1 else text


def _split(text: str, figures: Mapping[str, FigureEntry]) -> tuple[FigureEntry, str]:
    """Figure and path; the first figure where none is named."""
    path = _path(text)
    if path == text:
        return next(iter(figures.values())), text
    kind = text[: -len(path) - 1]
    if kind not in figures:
        near = difflib.get_close_matches(kind.lower(), list(figures), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"--figure: there is no figure {kind!r} here; there are {', '.join(figures)}{hint}")
    return figures[kind], path
