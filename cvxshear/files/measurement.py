"""Writer of the measurement file."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from cvxshear.util.text import escaped, printable
from cvxshear.util.writing import write_file

COMMENT_WIDTH = 110
WRITTEN_DIGITS = 8
"""Significant ones: no record tells more."""

LARGE = 2_500
"""Numbers of a table from which on it is written in one piece: shapes of fifty modes at fifty floors."""

_NUMBERS = re.compile(r"\[\n((?:\s*[-+.\w]+,\n)+)\s*\]")
"""A list of numbers with one on each line. No text matches: line breaks in texts are written as escapes."""


def write_measurement(path: str | Path, declared: Mapping[str, Any], comments: Iterable[str] = ()) -> None:
    """Write a dict of the measurement file's shape as TOML.

    Parameters
    ----------
    path : str or Path
        Replaced where it exists, and only once the whole file has been written.
    declared : dict
        Tables, lists of tables, and in them texts, numbers, flags and lists of numbers.
    comments : iterable of str, optional
        Lines for the head of the file.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    head = [f"# {part}\n" for comment in comments for part in _wrapped(comment)]
    tables = _Tables()
    text = _NUMBERS.sub(_in_one_line, escaped(tomli_w.dumps(_plain(declared, tables))))
    write_file(path, "".join([*head, "\n" * bool(head), tables.put_into(text)]))


def _wrapped(comment: str) -> list[str]:
    """The comment in lines of readable length; a line break in it must not end the comment."""
    lines, current = [], ""
    for word in printable(" ".join(comment.split())).split(" "):
        if current and len(current) + len(word) + 1 > COMMENT_WIDTH:
            lines.append(current)
            current = "  " + word
        else:
            current = f"{current} {word}" if current else word
    return [*lines, current]


def _in_one_line(numbers: re.Match[str]) -> str:
    """A row of a shape is a line of the file."""
    return "[" + ", ".join(numbers[1].replace(",", " ").split()) + "]"


class _Tables:
    """Large tables of numbers, which are written row by row: number by number takes ten times as long."""

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._texts: list[str] = []

    def mark(self, table: np.ndarray[Any, Any]) -> str:
        """What stands for a table until the rest has been written."""
        row = "    [" + ", ".join([f"%.{WRITTEN_DIGITS}g"] * table.shape[1]) + "],\n"
        self._texts.append("[\n" + "".join(row % tuple(numbers) for numbers in table.tolist()) + "]")
        return f"{self._mark}{len(self._texts) - 1}"

    def put_into(self, text: str) -> str:
        """The text with the tables in their places."""
        return re.sub(rf'"{self._mark}(\d+)"', lambda found: self._texts[int(found[1])], text)


def _table_of(value: Any) -> np.ndarray[Any, Any] | None:
    """The value as a table, where it is a large one of numbers."""
    rows = len(value)
    width = len(value[0]) if rows and isinstance(value[0], list | tuple | np.ndarray) else 0
    if rows * width < LARGE:
        return None
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return found if found.ndim == 2 else None


def _plain(value: Any, tables: _Tables) -> Any:
    """The value in Python's own types, numbers rounded; a mark for a large table."""
    if isinstance(value, Mapping):
        return {key: _plain(each, tables) for key, each in value.items()}
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim):
        table = _table_of(value)
        if table is not None:
            return tables.mark(table)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each, tables) for each in value]
    return float(f"{value:.{WRITTEN_DIGITS}g}") if isinstance(value, float) else value
