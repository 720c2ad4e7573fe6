"""MAT files of version 5 and older.

A file of version 5 is a header and a row of elements, each a tag (kind and size) and what it announces; a matrix
holds elements in turn. The tags are followed here, each against what is there, and compressed elements are inflated to
a stated size and against their checksum. scipy's reader believes the tags: a matrix that says it is complex and has no
imaginary part ends the whole process. So it reads only files of version 4, which have no tags.
"The MAT-file format" (MathWorks) has the tags.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from math import prod
from typing import Any

import numpy as np
from scipy import io

from cvxshear.files.columns import TOO_LARGE
from cvxshear.files.inputs import MEGABYTE
from cvxshear.util.errors import InputError

MAT_HEADER = 128
MOST_DEPTH = 32
MOST_ARRAYS = 100_000
"""Matrices, and fields of structures, in one file."""

MATRIX, COMPRESSED = 14, 15
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How the numbers of each kind of element are stored."""

CELL, STRUCTURE = 1, 2
NUMERIC = range(6, 16)
"""Classes of matrices that are read; characters, sparse matrices and objects hold no columns of a record."""

COMPLEX_FLAG = 0x0800
"""The flag of a matrix with an imaginary part."""

Element = tuple[int, memoryview]


class _DamagedError(Exception):
    """The tags do not fit each other."""


@dataclass
class _Budget:
    """What may still be taken from a file."""

    limit: float
    inflated: float
    numbers: float
    arrays: int = MOST_ARRAYS


def read(content: bytes, where: str, limit: float) -> Mapping[str, Any]:
    """Read the numeric arrays of a file by name, those of a structure in a dict of its own; the rest is left out.

    Parameters
    ----------
    content : bytes
    where : str
        The file, for messages.
    limit : float
        Bytes of the file once inflated, and of its numbers.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            opened: Any = BytesIO(content)
            if io.matlab.matfile_version(opened)[0] == 1:
                return _variables(content, limit)
            return io.loadmat(opened, simplify_cells=True)
    except InputError as error:
        raise InputError(f"{where} {error}") from None
    except Exception as error:
        # Both readers raise whatever a damaged file makes them run into.
        raise InputError(f"{where} is not a MAT file that can be read: {str(error)[:200]}") from None


def _variables(content: bytes, limit: float) -> dict[str, Any]:
    order = "<" if content[126:128] == b"IM" else ">"
    budget = _Budget(limit, limit, limit)
    found: dict[str, Any] = {}
    for element in _elements(memoryview(content)[MAT_HEADER:], order):
        kind, payload = element
        if kind == COMPRESSED:
            ((kind, payload),) = _elements(memoryview(_inflated(payload, budget)), order)
        if kind == MATRIX and payload:
            name, value = _matrix(payload, order, budget, 1)
            if name and value is not None:
                found[name] = value
    return found


def _elements(data: memoryview, order: str) -> Iterator[Element]:
    """Kind and content of each element."""
    place = 0
    while place < len(data):
        if len(data) - place < 8:
            raise _DamagedError("a tag is cut off")
        kind, size = struct.unpack_from(f"{order}II", data, place)
        # Up to four bytes stand in the tag itself, their number in the upper half of the kind.
        small = kind >> 16
        if small:
            kind, size = kind & 0xFFFF, small
        start = place + (4 if small else 8)
        if size > (4 if small else len(data) - start):
            raise _DamagedError("an element is larger than what is there of it")
        yield kind, data[start : start + size]
        place += 8 if small else 8 + size + (0 if kind == COMPRESSED else -size % 8)


def _inflated(payload: memoryview, budget: _Budget) -> bytes:
    stream = zlib.decompressobj()
    result = stream.decompress(payload, int(budget.inflated) + 1)
    budget.inflated -= len(result)
    if budget.inflated < 0:
        raise InputError(f"inflates to more than {budget.limit / MEGABYTE:g} MB; {TOO_LARGE}")
    if not stream.eof:
        raise _DamagedError("a compressed element has no end")
    return result


def _matrix(payload: memoryview, order: str, budget: _Budget, depth: int) -> tuple[str, Any]:
    """Name and content of a matrix: an array, a dict for a structure, None for what holds no columns."""
    budget.arrays -= 1
    if depth > MOST_DEPTH:
        raise InputError(f"has structures more than {MOST_DEPTH} deep; save the numbers themselves")
    if budget.arrays < 0:
        raise InputError(f"has more than {MOST_ARRAYS} matrices and fields; save the numbers themselves")
    (_, flags), *parts = list(_elements(payload, order))
    (flag,) = struct.unpack_from(f"{order}I", flags)
    if flag & 0xFF not in (CELL, STRUCTURE, *NUMERIC):
        return "", None
    (_, dimensions), (_, name), *rest = parts
    shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions)
    if len(shape) < 2 or min(shape) < 0:
        raise _DamagedError("a matrix has no dimensions")
    known_as = bytes(name).decode("utf-8")
    if flag & 0xFF == CELL:
        _cells(rest, order, budget, depth)
        return known_as, None
    if flag & 0xFF == STRUCTURE:
        return known_as, _structure(shape, rest, order, budget, depth)
    return known_as, _numbers(shape, rest, bool(flag & COMPLEX_FLAG), order, budget)


def _cells(parts: list[Element], order: str, budget: _Budget, depth: int) -> None:
    """Follow what stands in cells, which are not read, as far as its depth and number count."""
    for kind, content in parts:
        if kind != MATRIX:
            raise _DamagedError("a cell is no matrix")
        if content:
            _matrix(content, order, budget, depth + 1)


def _structure(
    shape: tuple[int, ...], parts: list[Element], order: str, budget: _Budget, depth: int
) -> dict[str, Any] | None:
    """Read the fields of a single structure; None for an array of them."""
    if len(parts) < 2:
        raise _DamagedError("a matrix is smaller than its dimensions say")
    (_, length), (_, names), *fields = parts
    (width,) = struct.unpack(f"{order}i", length)
    if width <= 0 or len(names) % width or prod(shape) * (len(names) // width) != len(fields):
        raise _DamagedError("a structure has not as many fields as its names and dimensions say")
    if any(kind != MATRIX for kind, _ in fields):
        raise _DamagedError("a field of a structure is no matrix")
    budget.arrays -= len(names) // width
    values = [_matrix(content, order, budget, depth + 1)[1] if content else None for _, content in fields]
    if prod(shape) != 1:
        return None
    keys = [bytes(names[at : at + width]).split(b"\0", 1)[0].decode("utf-8") for at in range(0, len(names), width)]
    return {key: value for key, value in zip(keys, values, strict=True) if value is not None}


def _numbers(
    shape: tuple[int, ...], parts: list[Element], has_imaginary: bool, order: str, budget: _Budget
) -> np.ndarray[Any, Any]:
    """Read a numeric array, columns first in the file."""
    count = prod(shape)
    budget.numbers -= 8 * count * len(parts)
    if budget.numbers < 0:
        raise InputError(f"holds more than {budget.limit / MEGABYTE:g} MB of numbers; {TOO_LARGE}")
    if len(parts) != 1 + has_imaginary:
        raise _DamagedError("a matrix has not the parts, real and imaginary, that it says")
    read = []
    for kind, content in parts:
        if kind not in TYPES or len(content) != count * np.dtype(TYPES[kind]).itemsize:
            raise _DamagedError("a matrix has not as many numbers as its dimensions say")
        read.append(np.frombuffer(content, dtype=order + TYPES[kind]).reshape(shape, order="F").squeeze())
    if not has_imaginary:
        return read[0]
    result = np.empty(read[0].shape, dtype=complex)
    result.real, result.imag = read
    return result
