"""What the commands share: their common options, and how results leave them."""

from __future__ import annotations

import codecs
import io
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer
from rich.console import Console, RenderableType
from rich.segment import Segment, Segments

from cvxshear.errors import InputError
from cvxshear.text import printable
from cvxshear.typing import Json
from cvxshear.writing import check_output, same_file, write_file

FIGURES = (".svg", ".png", ".pdf")
REPORT_ENDINGS = (".html", ".htm")
OTHERS_ENDINGS = (".toml", ".csv", ".xlsx", ".mat", ".uff", ".html", ".htm", ".svg", ".png", ".pdf")
"""What a file of JSON must not be called, lest a slip of the keyboard replace something else."""


def among_files(*endings: str) -> Callable[[typer.Context, typer.CallbackParam, str | None], str | None]:
    """A check of an option that names a file to write, made before the command runs."""

    def check(context: typer.Context, option: typer.CallbackParam, path: str | None) -> str | None:
        if path is not None and path != "-" and not context.resilient_parsing:
            claim(context, option.opts[0], path, endings)
        return path

    return check


def claim(context: typer.Context, name: str, path: str, endings: Sequence[str]) -> None:
    """Note a file that a command is to write, once it can be, and refuse one that it reads or writes besides.

    Parameters
    ----------
    context : typer.Context
    name : str
        The option that names it.
    path : str
    endings : sequence of str
        Those that the file may have; of JSON, which has none of its own, none that belongs to another kind.

    Raises
    ------
    InputError
        Naming the option.
    """
    try:
        check_output(path, endings=endings)
        if not endings and Path(path).suffix.lower() in OTHERS_ENDINGS:
            raise InputError(f"{path} has the ending of another kind of file; JSON is written to a .json")
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    written = context.meta.setdefault(WRITTEN, {})
    for other, place in written.items():
        if same_file(path, place):
            raise InputError(f"{name} and {other} name the same file, {path}")
    written[name] = path
    _refuse_overlap(written, context.meta.get(READ, ()))


def _among_inputs(context: typer.Context, files: Any) -> Any:
    """Note what a command reads, one file or several, and refuse to write over it."""
    if context.resilient_parsing:
        return files
    from cvxshear.formats.toml import files_of

    for file in [files] if isinstance(files, str) else files:
        # What a pipe holds can be read once; a file that is not there is for the command to complain of.
        context.meta[READ] = (*context.meta.get(READ, ()), *(files_of(file) if Path(file).is_file() else ()))
    _refuse_overlap(context.meta.get(WRITTEN, {}), context.meta[READ])
    return files


def _refuse_overlap(written: dict[str, str], read: Iterable[Path]) -> None:
    for source in read:
        for option, path in written.items():
            if same_file(path, source):
                raise InputError(f"{option}: {path} would be written over {source}, which is read; name another file")


WRITTEN, READ = f"{__name__}.written", f"{__name__}.read"

File = Annotated[
    str,
    typer.Argument(
        help="A measurement file (TOML), or 'paper' for the built-in example.", metavar="FILE", callback=_among_inputs
    ),
]
Files = Annotated[
    list[str],
    typer.Argument(
        help="A measurement file (TOML), 'paper' for the built-in example, or record files and patterns of them.",
        metavar="FILE...",
        callback=_among_inputs,
    ),
]
Records = Annotated[
    list[str],
    typer.Argument(
        help="Record files (TOML), or patterns such as 'day-1/*.toml'.", metavar="RECORD...", callback=_among_inputs
    ),
]
JsonOut = Annotated[
    str | None,
    typer.Option(
        "--json",
        help="Write the result as JSON to this file, '-' for standard output.",
        metavar="OUT",
        callback=among_files(),
    ),
]
FigureOut = Annotated[
    str | None,
    typer.Option(
        "--figure", help="Draw into this file: .svg, .png or .pdf.", metavar="OUT", callback=among_files(*FIGURES)
    ),
]
BoxesOut = Annotated[
    str | None,
    typer.Option(
        "--boxes", help="Draw box plots (Fig. 5) into this file.", metavar="OUT", callback=among_files(*FIGURES)
    ),
]
ReportOut = Annotated[
    str | None,
    typer.Option(
        "--report",
        help="Write a report, one HTML file.",
        metavar="OUT.html",
        callback=among_files(*REPORT_ENDINGS),
    ),
]
MeasurementOut = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        help="Write a measurement file here, a configuration each.",
        metavar="TOML",
        callback=among_files(".toml"),
    ),
]
UniversalOut = Annotated[
    str | None,
    typer.Option(
        "--uff",
        help="Write the modes as a universal file here.",
        metavar="UFF",
        callback=among_files(".uff", ".unv", ".u55"),
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
BackendName = Annotated[
    str, typer.Option("--backend", help="Which solver; 'cvxshear backends FILE' lists them.", metavar="NAME")
]

typed: list[str] = []
"""What stood on the command line; a report says how it was made."""


def show(parts: Iterable[RenderableType]) -> None:
    """Print tables; plain and unwrapped where the output is not a terminal.

    Names come from files: nothing in a text is markup, and what would steer the terminal stands as its escape.
    """
    plain: dict[str, Any] = {} if sys.stdout.isatty() else {"width": 200, "no_color": True}
    console = Console(highlight=False, markup=False, emoji=False, **plain)
    for part in parts:
        whole = console.render_str(part) if isinstance(part, str) else part
        console.print(Segments([_harmless(each) for each in console.render(whole)]), end="")


def _harmless(segment: Segment) -> Segment:
    lines = segment.text.split("\n")
    return Segment("\n".join(map(printable, lines)), segment.style, segment.control)


def deliver(
    result: Json,
    out: str | None,
    tables: Callable[[], Iterable[RenderableType]],
    *files: Callable[[], None],
) -> None:
    """Write what was asked for and print the result, the one even where the other fails.

    Parameters
    ----------
    result : dict
    out : str, optional
        Where its JSON goes; "-" puts it alone on standard output, in place of the tables.
    tables : callable
        What people are shown.
    *files : callable
        Each writes one more file.

    Raises
    ------
    InputError
        Where a file could not be written, after the result was printed.
    """
    writers = list(files)
    if out is not None and out != "-":
        writers.append(partial(write_file, out, to_json(result) + "\n"))
    failures = []
    for write in writers:
        try:
            write()
        except InputError as error:
            failures.append(str(error))
    if out == "-":
        sys.stdout.write(to_json(result, ascii_only=not _takes_unicode()) + "\n")
    else:
        show(tables())
    sys.stdout.flush()
    if failures:
        raise InputError("; ".join(failures))


def to_json(result: Json, *, ascii_only: bool = False) -> str:
    """The result as JSON; nan cannot stand in JSON and has no place in a result."""
    return json.dumps(result, indent=2, allow_nan=False, ensure_ascii=ascii_only)


def _takes_unicode() -> bool:
    return (sys.stdout.encoding or "").lower().replace("-", "").startswith("utf")


@contextmanager
def sound_streams() -> Iterator[None]:
    """Standard output and error as any terminal takes them: escapes for what it has no letter for.

    One that is closed is given the null device, lest a file opened later take its number; one whose reader has gone,
    or whose disk is full, raises `OutputError` in place of what Python would print at its end.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            null = os.open(os.devnull, os.O_WRONLY)
            setattr(sys, name, open(null, "w", encoding="utf-8", closefd=False))  # noqa: SIM115 - open to the end
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SPELLED)
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        # Python flushes once more at its end, and would complain there.
        if isinstance(sys.stdout, io.TextIOWrapper):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OutputError(error.strerror) from error


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """What stands for a character that a terminal's encoding does not have."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    spelled = [SPELLINGS.get(each) or each.encode("ascii", "backslashreplace").decode("ascii") for each in missing]
    return "".join(spelled), error.end


SPELLED = "cvxshear.spelled"
SPELLINGS = {"±": "+-", "–": "-", "−": "-", "·": "*", "°": " deg", "²": "2", "χ": "chi", "≤": "<=", "≥": ">="}
codecs.register_error(SPELLED, _spelled)


class OutputError(Exception):
    """Standard output took no more."""


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


def numbers(text: str | None, option: str) -> list[float] | None:
    """The numbers of a comma-separated option."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} must be numbers with commas between, such as 9.5,7.5,5.5, not {text!r}") from None
