"""Reader of MAT files: version 5 by scipy, version 7.3 by h5py."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from cvxshear.errors import InputError
from cvxshear.formats.columns import Columns


def read_mat(path: str | Path) -> Columns:
    """Read every numeric vector and matrix of a MAT file as columns.

    A vector is a column of its own name; a matrix `acc` of samples by channels is the columns `acc[1]`,
    `acc[2]`, ...; a field `x` of a structure `run` is `run.x`. A complex array gives two columns, its name
    with `_re` and `_im`. Arrays of another length than the longest are left out.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Columns

    Raises
    ------
    InputError
        Where the file cannot be read, or holds no numeric columns; where it is of version 7.3 and h5py (the
        extra `mat`) is not installed.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(128)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    content = _version_7(path) if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF") else _version_5(path)
    found: dict[str, np.ndarray[Any, Any]] = {}
    for name, array in _arrays(content):
        for part, values in _real_parts(name, array):
            found.update(_split(part, values))
    if not found:
        raise InputError(f"{path} holds no numeric vector or matrix")
    longest = max(len(values) for values in found.values())
    kept = {name: values for name, values in found.items() if len(values) == longest}
    return Columns(str(path), tuple(kept), np.column_stack([np.asarray(v, dtype=np.float64) for v in kept.values()]))


def _version_5(path: Path) -> Mapping[str, Any]:
    try:
        return io.loadmat(str(path), simplify_cells=True)
    except (ValueError, TypeError, NotImplementedError, OSError) as error:
        raise InputError(f"{path} is not a MAT file that can be read: {error}") from None


def _version_7(path: Path) -> Mapping[str, Any]:
    try:
        h5py = importlib.import_module("h5py")
    except ImportError:
        raise InputError(f"{path} is a MAT file of version 7.3; reading it needs h5py: install cvxshear[mat]") from None
    try:
        with h5py.File(path, "r") as file:
            return {name: _loaded(file[name]) for name in file if not name.startswith("#")}
    except OSError as error:
        raise InputError(f"{path} is not a MAT file that can be read: {error}") from None


def _loaded(item: Any) -> Any:
    """A data set as an array, a group as a mapping; version 7.3 stores matrices transposed."""
    if hasattr(item, "keys"):
        return {name: _loaded(item[name]) for name in item}
    values = item[()]
    if isinstance(values, np.ndarray) and values.dtype.names == ("real", "imag"):
        values = values["real"] + 1j * values["imag"]
    return values.T if isinstance(values, np.ndarray) else values


def _arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiuc" and value.ndim <= 2 and value.size > 1:
            yield prefix + name, value


def _real_parts(name: str, array: np.ndarray[Any, Any]) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    if array.dtype.kind == "c":
        yield from ((f"{name}_re", array.real), (f"{name}_im", array.imag))
    else:
        yield name, array


def _split(name: str, array: np.ndarray[Any, Any]) -> dict[str, np.ndarray[Any, Any]]:
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel()}
    # Samples outnumber channels; the longer side is time.
    table = array if array.shape[0] >= array.shape[1] else array.T
    suffixes = ("_re", "_im")
    stem, tail = (name[:-3], name[-3:]) if name.endswith(suffixes) else (name, "")
    return {f"{stem}[{place + 1}]{tail}": table[:, place] for place in range(table.shape[1])}
