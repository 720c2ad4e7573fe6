"""Texts from outside: a name is data, wherever it is written to.

A person is shown `printable` names, which cannot steer a terminal. A cell of a spreadsheet holds a `cell_text`, which
no program takes for a formula. A file of names, JSON or TOML, holds them `escaped`: the name itself comes back when it
is read, and no control character stands in the file.
"""

import json
import os
import re
import secrets
import shlex
from collections.abc import Iterable
from types import NoneType

FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
"""First letters of a formula in spreadsheet programs, the full-width ones among them (OWASP, "CSV injection")."""

STEERING = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]")
"""Control characters but the line feed, marks that hide or turn text, separators of lines, halves of surrogates."""


def printable(text: str) -> str:
    """Write a text in one line that a terminal takes for text: what would steer it stands as its escape.

    Control characters, line breaks, marks that turn the direction of writing, and halves of surrogate pairs.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text)


def cell_text(text: str) -> str:
    """Write a text as a cell of a spreadsheet: printable, led by an apostrophe where it would pass for a formula."""
    shown = printable(text)
    return f"'{shown}" if shown.lstrip(" '").startswith(FORMULA) else shown


def escaped(text: str, *, surrogates: bool = False) -> str:
    r"""JSON or TOML whose strings hold what would steer a terminal as \uXXXX, which means the same there.

    Parameters
    ----------
    text : str
        A whole file, as json or tomli_w write it: such characters stand inside double quotes only.
    surrogates : bool, optional
        Whether half a surrogate pair may be written, which JSON allows; elsewhere a replacement character stands for
        it.
    """

    def escape(found: re.Match[str]) -> str:
        code = ord(found[0])
        return f"\\u{0xFFFD if 0xD800 <= code <= 0xDFFF and not surrogates else code:04x}"

    return STEERING.sub(escape, text)


def shell_line(arguments: Iterable[str]) -> str:
    r"""Write a command as it is typed in a shell; what would steer a terminal is \xNN inside $'...' (bash, zsh)."""
    return " ".join(shlex.quote(each) if each.isprintable() else f"$'{_shell_escaped(each)}'" for each in arguments)


def _shell_escaped(text: str) -> str:
    quoted = text.replace("\\", "\\\\").replace("'", "\\'")
    return "".join(
        each if each.isprintable() else "".join(f"\\x{byte:02x}" for byte in os.fsencode(each)) for each in quoted
    )


class Inserted:
    """Pieces of a text that are written beforehand; a mark stands for each until the rest is written."""

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._pieces: list[str] = []

    def mark(self, piece: str) -> str:
        """Take a piece, and return what stands for it: a text that is written in quotation marks."""
        self._pieces.append(piece)
        return f"{self._mark}{len(self._pieces) - 1}"

    def put_into(self, text: str) -> str:
        """Put every piece into its places."""
        return re.sub(rf'"{self._mark}(\d+)"', lambda found: self._pieces[int(found[1])], text)


def json_text(value: object, *, indent: int = 2, ascii_only: bool = False) -> str:
    """Write a value as JSON, each row of numbers in a line; nan cannot stand in JSON and has no place in a result."""
    rows, marks = Inserted(), dict[int, str]()

    def marked(item: object) -> object:
        # json writes indented text in Python, number by number, and a row without line breaks in C.
        if isinstance(item, dict):
            return {key: marked(each) for key, each in item.items()}
        if not isinstance(item, list | tuple):
            return item
        # A row that stands in several places is written once: the digits of its numbers are most of the time.
        if id(item) not in marks:
            if not item or not all(issubclass(kind, int | float | NoneType) for kind in set(map(type, item))):
                return [marked(each) for each in item]
            marks[id(item)] = rows.mark(json.dumps(item, allow_nan=False))
        return marks[id(item)]

    text = json.dumps(marked(value), indent=indent, allow_nan=False, ensure_ascii=ascii_only)
    return rows.put_into(escaped(text, surrogates=True))
