"""Which record files are meant: names, and patterns such as "day-1/*.toml"."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable
from pathlib import Path

from cvxshear.files.toml import is_record_file
from cvxshear.util.errors import InputError


def record_files(names: Iterable[str | Path]) -> tuple[list[Path], list[Path]]:
    """The record files that names and patterns stand for.

    Parameters
    ----------
    names : iterable of str or Path
        Files, or patterns with `*`, `?` or `[...]`.

    Returns
    -------
    files : list of Path
        Each once; those of a pattern in the order of the numbers in their names.
    left_out : list of Path
        Files that a pattern matches and that hold no table [record].

    Raises
    ------
    InputError
        Where a pattern matches no record file, or a file that it matches cannot be read.
    """
    files: list[Path] = []
    left_out: list[Path] = []
    for name in names:
        if Path(name).exists() or not glob.has_magic(str(name)):
            found = [Path(name)]
        else:
            matched = [Path(path) for path in sorted(glob.glob(str(name), recursive=True), key=_by_number)]
            found = [path for path in matched if path.is_file() and is_record_file(path)]
            left_out += [path for path in matched if path not in found]
            if not found:
                raise InputError(f"{name}: no record file is called so; a record file is TOML with a table [record]")
        files += [path for path in found if path not in files]
    return files, left_out


def _by_number(path: str) -> list[tuple[int, str]]:
    """Run 2 comes before run 10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", path)]
