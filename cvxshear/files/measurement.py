"""Writer of the measurement file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from cvxshear.util.text import escaped, printable
from cvxshear.util.writing import write_file

WIDTH = 110
DIGITS = 8
"""Significant ones: no record tells more."""

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
    text = escaped(tomli_w.dumps(_plain(declared)))
    write_file(path, "".join([*head, "\n" * bool(head), _NUMBERS.sub(_in_one_line, text)]))


def _wrapped(comment: str) -> list[str]:
    """The comment in lines of readable length; a line break in it must not end the comment."""
    lines, current = [], ""
    for word in printable(" ".join(comment.split())).split(" "):
        if current and len(current) + len(word) + 1 > WIDTH:
            lines.append(current)
            current = "  " + word
        else:
            current = f"{current} {word}" if current else word
    return [*lines, current]


def _in_one_line(numbers: re.Match[str]) -> str:
    """A row of a shape is a line of the file."""
    return "[" + ", ".join(numbers[1].replace(",", " ").split()) + "]"


def _plain(value: Any) -> Any:
    """The value in Python's own types, numbers rounded."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
