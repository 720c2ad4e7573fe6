"""How the results of the commands leave them, wherever standard output leads to."""

from __future__ import annotations

import codecs
import errno
import hashlib
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cvxshear.cli.options import used
from cvxshear.util.errors import InputError
from cvxshear.util.text import json_text, printable, shell_line
from cvxshear.util.writing import write_file
from cvxshear.version import __version__

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.util.typing import Json

typed: list[str] = []
"""What stood on the command line."""


def as_typed() -> str:
    """Write the command as it was typed; a report says how it was made."""
    return shell_line(["cvxshear", *typed])


def show(parts: Iterable[RenderableType]) -> None:
    """Print tables; plain and unwrapped where the output is not a terminal.

    Names come from files: nothing in a text is markup, and what would steer the terminal stands as its escape.
    """
    from rich.console import Console
    from rich.segment import Segment, Segments

    plain: dict[str, Any] = {} if sys.stdout.isatty() else {"width": 200, "no_color": True}
    console = Console(highlight=False, markup=False, emoji=False, **plain)
    with printing():
        for part in parts:
            whole = console.render_str(part) if isinstance(part, str) else part
            harmless = (
                Segment("\n".join(map(printable, each.text.split("\n"))), each.style, each.control)
                for each in console.render(whole)
            )
            console.print(Segments(harmless), end="")


def deliver(
    result: Json,
    out: str | None,
    tables: Callable[[], Iterable[RenderableType]],
    *files: Callable[[], None],
    title: str | None = None,
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
    title : str, optional
        Of the test, for the JSON.

    Raises
    ------
    InputError
        Where a file could not be written, after the result was printed.
    """
    writers = list(files)
    if out is not None:
        result = {**result, "about": about(used, title)}
    if out is not None and out != "-":
        writers.append(partial(write_file, out, json_text(result) + "\n"))
    failures = []
    for write in writers:
        try:
            write()
        except InputError as error:
            failures.append(str(error))
    if out == "-":
        with printing():
            every_letter = (sys.stdout.encoding or "").lower().replace("-", "").startswith("utf")
            sys.stdout.write(json_text(result, ascii_only=not every_letter) + "\n")
    else:
        show(tables())
    if failures:
        raise InputError("; ".join(failures))


def about(files: Sequence[str], title: str | None) -> Json:
    """Trace a result to its origin: version, date, title of the test, and the files read with their SHA-256.

    Parameters
    ----------
    files : sequence of str
        As they were named; a built-in example among them by its text.
    title : str or None
    """
    read = [{"name": file, "sha256": _digest(file)} for file in dict.fromkeys(files)]
    now = present()
    return {
        "cvxshear": __version__,
        "date": now.isoformat(timespec="seconds"),
        "title": title,
        "sha256": read[0]["sha256"] if read else None,
        "files": read,
    }


def present() -> datetime:
    """Return the present, or what SOURCE_DATE_EPOCH says it is (reproducible-builds.org)."""
    stamp = os.environ.get("SOURCE_DATE_EPOCH", "")
    if not stamp:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(stamp), UTC)
    except (ValueError, OverflowError, OSError):
        raise InputError(
            f"SOURCE_DATE_EPOCH = {stamp!r} must be a whole number of seconds since 1970, before the year 10000"
        ) from None


def _digest(file: str) -> str | None:
    """SHA-256 of a file's bytes; None where they cannot be read any more, or are a pattern of several."""
    from cvxshear.io.columns import LIMIT
    from cvxshear.io.inputs import read_bytes
    from cvxshear.io.toml import built_in_text, is_built_in

    try:
        content = built_in_text(file).encode() if is_built_in(file) else read_bytes(Path(file), LIMIT, "")
    except InputError:
        return None
    return hashlib.sha256(content).hexdigest()


def heading_of(report: str | None, **parts: str | None) -> dict[str, str]:
    """Collect what the command line says for the head of a report.

    Raises
    ------
    InputError
        Where no report is asked for, or a text is empty.
    """
    from cvxshear.util import checks

    given = {key: checks.text(value, f"--{key}") for key, value in parts.items() if value is not None}
    if given and report is None:
        raise InputError(f"--{next(iter(given))} belongs to a report: add --report OUT.html")
    return given


_silent: list[bool] = [False]


def silence(asked: bool) -> None:
    """Show no progress from now on, where `cvxshear --quiet` asks for that before the command."""
    _silent[0] = asked


@contextmanager
def progress(title: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on standard error, only where that is a terminal and nobody asked for quiet."""
    if quiet or _silent[0] or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def names(text: str | None) -> list[str] | None:
    """Split the names of a comma-separated option."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def numbers(
    text: str | None,
    option: str,
    right: str = "numbers with commas between, such as 9.5,7.5,5.5",
    kind: Callable[[str], Any] = float,
) -> list[Any] | None:
    """Read the numbers of a comma-separated option; `right` says in an error what it must be."""
    if text is None:
        return None
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} must be {right}, not {text!r}") from None


SPELLED = "cvxshear.spelled"
SPELLINGS = {"±": "+-", "–": "-", "−": "-", "·": "*", "°": " deg", "²": "2", "χ": "chi", "≤": "<=", "≥": ">="}
"""Spellings of characters that a terminal lacks."""


class OutputError(Exception):
    """Standard output took no more."""


@contextmanager
def sound_streams() -> Iterator[None]:
    """Make standard output and error such that any terminal takes them: escapes for what it has no letter for.

    In place of one that is closed stands the null device, lest a file opened later take its number: standard output
    as a device that cannot be written, since a result would be lost; standard error as one that takes all.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            null = os.open(os.devnull, os.O_RDONLY if name == "stdout" else os.O_WRONLY)
            setattr(sys, name, open(null, "w", encoding="utf-8", closefd=False))  # noqa: SIM115 - open to the end
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SPELLED)
    yield
    with printing():
        pass


@contextmanager
def printing() -> Iterator[None]:
    """Pass on what is printed inside, down to the last letter.

    Raises
    ------
    OutputError
        Where standard output does not take it.
    """
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        raise lost(error) from error


def lost(error: OSError) -> OutputError:
    """Make the error for a standard output that does not take what was printed; it takes all that comes after."""
    # Python flushes once more at its end, and would complain there.
    if isinstance(sys.stdout, io.TextIOWrapper):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return OutputError("it is closed" if error.errno == errno.EBADF else error.strerror)


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """Spell a character that a terminal's encoding does not have."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    spelled = [SPELLINGS.get(each) or each.encode("ascii", "backslashreplace").decode("ascii") for each in missing]
    return "".join(spelled), error.end


codecs.register_error(SPELLED, _spelled)
