"""Standard output and error, whatever they lead to: a terminal of few letters, a full disk, nobody."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SPELLED = "cvxshear.spelled"
SPELLINGS = {"±": "+-", "–": "-", "−": "-", "·": "*", "°": " deg", "²": "2", "χ": "chi", "≤": "<=", "≥": ">="}
"""For a terminal that lacks them."""


class OutputError(Exception):
    """Standard output took no more."""


def takes_unicode() -> bool:
    """Whether standard output has every letter."""
    return (sys.stdout.encoding or "").lower().replace("-", "").startswith("utf")


@contextmanager
def sound_streams() -> Iterator[None]:
    """Standard output and error as any terminal takes them: escapes for what it has no letter for.

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
    """What is printed inside, down to the last letter.

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
    """What to raise where standard output does not take what was printed; it takes all that comes after."""
    # Python flushes once more at its end, and would complain there.
    if isinstance(sys.stdout, io.TextIOWrapper):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return OutputError("it is closed" if error.errno == errno.EBADF else error.strerror)


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """What stands for a character that a terminal's encoding does not have."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    spelled = [SPELLINGS.get(each) or each.encode("ascii", "backslashreplace").decode("ascii") for each in missing]
    return "".join(spelled), error.end


codecs.register_error(SPELLED, _spelled)
