"""Define the options --figure, --csv, --xlsx, --out and --export, with checks of the files before a command runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cvxshear.cli.options import FIGURES, claim, writes
from cvxshear.cli.output import show
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from cvxshear.io.spreadsheets import Sheet
    from cvxshear.report.figures import FigureEntry


LIST = "list"
"""Value of --figure that prints the available figures."""


def _among_figures(context: typer.Context, option: typer.CallbackParam, asked: list[str] | None) -> list[str] | None:
    """Check every output file of a figure before the command runs."""
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
CsvOut = Annotated[str | None, writes("--csv", what="Write the result's main table here.", endings=(".csv",))]
XlsxOut = Annotated[
    str | None, writes("--xlsx", what="Write the result's tables as a workbook here.", endings=(".xlsx",))
]
SeriesOut = Annotated[
    str | None, typer.Option("--out", help="Write the time series here: .csv, .mat or .npz.", metavar="OUT")
]


class Pictures:
    """The requested figures: checked before the command runs, and drawn from its result.

    Parameters
    ----------
    asked : sequence of str, optional
        Requests as typed; "list" alone prints the available figures and ends the command.
    result : type
        Type of the result, such as `LoopResult`.

    Raises
    ------
    InputError
        If a kind is unknown.
    """

    def __init__(self, asked: Sequence[str] | None, result: type) -> None:
        self._wanted: list[tuple[FigureEntry, str]] = []
        if not asked:
            return
        from cvxshear.report.figures import figures_of

        figures = figures_of(result)
        if LIST in asked:
            from cvxshear.report.terminal import plain_table

            title, head = "Figures: --figure KIND:OUT.svg, .png or .pdf", ("kind", "what it shows", "needs")
            rows = ((name, entry.title, entry.needs) for name, entry in figures.items())
            show([plain_table(title, *head, words=(0, 1, 2), rows=rows)])
            raise typer.Exit
        self._wanted = [_split(text, figures) for text in asked]

    @classmethod
    def named(cls, result: type, **paths: str | None) -> Pictures:
        """Collect the figures of separate options, each by the name of its figure."""
        return cls([f"{kind}:{path}" for kind, path in paths.items() if path is not None], result)

    def of(self, *results: Any, **options: Any) -> list[Callable[[], None]]:
        """Return the functions that draw and write the figures."""
        return [partial(self._drawn, entry, path, results, options) for entry, path in self._wanted]

    def _drawn(self, entry: FigureEntry, path: str, results: Sequence[Any], options: Mapping[str, Any]) -> None:
        from cvxshear.report.figures import save

        save(entry.draw(*results, **options), path)

    def __bool__(self) -> bool:
        """Return whether any figure is requested."""
        return bool(self._wanted)


def _path(text: str) -> str:
    """Return the path of a requested figure; a colon after one letter belongs to a Windows path."""
    kind, colon, path = text.partition(":")
    return path if colon and len(kind) > 1 else text


def _split(text: str, figures: Mapping[str, FigureEntry]) -> tuple[FigureEntry, str]:
    """Return the figure and the path of a request; the default is the first figure."""
    path = _path(text)
    if path == text:
        return next(iter(figures.values())), text
    kind = text[: -len(path) - 1]
    if kind not in figures:
        from cvxshear.util import checks

        hint = checks.near(kind, figures)
        raise InputError(f"--figure: there is no figure {kind!r} here; there are {', '.join(figures)}{hint}")
    return figures[kind], path


class Spreadsheets:
    """The requested tables: checked before the command runs, and written from its result.

    Parameters
    ----------
    csv, xlsx : str, optional
        Output files.

    Raises
    ------
    InputError
        If a workbook is requested and openpyxl is not installed.
    """

    def __init__(self, csv: str | None, xlsx: str | None) -> None:
        self._csv, self._xlsx = csv, xlsx
        if xlsx is not None:
            from cvxshear.io.spreadsheets import load_openpyxl

            load_openpyxl()

    def of(self, sheets: Callable[[], Sequence[Sheet]]) -> list[Callable[[], None]]:
        """Return the functions that make the tables and write the files."""
        from cvxshear.io.spreadsheets import write_csv, write_xlsx

        asked = ((write_csv, self._csv), (write_xlsx, self._xlsx))
        return [partial(_written, write, path, sheets) for write, path in asked if path is not None]


def _written(write: Callable[..., None], path: str, sheets: Callable[[], Sequence[Sheet]]) -> None:
    write(path, sheets())


def handed_over(
    context: typer.Context, option: str, paths: Iterable[str], kind_of: Callable[[str], str], write: Callable[..., None]
) -> list[Callable[..., None]]:
    """Check the output files, and return one function for each file that writes a given result.

    Parameters
    ----------
    context : typer.Context
    option : str
        Option that names the files.
    paths : iterable of str
    kind_of : callable
        (path) -> ending; raises `InputError` for an unknown ending.
    write : callable
        (path, result)
    """
    asked = list(paths)
    for path in asked:
        claim(context, option, path, [f".{kind_of(path)}"])
    return [partial(write, path) for path in asked]
