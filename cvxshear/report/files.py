"""Files that are written in one piece."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cvxshear.errors import InputError


def ending_of(path: str | Path, endings: Iterable[str], what: str) -> str:
    """The ending of a file's name, without its dot, once it is one that something is written as.

    Parameters
    ----------
    path : str or Path
    endings : iterable of str
    what : str
        For the message: "a model is written as".

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending not in endings:
        raise InputError(f"{path}: {what} {', '.join('.' + name for name in endings)}")
    return ending


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file in one piece: a reader sees the old one or the new one, never half of it.

    Parameters
    ----------
    path : str or Path
    content : str or bytes
        A str is written as UTF-8.

    Raises
    ------
    InputError
        Where the file cannot be written; nothing is left behind then.
    """
    path = Path(path)
    beside = path.with_name(path.name + ".part")
    try:
        beside.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        beside.replace(path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
