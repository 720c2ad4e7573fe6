"""Write texts from outside safely, and files completely or not at all; every file of the package is written here.

Messages show `printable` names, which cannot control a terminal. A cell of a spreadsheet holds a `cell_text`, which
no program reads as a formula. JSON and TOML files hold `escaped` names: the file contains no control character, and
a reader of the file gets the original name.

The content goes to a new file of a random name in the same folder. This file is flushed to the disk and then renamed.
A reader therefore sees the old file or the new one, even after a crash. If the path is a link, the new file replaces
the link and its target stays unchanged. A device or a pipe has no old content and is written directly.
"""

import json
import logging
import os
import re
import secrets
import shlex
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from cvxshear.util.errors import InputError, printable
from cvxshear.util.quantities import listed

logger = logging.getLogger(__name__)

#: Names of the open files of a process. A file that is opened again by such a name is overwritten from its start.
DESCRIPTORS = {"/dev/stdout": 1, "/dev/stderr": 2}

#: First characters of a formula in spreadsheet programs, including the full-width ones (OWASP, "CSV injection").
FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")

#: Control characters except the line feed, marks that hide or reverse text, line separators and lone surrogates.
STEERING = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]")

PathLike = str | os.PathLike[str]


def cell_text(text: str) -> str:
    """Write a text as a cell of a spreadsheet: printable, with an apostrophe before a possible formula."""
    shown = printable(text)
    return f"'{shown}" if shown.lstrip(" '").startswith(FORMULA) else shown


def escaped(text: str, *, surrogates: bool = False) -> str:
    r"""Write terminal control characters in the strings of JSON or TOML as \uXXXX, which has the same meaning.

    Parameters
    ----------
    text : str
        A whole file from json or tomli_w, in which these characters occur only inside double quotes.
    surrogates : bool, optional
        Whether a lone surrogate is kept as its escape, which JSON allows; otherwise it becomes the replacement
        character.
    """

    def escape(found: re.Match[str]) -> str:
        code = ord(found[0])
        return f"\\u{0xFFFD if 0xD800 <= code <= 0xDFFF and not surrogates else code:04x}"

    return STEERING.sub(escape, text)


def shell_line(arguments: Iterable[str]) -> str:
    """Write a command for a shell; unprintable characters become their escapes."""
    return shlex.join(map(printable, arguments))


#: A list of numbers with one on each line. No text matches: line breaks in texts are written as escapes.
_NUMBERS = re.compile(r"\[\n((?:\s*[-+.\w]+,?\n)+)\s*\]")


def rows_in_lines(text: str) -> str:
    """Write each list of numbers of a JSON or TOML text in one line: a row of a shape is a line of the file."""
    return _NUMBERS.sub(lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]", text)


def json_text(value: object, *, indent: int = 2, ascii_only: bool = False) -> str:
    """Write a value as JSON, each row of numbers in one line; nan raises an error."""
    text = json.dumps(value, indent=indent, allow_nan=False, ensure_ascii=ascii_only)
    return escaped(rows_in_lines(text), surrogates=True)


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
    wanted = tuple(endings)
    if wanted and Path(path).suffix.lower() not in wanted:
        raise InputError(f"{path} must end in {' or '.join(wanted)}")
    for each in keep:
        if same_file(path, each):
            raise InputError(f"{path} would be written over {each}, which it is made from; name another")


def ending_of(path: str | Path, endings: Iterable[str], what: str) -> str:
    """Return the ending of a file's name, without its dot, after a check that this ending is allowed.

    Parameters
    ----------
    path : str or Path
        The name of a device or a pipe needs no ending; the first of `endings` is returned then.
    endings : iterable of str
    what : str
        Beginning of the message: "a figure is written as".

    Raises
    ------
    InputError
        If the name has another ending.
    """
    known = list(endings)
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending in known:
        return ending
    if _is_stream(path):
        return known[0]
    there = listed([f".{name}" for name in known], "or")
    raise InputError(f"{path}: {what} {there}; give a name with one of these endings")


def same_file(one: PathLike, other: PathLike) -> bool:
    """Return whether two names lead to the same file through any links; the file need not exist."""
    with suppress(OSError, ValueError):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


def _check_place(path: Path) -> None:
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
    there = Path(path)
    return str(path) in DESCRIPTORS or (there.exists() and not there.is_file() and not there.is_dir())


def _write_through(path: PathLike, data: bytes) -> None:
    number = DESCRIPTORS.get(str(path))
    descriptor = os.open(path, os.O_WRONLY) if number is None else os.dup(number)
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
