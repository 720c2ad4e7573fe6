"""The measurement file: an experiment as TOML."""

from __future__ import annotations

import os
import tomllib
from importlib import resources
from pathlib import Path

from cvxshear.checks import shown
from cvxshear.errors import InputError
from cvxshear.experiment import Experiment

LARGEST_FILE = 50_000_000
"""Bytes; a larger file is taken for a mistake (a record in place of a measurement file, say)."""

BUILT_IN = {"paper": ("paper", "paper.toml"), "los-alamos": ("builtin", "los-alamos.toml")}
"""Examples that travel with the package, and where they stand in it."""


def load(path: str | Path) -> Experiment:
    """Read a measurement file.

    Parameters
    ----------
    path : str or Path
        A TOML file, or a built-in example: "paper", the published two-story test frame in three configurations;
        "los-alamos", the published frequencies of a three-story structure in nine states. A file of such a name in
        the current folder is reached as "./paper", or as a Path.

    Returns
    -------
    Experiment

    Raises
    ------
    InputError
        Naming the file, and the key, the value found and what would be right.
    """
    if isinstance(path, str) and path in BUILT_IN:
        text = resources.files("cvxshear").joinpath(*BUILT_IN[path]).read_text(encoding="utf-8")
        return Experiment.from_dict(tomllib.loads(text), name=path)
    if not isinstance(path, str | os.PathLike):
        raise InputError(
            f"load takes the name of a measurement file, not {shown(path)}; a dict goes to Experiment.from_dict"
        )
    path = Path(path)
    declared = parse(read_text(path), path)
    if "record" in declared:
        raise InputError(
            f"{path} is a record file (it has a table [record]), not a measurement file: "
            f"'cvxshear modes {path} -o test.toml' makes one of it, and 'cvxshear loop {path}' takes it as it is"
        )
    try:
        return Experiment.from_dict(declared, name=path.stem)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error


def read_text(path: Path) -> str:
    """The text of a file that a user named."""
    try:
        if path.is_dir():
            raise InputError(f"{path} is a folder; name a file in it")
        # What is no regular file, a pipe say, tells no size beforehand and may never end.
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise InputError(f"{path} has more than {LARGEST_FILE / 1e6:.0f} MB, too many for a measurement file")
        return content.decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file (the built-in example is called 'paper')") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text (byte {error.start}); is it a measurement file?") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{str(path)!r} cannot be the name of a file: {error}") from None


def parse(text: str, path: Path) -> dict[str, object]:
    """The tables of a TOML text."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}") from None
    except ValueError:
        # The one that tomllib passes on: Python refuses whole numbers of more than a few thousand digits.
        raise InputError(f"{path}: a number in it has thousands of digits; is it a measurement file?") from None
    except RecursionError:
        raise InputError(f"{path} is not valid TOML: nested too deeply") from None


def is_record_file(path: str | Path) -> bool:
    """Whether a TOML file declares a record (a table [record]) and not a measurement.

    Parameters
    ----------
    path : str or Path
        "paper" is the built-in measurement file, as in `load`.

    Raises
    ------
    InputError
        Where the file cannot be read or is not TOML.
    """
    if path == "paper":
        return False
    path = Path(path)
    return "record" in parse(read_text(path), path)
