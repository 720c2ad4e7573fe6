"""Print and write the results of the commands for any kind of standard output."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cvxshear.report import terminal
from cvxshear.util.errors import InputError, printable
from cvxshear.util.writing import json_text, shell_line, write_file
from cvxshear.version import __version__

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.screening import FileFinding
    from cvxshear.util.typing import Json

#: Names of the files that the running command reads, as typed; the written results list these names.
used: list[str] = []

#: Arguments of the command line, as typed.
typed: list[str] = []


def as_typed() -> str:
    """Write the command as typed, for reports."""
    return shell_line(["cvxshear", *typed])


def show(parts: Iterable[RenderableType]) -> None:
    """Print tables; the output is plain and unwrapped outside a terminal.

    Names come from files. Texts are therefore printed without markup, and terminal control characters as escapes.
    """
    from rich.console import Console
    from rich.segment import Segment, Segments

    plain: dict[str, Any] = {} if sys.stdout.isatty() else {"width": 200, "no_color": True}
    console = Console(highlight=False, markup=False, emoji=False, **plain)
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
    """Write the requested files and print the result; a failure of one does not prevent the other.

    Parameters
    ----------
    result : dict
    out : str, optional
        File for the JSON; "-" prints only the JSON on standard output, without tables.
    tables : callable
        Returns the tables for the terminal.
    *files : callable
        Each writes one more file.
    title : str, optional
        Title of the test, for the JSON.

    Raises
    ------
    InputError
        If a file could not be written; the result is printed first.
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
        every_letter = (sys.stdout.encoding or "").lower().replace("-", "").startswith("utf")
        sys.stdout.write(json_text(result, ascii_only=not every_letter) + "\n")
    else:
        show(tables())
    if failures:
        raise InputError("; ".join(failures))


def doubts_of(found: Sequence[FileFinding] | None) -> Iterable[RenderableType]:
    """Render the warnings of a computed result."""
    from cvxshear.report.from_records import doubts_section

    return terminal.rendered(doubts_section(found or ()))


def about(files: Sequence[str], title: str | None) -> Json:
    """Return the origin of a result: version, date, title of the test, and the input files with their SHA-256.

    Parameters
    ----------
    files : sequence of str
        Names of the files as typed, or of the built-in example.
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
    """Return the present time, or the time in SOURCE_DATE_EPOCH (reproducible-builds.org)."""
    stamp = os.environ.get("SOURCE_DATE_EPOCH")
    if stamp is None:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(stamp), UTC)
    except (ValueError, OverflowError, OSError):
        raise InputError(
            f"SOURCE_DATE_EPOCH = {stamp!r} must be a whole number of seconds since 1970, before the year 10000"
        ) from None


def _digest(file: str) -> str | None:
    """Return the SHA-256 of a file's bytes; None for an unreadable file."""
    from cvxshear.io.formats import LIMIT, read_bytes
    from cvxshear.io.toml import built_in_text, is_built_in

    try:
        content = built_in_text(file).encode() if is_built_in(file) else read_bytes(Path(file), LIMIT, "")
    except InputError:
        return None
    return hashlib.sha256(content).hexdigest()


@contextmanager
def progress(title: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on standard error if standard error is a terminal and --quiet is not set."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def names(text: str | None) -> list[str] | None:
    """Split the names of a comma-separated option, each once."""
    return None if text is None else list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def numbers(
    text: str | None,
    option: str,
    right: str = "numbers with commas between, such as 9.5,7.5,5.5",
    kind: Callable[[str], Any] = float,
) -> list[Any] | None:
    """Read the numbers of a comma-separated option; `right` describes the correct form in an error message."""
    if text is None:
        return None
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} must be {right}, not {text!r}") from None


def complain(*errors: object) -> None:
    """Write errors to standard error, each in one line."""
    with suppress(OSError):
        sys.stderr.writelines(f"cvxshear: {error}\n" for error in errors)
