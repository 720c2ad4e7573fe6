"""Writer of the measurement file."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.errors import InputError

WIDTH = 110


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
    path = Path(path)
    lines = [f"# {part}" for comment in comments for part in _wrapped(comment)]
    text = "\n".join([*lines, *([""] if lines else []), *_tables(declared)]) + "\n"
    try:
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(descriptor, "w", encoding="utf-8") as handle:
            handle.write(text)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def _wrapped(comment: str) -> list[str]:
    """The comment in lines of readable length; a line break in it must not end the comment."""
    lines, current = [], ""
    for word in comment.split():
        if current and len(current) + len(word) + 1 > WIDTH:
            lines.append(current)
            current = "  " + word
        else:
            current = f"{current} {word}" if current else word
    return [*lines, current]


def _tables(declared: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for name, value in declared.items():
        single = isinstance(value, Mapping)
        for table in [value] if single else value:
            lines.append(f"[{name}]" if single else f"[[{name}]]")
            lines += [*(f"{key} = {_value(item)}" for key, item in table.items()), ""]
    return lines[:-1]


def _value(item: Any) -> str:
    if isinstance(item, np.ndarray):
        item = item.tolist()
    if isinstance(item, bool | np.bool_):
        return "true" if item else "false"
    if isinstance(item, str):
        return _text(item)
    if isinstance(item, int | np.integer):
        return str(int(item))
    if isinstance(item, float | np.floating):
        return _number(float(item))
    return "[" + ", ".join(_value(each) for each in item) + "]"


def _number(value: float) -> str:
    if math.isnan(value):
        return "nan"
    text = f"{value:.8g}"
    return text if any(mark in text for mark in ".en") else text + ".0"


def _text(value: str) -> str:
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(escapes.get(c, c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}") for c in value) + '"'
