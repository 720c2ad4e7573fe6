"""Reader of MAT files: version 5 and older by scipy, version 7.3 by h5py, each once it is known to be harmless."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.files import mat5, mat73
from cvxshear.files.columns import LIMIT, TOO_LARGE, Columns
from cvxshear.files.reading import read_bytes
from cvxshear.util.errors import InputError

Array = np.ndarray[Any, Any]


def read_mat(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read every numeric vector and matrix of a MAT file as columns.

    A vector is a column of its own name; a matrix `acc` of samples by channels is the columns `acc[1]`,
    `acc[2]`, ...; a field `x` of a structure `run` is `run.x`. A complex array gives two columns, its name
    with `_re` and `_im`. Arrays of another length than the longest are left out.

    Parameters
    ----------
    path : str or Path
    limit : float, optional
        Bytes that the file may have, as it is and once inflated, and so may the numbers in it.

    Returns
    -------
    Columns

    Raises
    ------
    InputError
        Where the file cannot be read, is too large, or holds no numeric columns; where it is of version 7.3 and h5py
        (the extra `mat`) is not installed.
    """
    path = Path(path)
    where = str(path)
    content = read_bytes(path, limit, TOO_LARGE, named=True)
    if b"MATLAB 7.3" in content[:128] or content.startswith(b"\x89HDF"):
        del content
        read = mat73.read(path, where, limit)
    else:
        read = mat5.read(content, where, limit)
    return columns_of_arrays(read, where)


def columns_of_arrays(read: Mapping[str, Any], where: str) -> Columns:
    """The longest vectors, and matrices of as many rows or columns, of named arrays, as `read_mat` names them."""
    found: dict[str, Array] = {}
    for name, array in _arrays(read):
        for part, values in _real_parts(name, array):
            found.update(_split(part, values))
    if not found:
        raise InputError(f"{where} holds no numeric vector or matrix")
    longest = max(len(values) for values in found.values())
    kept = {name: values for name, values in found.items() if len(values) == longest}
    # Numbers that no double holds come out infinite, and are refused where they are used.
    with np.errstate(over="ignore", invalid="ignore"):
        table = np.column_stack([np.asarray(values, dtype=np.float64) for values in kept.values()])
    return Columns(where, tuple(kept), table)


def _arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Array]]:
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiuc" and value.ndim <= 2 and value.size > 1:
            yield prefix + name, value


def _real_parts(name: str, array: Array) -> Iterator[tuple[str, Array]]:
    if array.dtype.kind == "c":
        yield from ((f"{name}_re", array.real), (f"{name}_im", array.imag))
    else:
        yield name, array


def _split(name: str, array: Array) -> dict[str, Array]:
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel()}
    # Samples outnumber channels; the longer side is time.
    table = array if array.shape[0] >= array.shape[1] else array.T
    suffixes = ("_re", "_im")
    stem, tail = (name[:-3], name[-3:]) if name.endswith(suffixes) else (name, "")
    return {f"{stem}[{place + 1}]{tail}": table[:, place] for place in range(table.shape[1])}
