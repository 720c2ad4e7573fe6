"""The one way in which the package writes files: whole or not at all.

What is written goes to a new file of a random name beside its place, is flushed to the disk and then renamed, so that
a reader, and a computer that fails in between, sees the old file or the new one. A link in that place is replaced and
what it points to is left alone. A device or a pipe has no old content to keep and is written to directly.
"""

import logging
import os
import secrets
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from cvxshear.util.errors import InputError
from cvxshear.util.quantities import listed
from cvxshear.util.text import printable

logger = logging.getLogger(__name__)

OWN_DESCRIPTORS = "/proc/self/fd"
"""Folder that /dev/stdout and /dev/fd/3 lead to under Linux; opened anew they would be written from their start."""

MOST_LINKS = 8
"""A chain of links to an own descriptor is no longer; one that goes in a circle leads nowhere."""

PathLike = str | os.PathLike[str]


def write_file(path: PathLike, content: str | bytes) -> None:
    """Write a file in one piece.

    Parameters
    ----------
    path : str or Path
    content : str or bytes
        A str is written as UTF-8; half a surrogate pair, which UTF-8 has no place for, as its escape.

    Raises
    ------
    InputError
        Where the file cannot be written; the old one is left as it was then, and nothing beside it.
    """
    check_output(path)
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    try:
        if _is_stream(path):
            _write_through(path, data)
        else:
            _replace(Path(path), data)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    logger.info("wrote %s, %d bytes", printable(str(path)), len(data))


def check_output(path: PathLike, *, endings: Iterable[str] = (), keep: Iterable[PathLike] = ()) -> None:
    """Refuse a place that nothing could be written to, before there is anything to write.

    Parameters
    ----------
    path : str or Path
    endings : iterable of str, optional
        The endings, such as ".html", that a file of this kind has; any where empty. A device has none.
    keep : iterable of str or Path, optional
        Files that must not be written over.

    Raises
    ------
    InputError
        Saying what is wrong with the place.
    """
    if not os.fspath(path).strip():
        raise InputError("the name of the file to write is empty")
    try:
        if _is_stream(path):
            return
        _check_place(Path(path))
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path!r} cannot be the name of a file: {error}") from None
    wanted = tuple(endings)
    if wanted and Path(path).suffix.lower() not in wanted:
        raise InputError(f"{path} must end in {' or '.join(wanted)}")
    for each in keep:
        if same_file(path, each):
            raise InputError(f"{path} would be written over {each}, which it is made from; name another")


def ending_of(path: str | Path, endings: Iterable[str], what: str, *, device: str | None = None) -> str:
    """Return the ending of a file's name, without its dot, once it is one that something is written as.

    Parameters
    ----------
    path : str or Path
    endings : iterable of str
    what : str
        For the message: "a model is written as".
    device : str, optional
        Which of them is meant by a device or a pipe, whose name tells none; the first where not given.

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    known = list(endings)
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending not in known and _is_stream(path):
        return known[0] if device is None else device
    if ending not in known:
        there = listed([f".{name}" for name in known], "or")
        raise InputError(f"{path}: {what} {there}; give a name with one of these endings")
    return ending


def same_file(one: PathLike, other: PathLike) -> bool:
    """Whether two names stand for one file, by whatever links, whether or not it exists."""
    with suppress(OSError, ValueError):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


def _check_place(path: Path) -> None:
    with suppress(FileNotFoundError, NotADirectoryError):
        path.lstat()
    if path.is_dir():
        raise InputError(f"{path} is a folder; name a file in it")
    if path.is_file() and not path.is_symlink() and not path.stat().st_mode & 0o222:
        raise InputError(f"{path} is read-only; name another file, or make it writable")
    if not path.parent.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {path.parent}")
    # Rights, quotas and read-only disks show only by trying.
    descriptor, beside = _new_file(path)
    os.close(descriptor)
    beside.unlink()


def _is_stream(path: PathLike) -> bool:
    """Whether the place is a device or a pipe, or leads to an open file of this process."""
    if _descriptor(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _descriptor(path: PathLike) -> int | None:
    """Find the number of the process' own open file that a name like /dev/stdout leads to."""
    place = os.fspath(path)
    own = os.path.realpath(OWN_DESCRIPTORS)
    with suppress(OSError, ValueError):
        for _ in range(MOST_LINKS):
            folder, name = os.path.split(place)
            if name.isdigit() and os.path.realpath(folder) == own:
                return int(name)
            place = os.path.join(folder, os.readlink(place))
    return None


def _write_through(path: PathLike, data: bytes) -> None:
    number = _descriptor(path)
    descriptor = os.dup(number) if number is not None else os.open(path, os.O_WRONLY)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


def _replace(path: Path, data: bytes) -> None:
    descriptor, beside = _new_file(path)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if path.is_file() and not path.is_symlink():
            beside.chmod(stat.S_IMODE(path.stat().st_mode))
        os.replace(beside, path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


def _new_file(path: Path) -> tuple[int, Path]:
    """Open a file beside `path` that did not exist, for writing, with the rights that the user's new files have."""
    beside = path.with_name(f".{secrets.token_hex(8)}.part")
    return os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666), beside
