"""Readers of files of named arrays: MAT files and those of NumPy, each once it is known to be harmless.

MAT files of version 5 and older are read by scipy in a process of its own. Those of version 7.3 are HDF5 files. Of what
HDF5 offers, MATLAB writes groups and data sets that stand in the file itself under one name each, plain or deflated.
The rest (links by name, other files, other filters) is refused before anything is read.
"""

import json
import os
import re
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.io.columns import LIMIT, TOO_LARGE, Columns
from cvxshear.io.inputs import MEGABYTE, read_bytes
from cvxshear.util.errors import InputError, optional
from cvxshear.util.text import printable

Array = np.ndarray[Any, Any]

RATE_NAMES = re.compile(r"(.*\.)?(fs|f_s|sr|rate|sampl(e|ing)_?(rate|freq(uency)?)|fsample)(_hz)?", re.IGNORECASE)
STEP_NAMES = re.compile(r"(.*\.)?(dt|delta_?t|ts|sampl(e|ing)_?(time|interval|period))(_s)?", re.IGNORECASE)
"""What a lone number is called that is a sampling rate, Hz, or the time between two samples, s."""


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
        read = _read_hdf5(path, where, limit)
    else:
        read = _read_mat5(content, where, limit)
    return columns_of_arrays(read, where)


def columns_of_arrays(read: Mapping[str, Any], where: str) -> Columns:
    """List the longest vectors, and matrices of as many rows or columns, of named arrays, as `read_mat` names them."""
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
    """Find the lone number that is called a sampling rate, or the step of one."""
    for name, array in _arrays(read, lone=True):
        number = float(array.real.ravel()[0])
        if np.isfinite(number) and number > 0:
            if RATE_NAMES.fullmatch(name):
                return name, number
            if STEP_NAMES.fullmatch(name):
                return name, 1.0 / number
    return None


def _arrays(content: Mapping[str, Any], prefix: str = "", *, lone: bool = False) -> Iterator[tuple[str, Array]]:
    """Yield the numeric vectors and matrices, or the lone numbers."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.", lone=lone)
        elif (
            isinstance(value, np.ndarray)
            and value.dtype.kind in "fiuc"
            and value.ndim <= 2
            and (value.size == 1 if lone else value.size > 1)
        ):
            yield prefix + name, value


def _split(name: str, array: Array) -> dict[str, Array]:
    if array.ndim == 1 or 1 in array.shape:
        return {name: array.ravel()}
    # Samples outnumber channels; the longer side is time.
    table = array if array.shape[0] >= array.shape[1] else array.T
    suffixes = ("_re", "_im")
    stem, tail = (name[:-3], name[-3:]) if name.endswith(suffixes) else (name, "")
    return {f"{stem}[{place + 1}]{tail}": table[:, place] for place in range(table.shape[1])}


MOST_SECONDS = 60.0
"""Seconds that reading a MAT file may take: a sound one of 100 MB takes two, and a damaged one may never end."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of the process that reads a MAT file: each thread of linear algebra takes memory that is limited."""


def _read_mat5(content: bytes, where: str, limit: float) -> Mapping[str, Any]:
    """Read the numeric arrays of a file of version 5 or older by name in a process of its own (`files/mat5.py`)."""
    try:
        read = subprocess.run(
            [sys.executable, "-P", str(Path(__file__).with_name("mat5.py")), str(limit)],
            input=content, capture_output=True, timeout=MOST_SECONDS, env={**os.environ, **ONE_THREAD}, check=True,
        )  # fmt: skip
    except subprocess.SubprocessError:
        raise InputError(f"{where} is not a MAT file that can be read: it ends the process that reads it") from None
    output = BytesIO(read.stdout)
    said = json.loads(output.readline())
    if "large" in said:
        raise InputError(f"{where} holds more than {limit / MEGABYTE:g} MB of numbers; {TOO_LARGE}")
    if "error" in said:
        raise InputError(f"{where} is not a MAT file that can be read: {printable(said['error'])[:200]}")
    return {name: np.lib.format.read_array(output, allow_pickle=False) for name in said["names"]}


MOST_DEPTH = 32
MOST_ARRAYS = 100_000
"""Matrices, and fields of structures, in one file."""

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3
"""Numbers of HDF5's own filters."""

MOST_INFLATION = 1032
"""Largest ratio of a content's size to what deflate makes of it."""


def _read_hdf5(path: Path, where: str, limit: float) -> Mapping[str, Any]:
    """Collect the numeric data sets of a file by name, those of groups in mappings of their own.

    Parameters
    ----------
    path : Path
    where : str
        The file, for messages.
    limit : float
        Bytes of its numbers.
    """
    h5py = optional("h5py", f"{where} is a MAT file of version 7.3; reading it needs")
    try:
        with h5py.File(path, "r") as file:
            return _Walk(h5py, limit, path.stat().st_size, limit).group(file, "", 1)
    except InputError as error:
        raise InputError(f"{where}{error}") from None
    except Exception as error:
        # h5py raises whatever HDF5 runs into.
        raise InputError(f"{where} is not a MAT file that can be read: {str(error)[:200]}") from None


@dataclass
class _Walk:
    """The way through one file.

    Parameters
    ----------
    h5py : module
    limit : float
        Bytes of numbers that may be read.
    stored : int
        Bytes of the file.
    left : float
        Bytes of numbers that may still be read.
    """

    h5py: Any
    limit: float
    stored: int
    left: float
    visited: set[int] = field(default_factory=set)
    members: int = 0

    def group(self, group: Any, name: str, depth: int) -> Mapping[str, Any]:
        if depth > MOST_DEPTH:
            raise InputError(f" has structures more than {MOST_DEPTH} deep; save the numbers themselves")
        address = self.h5py.h5o.get_info(group.id).addr
        if address in self.visited:
            raise InputError(f': "{name}" is a second name of a structure, and leads in a circle; save it anew')
        self.visited.add(address)
        found: dict[str, Any] = {}
        for member in group:
            if member.startswith("#"):
                continue
            self.members += 1
            if self.members > MOST_ARRAYS:
                raise InputError(f" has more than {MOST_ARRAYS} matrices and fields; save the numbers themselves")
            shown = f"{name}.{member}".lstrip(".")
            if not isinstance(group.get(member, getlink=True), self.h5py.HardLink):
                raise InputError(f': "{shown}" is a link; only numbers that stand in the file itself are read')
            item = group[member]
            if isinstance(item, self.h5py.Group):
                found[member] = self.group(item, shown, depth + 1)
            elif isinstance(item, self.h5py.Dataset) and _numeric(item):
                found[member] = self.numbers(item, shown)
        return found

    def numbers(self, item: Any, name: str) -> Any:
        """Read a data set as an array; version 7.3 stores matrices transposed."""
        self.left -= 8 * item.size * (1 if item.dtype.names is None else 2)
        if self.left < 0:
            raise InputError(f" holds more than {self.limit / MEGABYTE:g} MB of numbers; {TOO_LARGE}")
        if item.external or item.is_virtual:
            raise InputError(f': the numbers of "{name}" stand in another file; only this one is read')
        if item.chunks is not None:
            self._check_chunks(item, name)
        values = item[()]
        if values.dtype.names is not None:
            values = values["real"] + 1j * values["imag"]
        return values.T

    def _check_chunks(self, item: Any, name: str) -> None:
        """Refuse pieces that would inflate to more than they stand for."""
        made = item.id.get_create_plist()
        filters = [made.get_filter(place)[0] for place in range(made.get_nfilters())]
        if not set(filters) <= {DEFLATE, SHUFFLE, CHECKSUM} or len(set(filters)) < len(filters):
            raise InputError(f': "{name}" is compressed in a way that MATLAB does not use; save it anew')
        size = int(np.prod(item.chunks, dtype=object)) * item.dtype.itemsize
        if size > self.limit:
            raise InputError(f' holds pieces of more than {self.limit / MEGABYTE:g} MB, in "{name}"; {TOO_LARGE}')
        for place in range(item.id.get_num_chunks()):
            piece = item.id.get_chunk_info(place)
            if piece.size > self.stored:
                raise InputError(f': a piece of "{name}" is larger than the file')
            if piece.size * MOST_INFLATION > self.limit and DEFLATE in filters:
                # A checksum of four bytes may stand behind the numbers.
                packed = item.id.read_direct_chunk(piece.chunk_offset)[1]
                if len(zlib.decompressobj().decompress(packed, size + 5)) > size + 4:
                    raise InputError(f': a piece of "{name}" inflates to more than it stands for')


def _numeric(item: Any) -> bool:
    """Whether a data set is numbers; what MATLAB calls empty has a mark, and two numbers."""
    kind = item.dtype
    plain = kind.kind in "fiu" or (kind.names == ("real", "imag") and all(kind[each].kind in "fiu" for each in (0, 1)))
    return plain and item.shape is not None and item.ndim <= 2 and item.size > 0 and "MATLAB_empty" not in item.attrs


LONE = "column"
"""The name of a lone array that has none: its columns are `column[1]`, `column[2]`, ..."""


def read_npz(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read the arrays of a .npy or .npz file as columns, named as those of a MAT file.

    Parameters
    ----------
    path : str or Path
        An array with named fields gives a column a field.
    limit : float, optional
        Bytes that the file may have, as it is and once inflated.

    Raises
    ------
    InputError
        Where the file cannot be read, is too large, or holds no numbers. Pickled objects are never read.
    """
    where = str(path)
    content = BytesIO(read_bytes(Path(path), limit, TOO_LARGE))
    try:
        if zipfile.is_zipfile(content):
            with zipfile.ZipFile(content) as archive:
                inflated = sum(each.file_size for each in archive.infolist())
            if inflated > limit:
                raise InputError(f"{where} inflates to more than {limit / MEGABYTE:g} MB; {TOO_LARGE}")
        content.seek(0)
        loaded: Any = np.load(content, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            names = loaded.dtype.names
            arrays = {LONE: loaded} if names is None else {name: loaded[name] for name in names}
        else:
            arrays = {name: loaded[name] for name in loaded.files}
    except InputError:
        raise
    except Exception as error:
        # numpy raises whatever a damaged file makes it run into.
        raise InputError(f"{where} is not a NumPy file that can be read ({type(error).__name__})") from None
    return columns_of_arrays(arrays, where)
