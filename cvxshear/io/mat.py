"""Read files of named arrays: MAT files with scipy and h5py, and the files of NumPy."""

import re
import warnings
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from cvxshear.io.columns import Columns
from cvxshear.io.formats import LIMIT, TOO_LARGE, read_bytes
from cvxshear.util.errors import InputError, optional, printable

Array = np.ndarray[Any, Any]

RATE_NAMES = re.compile(r"(.*\.)?(fs|f_s|sr|rate|sampl(e|ing)_?(rate|freq(uency)?)|fsample)(_hz)?", re.IGNORECASE)
STEP_NAMES = re.compile(r"(.*\.)?(dt|delta_?t|ts|sampl(e|ing)_?(time|interval|period))(_s)?", re.IGNORECASE)
"""Names of single numbers: a sampling rate in Hz, and a time between two samples in s."""


def read_mat(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read every numeric vector and matrix of a MAT file as columns.

    A vector is a column of its own name; a matrix `acc` of samples by channels is the columns `acc[1]`,
    `acc[2]`, ...; a field `x` of a structure `run` is `run.x`. A complex array gives two columns, its name
    with `_re` and `_im`. Shorter arrays are left out.

    Parameters
    ----------
    path : str or Path
    limit : float, optional
        Largest size of the file in bytes.

    Returns
    -------
    Columns

    Raises
    ------
    InputError
        The file cannot be read, is too large or holds no numeric columns; or its version is 7.3 and h5py (the extra
        `mat`) is not installed.
    """
    where = str(path)
    content = read_bytes(Path(path), limit, TOO_LARGE)
    hdf5 = b"MATLAB 7.3" in content[:128] or content.startswith(b"\x89HDF")
    h5py = optional("h5py", f"{where} is a MAT file of version 7.3; reading it needs") if hdf5 else None
    try:
        read = _read_hdf5(content, h5py) if hdf5 else _read_mat5(content)
    except Exception as error:
        # scipy and h5py raise various exceptions on damaged files.
        raise InputError(f"{where} is not a MAT file that can be read: {printable(str(error))[:200]}") from None
    return columns_of_arrays(read, where)


def columns_of_arrays(read: Mapping[str, Any], where: str) -> Columns:
    """Collect the longest vectors, and the matrices of the same length, with the names of `read_mat`."""
    found: dict[str, Array] = {}
    for name, array in _arrays(read):
        parts = {f"{name}_re": array.real, f"{name}_im": array.imag} if array.dtype.kind == "c" else {name: array}
        for part, values in parts.items():
            found.update(_split(part, values))
    if not found:
        raise InputError(f"{where} holds no numeric vector or matrix")
    longest = max(len(values) for values in found.values())
    kept = {name: values for name, values in found.items() if len(values) == longest}
    # Numbers that no double holds come out infinite, and are refused where they are used.
    with np.errstate(over="ignore", invalid="ignore"):
        table = np.column_stack([np.asarray(values, dtype=np.float64) for values in kept.values()])
    return Columns(where, tuple(kept), table, stated_rate=_stated_rate(read))


def _stated_rate(read: Mapping[str, Any]) -> tuple[str, float] | None:
    """Find a single number with the name of a sampling rate or of a time step."""
    for name, array in _arrays(read, lone=True):
        number = float(array.real.ravel()[0])
        if np.isfinite(number) and number > 0:
            if RATE_NAMES.fullmatch(name):
                return name, number
            if STEP_NAMES.fullmatch(name):
                return name, 1.0 / number
    return None


def _arrays(content: Mapping[str, Any], prefix: str = "", *, lone: bool = False) -> Iterator[tuple[str, Array]]:
    """Yield the numeric vectors and matrices, or with `lone` the single numbers."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.", lone=lone)
        elif isinstance(value, np.ndarray | int | float | complex):
            array = np.asarray(value)
            if array.dtype.kind in "fiuc" and array.ndim <= 2 and (array.size == 1 if lone else array.size > 1):
                yield prefix + name, array


def _split(name: str, array: Array) -> dict[str, Array]:
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel()}
    # Samples outnumber channels; the longer side is time.
    table = array if array.shape[0] >= array.shape[1] else array.T
    suffixes = ("_re", "_im")
    stem, tail = (name[:-3], name[-3:]) if name.endswith(suffixes) else (name, "")
    return {f"{stem}[{place + 1}]{tail}": table[:, place] for place in range(table.shape[1])}


def _read_mat5(content: bytes) -> Mapping[str, Any]:
    """Read the matrices and structures of a file of version 5 or older by name."""
    stream: Any = BytesIO(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read: Mapping[str, Any] = loadmat(stream, simplify_cells=True)
    return read


def _read_hdf5(content: bytes, h5py: Any) -> Mapping[str, Any]:
    """Read the numeric data sets of a file of version 7.3 by name, a field `x` of a structure `run` as `run.x`."""
    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if not name.startswith("#") and isinstance(item, h5py.Dataset) and _numeric(item):
            values = item[()]
            if values.dtype.names is not None:
                values = values["real"] + 1j * values["imag"]
            # Version 7.3 stores matrices transposed.
            found[name.replace("/", ".")] = values.T

    with h5py.File(BytesIO(content), "r") as file:
        file.visititems(visit)
    return found


def _numeric(item: Any) -> bool:
    """Return whether a data set holds numbers; MATLAB stores an empty matrix as two numbers with a mark."""
    kind = item.dtype
    plain = kind.kind in "fiu" or (kind.names == ("real", "imag") and all(kind[each].kind in "fiu" for each in (0, 1)))
    return plain and item.shape is not None and item.ndim <= 2 and item.size > 0 and "MATLAB_empty" not in item.attrs


def read_npz(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read the arrays of a .npy or .npz file as columns, named as in `read_mat`.

    Parameters
    ----------
    path : str or Path
        An array with named fields gives a column a field; another array in a file by itself, `column[1]`, `column[2]`,
        ...
    limit : float, optional
        Bytes that the file may have.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, or holds no numbers. Pickled objects are never read.
    """
    where = str(path)
    content = read_bytes(Path(path), limit, TOO_LARGE)
    try:
        loaded: Any = np.load(BytesIO(content), allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            names = loaded.dtype.names
            arrays = {"column": loaded} if names is None else {name: loaded[name] for name in names}
        else:
            arrays = {name: loaded[name] for name in loaded.files}
    except Exception as error:
        # numpy raises whatever a damaged file makes it run into.
        raise InputError(f"{where} is not a NumPy file that can be read ({type(error).__name__})") from None
    return columns_of_arrays(arrays, where)
