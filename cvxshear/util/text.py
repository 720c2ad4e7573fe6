"""Write texts from outside safely to terminals, spreadsheets, files and shells.

Messages show `printable` names, which cannot control a terminal. A cell of a spreadsheet holds a `cell_text`, which
no program reads as a formula. JSON and TOML files hold `escaped` names: the file contains no control character, and
a reader of the file gets the original name.
"""

import json
import os
import re
import secrets
import shlex
from collections.abc import Iterable
from types import NoneType

FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
"""First characters of a formula in spreadsheet programs, including the full-width ones (OWASP, "CSV injection")."""

STEERING = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]")
"""Control characters except the line feed, marks that hide or reverse text, line separators and lone surrogates."""


def printable(text: str) -> str:
    """Write a text in one line without terminal control: each unprintable character becomes its escape.

    These are control characters, line breaks, marks that change the writing direction, and lone surrogates.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text)


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
    r"""Write a command for a shell; unprintable characters become \xNN inside $'...' (bash, zsh)."""
    return " ".join(shlex.quote(each) if each.isprintable() else f"$'{_shell_escaped(each)}'" for each in arguments)


def _shell_escaped(text: str) -> str:
    quoted = text.replace("\\", "\\\\").replace("'", "\\'")
    return "".join(
        each if each.isprintable() else "".join(f"\\x{byte:02x}" for byte in os.fsencode(each)) for each in quoted
    )


class Inserted:
    """Pieces of a text that are written first; a mark replaces each piece until the rest is written."""

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._pieces: list[str] = []

    def mark(self, piece: str) -> str:
        """Store a piece and return its mark, which the text must hold in quotation marks."""
        self._pieces.append(piece)
        return f"{self._mark}{len(self._pieces) - 1}"

    def put_into(self, text: str) -> str:
        """Replace every mark by its piece."""
        return re.sub(rf'"{self._mark}(\d+)"', lambda found: self._pieces[int(found[1])], text)


def json_text(value: object, *, indent: int = 2, ascii_only: bool = False) -> str:
    """Write a value as JSON, each row of numbers in one line; nan raises an error."""
    rows, marks = Inserted(), dict[int, str]()

    def marked(item: object) -> object:
        # json writes indented text in Python, number by number, and a row without line breaks in C.
        if isinstance(item, dict):
            return {key: marked(each) for key, each in item.items()}
        if not isinstance(item, list | tuple):
            return item
        # A row that occurs several times is converted once: the conversion of numbers takes most of the time.
        if id(item) not in marks:
            if not item or not all(issubclass(kind, int | float | NoneType) for kind in set(map(type, item))):
                return [marked(each) for each in item]
            marks[id(item)] = rows.mark(json.dumps(item, allow_nan=False))
        return marks[id(item)]

    text = json.dumps(marked(value), indent=indent, allow_nan=False, ensure_ascii=ascii_only)
    return rows.put_into(escaped(text, surrogates=True))
