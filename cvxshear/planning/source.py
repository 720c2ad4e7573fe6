"""Where a plan starts from: a file of design values, a measurement, an earlier result."""

from __future__ import annotations

import json
from pathlib import Path

from cvxshear.files.toml import is_built_in, load, parse, read_text
from cvxshear.measurement.experiment import Experiment
from cvxshear.planning.design import Design
from cvxshear.util.checks import shown
from cvxshear.util.errors import InputError


def read_design(source: str | Path | Experiment, *, fresh: bool = False) -> Design:
    """The frame before the test that a source tells of.

    Parameters
    ----------
    source : str, Path or Experiment
        "paper"; a TOML file with configurations (fitted first) or without (design values); the JSON of a result.
    fresh : bool, optional
        Count nothing of what was measured as known.

    Raises
    ------
    InputError
        Naming the file and what would be right.
    """
    if isinstance(source, Experiment):
        return Design.of_experiment(source, fresh=fresh)
    if is_built_in(source):
        return Design.of_experiment(load(source), fresh=fresh)
    path = Path(source)
    try:
        if path.suffix.lower() == ".json":
            return Design.of_result(_parsed(path), path.stem)
        declared = parse(read_text(path), path)
        if "configuration" not in declared:
            return Design.of_file(declared, path.stem)
    except InputError as error:
        raise error if str(error).startswith(str(path)) else type(error)(f"{path}: {error}") from error
    return Design.of_experiment(load(path), fresh=fresh)


def measurement_of(source: str | Path) -> Experiment | None:
    """What a file tells to have been measured; None where it holds design values or the JSON of a result.

    Raises
    ------
    InputError
        Naming the file and what would be right.
    """
    if is_built_in(source):
        return load(source)
    path = Path(source)
    if path.suffix.lower() == ".json" or "configuration" not in parse(read_text(path), path):
        return None
    return load(path)


def _parsed(path: Path) -> dict[str, object]:
    try:
        found = json.loads(read_text(path))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path} must hold the result of identify or loop, not {shown(found)}")
    return found
