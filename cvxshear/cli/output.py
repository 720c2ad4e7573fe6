"""What the commands share: their common options, and how results leave them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Annotated

import typer
from rich.console import Console, RenderableType

from cvxshear.errors import InputError
from cvxshear.report.files import write_whole
from cvxshear.typing import Json

File = Annotated[
    str, typer.Argument(help="A measurement file (TOML), or 'paper' for the built-in example.", metavar="FILE")
]
JsonOut = Annotated[
    str | None,
    typer.Option("--json", help="Write the result as JSON to this file, '-' for standard output.", metavar="OUT"),
]
FigureOut = Annotated[
    str | None, typer.Option("--figure", help="Draw into this file: .svg, .png or .pdf.", metavar="OUT")
]
UnitsOption = Annotated[
    str | None,
    typer.Option("--units", help="Units that quantities are shown in, such as t,kN,mm.", metavar="MASS,FORCE,LENGTH"),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
BackendName = Annotated[
    str, typer.Option("--backend", help="Which solver; 'cvxshear backends FILE' lists them.", metavar="NAME")
]

typed: list[str] = []
"""What stood on the command line; a report says how it was made."""


def show(parts: Iterable[RenderableType]) -> None:
    """Print tables; plain and unwrapped where the output is not a terminal."""
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=200, no_color=True)
    for part in parts:
        console.print(part)


def deliver(result: Json, out: str | None, tables: Callable[[], Iterable[RenderableType]]) -> None:
    """JSON alone on standard output for '-'; else tables for people, and JSON into a file where one is named."""
    if out == "-":
        typer.echo(to_json(result))
        return
    if out is not None:
        write_whole(out, to_json(result) + "\n")
    show(tables())


def to_json(result: Json) -> str:
    """The result as JSON; nan cannot stand in JSON and has no place in a result."""
    return json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False)


def figures_for(*paths: str | None) -> ModuleType | None:
    """The figures, where one is asked for; a wrong ending or a missing package is told before anything runs."""
    asked = [path for path in paths if path is not None]
    if not asked:
        return None
    try:
        from cvxshear.report import figures
        from cvxshear.report.figures.output import kind_of
    except ImportError as error:
        raise InputError(f"--figure needs {error.name}: pip install 'cvxshear[plot]'") from error
    for path in asked:
        kind_of(path)
    return figures


@contextmanager
def progress(title: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on standard error, only where that is a terminal and nobody asked for quiet."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def names(text: str | None) -> list[str] | None:
    """The names of a comma-separated option."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]
