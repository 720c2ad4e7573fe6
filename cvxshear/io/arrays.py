"""Read files of named arrays: MAT files with scipy and h5py, the files of NumPy, and universal files with pyuff.

pyuff (the extra `uff`) returns a file of one data set as a dict rather than a list.
"""

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from cvxshear.io.csv import Columns
from cvxshear.io.formats import LIMIT, TOO_LARGE, read_bytes, reading
from cvxshear.util.errors import InputError, optional
from cvxshear.util.typing import Floats, Json

Array = np.ndarray[Any, Any]

RATE_NAMES = re.compile(r"(.*\.)?(fs|f_s|sr|rate|sampl(e|ing)_?(rate|freq(uency)?)|fsample)(_hz)?", re.IGNORECASE)
#: Names of single numbers: a sampling rate in Hz, and a time between two samples in s.
STEP_NAMES = re.compile(r"(.*\.)?(dt|delta_?t|ts|sampl(e|ing)_?(time|interval|period))(_s)?", re.IGNORECASE)

#: Names of the directions 0 to 6; negative ones point the other way.
AXES = ("", "x", "y", "z", "rx", "ry", "rz")
#: Function type of frequency response functions in data set 58.
FRF = 4
#: Keys that pyuff returns for a complete data set; for a damaged one it omits some.
NEEDED = {58: ("x", "data", "func_type"), 55: ("r1", "node_nums")}


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
    with reading(where, "a MAT file"), warnings.catch_warnings():
        if not hdf5:
            # scipy warns of what a damaged file holds, and reads on.
            warnings.simplefilter("error")
        stream: Any = BytesIO(content)
        read = _read_hdf5(stream, h5py) if hdf5 else loadmat(stream, simplify_cells=True)
    return columns_of_arrays(read, where)


def columns_of_arrays(read: Mapping[str, Any], where: str) -> Columns:
    """Collect the longest vectors, and the matrices of the same length, with the names of `read_mat`."""
    found: dict[str, Array] = {}
    for name, array in _arrays(read):
        parts = {f"{name}_re": array.real, f"{name}_im": array.imag} if array.dtype.kind == "c" else {name: array}
        for part, values in parts.items():
            found.update(_split(part, values))
    if all(len(values) == 1 for values in found.values()):
        raise InputError(f"{where} holds no numeric vector or matrix")
    # Numbers that no double holds come out infinite, and are refused where they are used.
    with np.errstate(over="ignore", invalid="ignore"):
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in found.items()}
    longest = max(len(values) for values in arrays.values())
    return _table(where, {name: values for name, values in arrays.items() if len(values) == longest}, arrays)


def _table(where: str, columns: Mapping[str, Floats], arrays: Mapping[str, Floats]) -> Columns:
    """Make a table of vectors of one length, the sampling rate among the single numbers of all arrays."""
    table = np.column_stack(list(columns.values()))
    return Columns(where, tuple(columns), table, stated_rate=_stated_rate(arrays), arrays=arrays)


def parts_of(columns: Columns, patterns: Sequence[str]) -> Iterator[tuple[str, Columns]]:
    """Part a file of several records: each text that the `*` in the name of a column can stand for makes one.

    Parameters
    ----------
    columns : Columns
    patterns : sequence of str
        Names with a `*` (`*.acc[1]`, `base_*`), which stay the names of the parts' columns. Of a structure `*` its
        other vectors and single numbers, such as `time` or `dt`, keep their names without it.

    Yields
    ------
    star : str
    columns : Columns

    Raises
    ------
    InputError
        If a column is missing, or the columns of a part differ in length.
    """
    arrays = columns.arrays or dict(zip(columns.names, columns.values.T, strict=True))
    stars = set()
    for pattern in patterns:
        before, _, after = pattern.partition("*")
        found = [name for name in arrays if name.startswith(before) and name.endswith(after)]
        if not found:
            columns.check(pattern, "channel")
        stars |= {name[len(before) : len(name) - len(after)] for name in found}
    # Numbers ascend in names that differ by a number.
    for star in sorted(filter(None, stars), key=lambda each: (len(each), each)):
        where, stem = f"{columns.source}, {star}", patterns[0].rpartition(".")[0].replace("*", star) + "."
        own = {name.removeprefix(stem): values for name, values in arrays.items() if name.startswith(stem)}
        for name in patterns:
            if name.replace("*", star) not in arrays:
                raise InputError(f'{where}: there is no column "{name.replace("*", star)}"')
            own[name] = arrays[name.replace("*", star)]
        length = len(own[patterns[0]])
        different = next((name for name in patterns if len(own[name]) != length), None)
        if different is not None:
            raise InputError(
                f'{where}: "{different}" has {len(own[different])} samples, "{patterns[0]}" has {length}; give columns '
                "of one length"
            )
        part = _table(where, {name: values for name, values in own.items() if len(values) == length}, own)
        yield star, part if part.stated_rate else replace(part, stated_rate=columns.stated_rate)


def _stated_rate(arrays: Mapping[str, Floats]) -> tuple[str, float] | None:
    """Find a single number with the name of a sampling rate or of a time step."""
    for name, array in arrays.items():
        number = float(array[0]) if len(array) == 1 else 0.0
        if np.isfinite(number) and number > 0:
            if RATE_NAMES.fullmatch(name):
                return name, number
            if STEP_NAMES.fullmatch(name):
                return name, 1.0 / number
    return None


def _arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield the numbers, numeric vectors and matrices; those of a list, or of the last of three axes, are numbered."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
            items = value if isinstance(value, list) else value.ravel()
            yield from _arrays({f"{name}[{place}]": each for place, each in enumerate(items, 1)}, prefix)
        elif isinstance(value, np.ndarray | int | float | complex):
            array = np.asarray(value)
            if array.dtype.kind in "fiuc" and array.ndim == 3:
                each = {f"{name}[{place}]": part for place, part in enumerate(np.moveaxis(array, 2, 0), 1)}
                yield from _arrays(each, prefix)
            elif array.dtype.kind in "fiuc" and array.ndim <= 2 and array.size:
                yield prefix + name, array


def _split(name: str, array: Array) -> dict[str, Array]:
    if array.ndim < 2 or 1 in array.shape:
        return {name: array.ravel()}
    # Samples outnumber channels; the longer side is time.
    table = array if array.shape[0] >= array.shape[1] else array.T
    suffixes = ("_re", "_im")
    stem, tail = (name[:-3], name[-3:]) if name.endswith(suffixes) else (name, "")
    return {f"{stem}[{place + 1}]{tail}": table[:, place] for place in range(table.shape[1])}


def _read_hdf5(stream: Any, h5py: Any) -> Mapping[str, Any]:
    """Read the numeric data sets of a file of version 7.3 by name, a field `x` of a structure `run` as `run.x`."""
    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if not name.startswith("#") and isinstance(item, h5py.Dataset) and _numeric(item):
            values = item[()]
            if values.dtype.names is not None:
                values = values["real"] + 1j * values["imag"]
            # Version 7.3 stores matrices transposed.
            found[name.replace("/", ".")] = values.T

    with h5py.File(stream, "r") as file:
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
    with reading(where, "arrays of NumPy"):
        loaded: Any = np.load(BytesIO(content), allow_pickle=False)
        names = loaded.dtype.names if isinstance(loaded, np.ndarray) else loaded.files
        arrays = {"column": loaded} if names is None else {name: loaded[name] for name in names}
    return columns_of_arrays(arrays, where)


def read_uff(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read the functions (data set 58) of a universal file as columns.

    Parameters
    ----------
    path : str or Path
    limit : float, optional
        Bytes that the file may have.

    Returns
    -------
    Columns
        The abscissa as `time` or `frequency`; each function by its response node and direction, `1x`, `2x-`, ... (`1d9`
        for a direction outside the format); a complex function in two columns with `_re` and `_im`. A function whose
        name is taken already has its place in the file appended, `1x#7`.

    Raises
    ------
    InputError
        If the file cannot be read or its functions have different abscissae, naming the function.
    """
    where = str(path)
    if not (functions := _sets(Path(path), 58, limit)):
        raise InputError(f"{where} holds no function (data set 58)")
    axis = np.asarray(functions[0]["x"], dtype=np.float64)
    named: dict[str, Floats] = {"frequency" if int(functions[0]["func_type"]) == FRF else "time": axis}
    taken: set[str] = set()
    for place, item in enumerate(functions, 1):
        name = _name(item, place, taken)
        taken.add(name)
        other = np.asarray(item["x"], dtype=np.float64)
        values = np.asarray(item["data"])
        with np.errstate(over="ignore", invalid="ignore"):
            same = values.shape == other.shape == axis.shape and np.allclose(other, axis, rtol=1e-5, atol=1e-9)
        if not same:
            raise InputError(
                f'{where}: function {place}, channel "{name}", has {len(other)} points in steps of '
                f"{_step(other):.6g}, the first has {len(axis)} in steps of {_step(axis):.6g}; one file, one rate"
            )
        if np.iscomplexobj(values):
            named[f"{name}_re"], named[f"{name}_im"] = values.real, values.imag
        else:
            named[name] = values.astype(np.float64)
    return Columns(where, tuple(named), np.column_stack(list(named.values())))


def read_mode_uff(path: str | Path) -> Json:
    """Read the modes of a universal file; its nodes 1, 2, ... are the floors.

    Parameters
    ----------
    path : str or Path
        With data sets 55; the x direction is taken, complex shapes are made real on their main axis.

    Returns
    -------
    dict
        Keys of a table [[configuration]].

    Raises
    ------
    InputError
        If the file cannot be read or holds no mode.
    """
    where = str(path)
    if not (modes := _sets(Path(path), 55, LIMIT)):
        raise InputError(f"{where} holds no mode (data set 55)")
    nodes = [np.atleast_1d(item["node_nums"]).astype(np.int64) for item in modes]
    if any("freq" not in item for item in modes) or len({each.tobytes() for each in nodes}) > 1:
        raise InputError(f"{where}: the sets 55 are not normal modes at the same nodes")
    shapes = np.array([np.atleast_1d(item["r1"]).astype(np.complex128) for item in modes])
    frequencies = np.array([float(np.real(item["freq"])) for item in modes])
    damping = np.array([float(item.get("modal_damp_vis", 0.0)) for item in modes])
    upward, rising = np.argsort(nodes[0]), np.argsort(frequencies)
    turn = np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=1, keepdims=True)))
    result: Json = {
        "measured_floors": nodes[0][upward].tolist(),
        "frequencies": frequencies[rising].tolist(),
        "mode_shapes": (shapes * turn).real[rising][:, upward].tolist(),
    }
    if np.any(damping > 0):
        result["damping_ratios"] = np.where(damping > 0, damping, np.nan)[rising].tolist()
    return result


def _sets(path: Path, kind: int, limit: float) -> list[Json]:
    """Read the data sets of one kind, 58 (functions) or 55 (modes)."""
    where = str(path)
    # pyuff opens the file by its name; that it can be read, and how large it is, is checked here.
    read_bytes(path, limit, TOO_LARGE)
    pyuff = optional("pyuff", "universal files need")
    with reading(where, "a universal file"), warnings.catch_warnings():
        warnings.simplefilter("error")
        file = pyuff.UFF(where)
        places = [place for place, each in enumerate(file.get_set_types()) if int(each) == kind]
        found = file.read_sets(places) if places else []
    sets = [found] if isinstance(found, dict) else list(found)
    if any(key not in item for item in sets for key in NEEDED[kind]):
        raise InputError(f"{where} cannot be read as a universal file: a data set {kind} lacks its numbers")
    return sets


def _name(item: Json, place: int, taken: set[str]) -> str:
    direction = int(item.get("rsp_dir", AXES.index("x")))
    axis = AXES[abs(direction)] if abs(direction) < len(AXES) else f"d{abs(direction)}"
    name = f"{int(item.get('rsp_node', 0))}{axis}{'-' if direction < 0 else ''}"
    return f"{name}#{place}" if name in taken else name


def _step(axis: Floats) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 0.0
