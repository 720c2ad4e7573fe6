"""Which module reads an experiment from its file: the public face names it, so that nothing below imports it."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from cvxshear.util.errors import InputError

_reader: list[str] = []


def read_by(module: str) -> None:
    """Name the module that reads experiments; it is imported when the first file is to be read.

    Parameters
    ----------
    module : str
        With `experiment_from_file`, which takes a path or the name of a built-in example.
    """
    _reader[:] = [module]


def experiment_in(path: str | Path) -> Any:
    """Read the experiment of a file with the module that was named for it.

    Parameters
    ----------
    path : str or Path
        Or the name of a built-in example.

    Raises
    ------
    InputError
        Where no module has been named, or the file cannot be read.
    """
    if not _reader:
        raise InputError("nobody has said how a measurement file is read")
    return importlib.import_module(_reader[0]).experiment_from_file(path)
