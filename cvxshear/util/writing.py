"""Write files completely or not at all; every file of the package is written here.

The content goes to a new file of a random name in the same folder. This file is flushed to the disk and then renamed.
A reader therefore sees the old file or the new one, even after a crash. If the path is a link, the new file replaces
the link and its target stays unchanged. A device or a pipe has no old content and is written directly.
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
"""Folder behind /dev/stdout and /dev/fd/3 under Linux. A file that is opened again there is overwritten from its
start."""

MOST_LINKS = 8
"""Largest number of links that are followed to a descriptor of this process; the limit ends circular chains."""

PathLike = str | os.PathLike[str]


def write_file(path: PathLike, content: str | bytes) -> None:
    """Write a file in one piece.

    Parameters
    ----------
    path : str or Path
    content : str or bytes
        A str is written as UTF-8. UTF-8 cannot hold a lone surrogate, which becomes its escape.

    Raises
    ------
    InputError
        If the file cannot be written. The old file then stays unchanged, and no temporary file remains.
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
    """Check in advance that a path can be written.

    Parameters
    ----------
    path : str or Path
    endings : iterable of str, optional
        Allowed endings, such as ".html"; if empty, any ending is allowed. A device needs no ending.
    keep : iterable of str or Path, optional
        Files that must not be overwritten.

    Raises
    ------
    InputError
        If the path cannot be written; the message gives the reason.
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
    """Return the ending of a file's name, without its dot, after a check that this ending is allowed.

    Parameters
    ----------
    path : str or Path
    endings : iterable of str
    what : str
        Beginning of the message: "a model is written as".
    device : str, optional
        Ending for a device or a pipe: the name of a device has no ending. Default: the first of `endings`.

    Raises
    ------
    InputError
        If the name has another ending.
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
    """Return whether two names lead to the same file through any links; the file need not exist."""
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
    # Only an attempt to write reveals rights, quotas and read-only disks.
    descriptor, beside = _new_file(path)
    os.close(descriptor)
    beside.unlink()


def _is_stream(path: PathLike) -> bool:
    """Return whether the path is a device or a pipe, or leads to an open file of this process."""
    if _descriptor(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _descriptor(path: PathLike) -> int | None:
    """Find the number of the open file of this process behind a name like /dev/stdout."""
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
    """Open a new file for writing in the folder of `path`, with the usual rights of the user's new files."""
    beside = path.with_name(f".{secrets.token_hex(8)}.part")
    return os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666), beside
