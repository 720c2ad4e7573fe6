"""How files that a user names are opened: no folder, no endless pipe, no more than a stated size."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from cvxshear.util.errors import InputError, printable

logger = logging.getLogger(__name__)

MEGABYTE = 1_000_000

_read_before: ContextVar[dict[str, bytes] | None] = ContextVar("read_before", default=None)
"""Content of pipes and devices by name, kept while one command runs."""


@contextmanager
def streams_read_once() -> Iterator[None]:
    """Keep what a pipe gives while this lasts: who looks at it a second time sees the same, and does not wait."""
    token = _read_before.set({})
    try:
        yield
    finally:
        _read_before.reset(token)


def read_bytes(path: Path, largest: float, remedy: str, *, absent: str = "", named: bool = False) -> bytes:
    """Read the content of a file.

    Parameters
    ----------
    path : Path
    largest : float
        Bytes; a pipe or a device, which tells no size beforehand, is read no further either.
    remedy : str
        What to do about a file that is larger.
    absent : str, optional
        What to know where there is no such file.
    named : bool, optional
        Whether the file will be opened again by its name: a pipe would hold nothing any more.

    Raises
    ------
    InputError
        Where it cannot be read or is larger.
    """
    where = str(path)
    try:
        if path.is_dir():
            raise InputError(f"{where} is a folder; name a file in it")
        if named and path.exists() and not path.is_file():
            raise InputError(f"{where} is a device or a pipe; save what it gives in a file")
        kept = None if path.is_file() else _read_before.get()
        if kept is not None and where in kept:
            return kept[where]
        with path.open("rb") as file:
            content = file.read(int(largest) + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: no such file{absent and f' ({absent})'}") from None
    except OSError as error:
        raise InputError(f"{where} cannot be read: {error.strerror}") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{str(path)!r} cannot be the name of a file: {error}") from None
    if len(content) > largest:
        raise InputError(f"{where} has more than {largest / MEGABYTE:g} MB; {remedy}")
    if kept is not None:
        kept[where] = content
    logger.info("read %s, %d bytes", printable(where), len(content))
    return content


def named_after(path: str | Path) -> str:
    """Name what a file holds after the file; bytes of its name that are no text are marked so."""
    stem = os.fsencode(Path(path).stem).decode("utf-8", "replace")
    return stem if stem.strip() else "unnamed"
