"""MAT files of version 5 and older.

A file of version 5 is a header and a row of elements, each a tag (kind and size) and what it announces; a matrix
holds elements in turn. scipy believes the tags. Here they are followed first, and compressed elements are inflated to
a stated size and against their checksum; what scipy is then given holds no more than was counted.
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

from scipy import io

from cvxshear.errors import InputError
from cvxshear.formats.columns import TOO_LARGE
from cvxshear.formats.reading import MEGABYTE

HEADER = 128
MOST_DEPTH = 32
MOST_ARRAYS = 100_000
"""Matrices, and fields of structures, in one file."""

MATRIX, COMPRESSED = 14, 15
WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
"""Bytes of a number of each kind of element."""

STRUCTURE, CHARACTERS, SPARSE, OPAQUE = 2, 4, 5, 17
NUMERIC = range(6, 16)
"""Classes of matrices."""


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
    """The variables of a file by name, as scipy reads them.

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
            if io.matlab.matfile_version(_opened(content))[0] == 1:
                content = _checked(content, limit)
            return io.loadmat(_opened(content), simplify_cells=True)
    except InputError as error:
        raise InputError(f"{where} {error}") from None
    except Exception as error:
        # scipy raises whatever its parsing runs into.
        raise InputError(f"{where} is not a MAT file that can be read: {str(error)[:200]}") from None


def _opened(content: bytes) -> Any:
    return BytesIO(content)


def _checked(content: bytes, limit: float) -> bytes:
    """The same file, inflated, without what holds no numbers."""
    order = "<" if content[126:128] == b"IM" else ">"
    budget = _Budget(limit, limit, limit)
    kept = bytearray(content[:HEADER])
    for element in _elements(memoryview(content)[HEADER:], order):
        kind, payload = element
        if kind == COMPRESSED:
            ((kind, payload),) = _elements(memoryview(_inflated(payload, budget)), order)
        if kind == MATRIX and payload and _check_matrix(payload, order, budget, 1) in (STRUCTURE, *NUMERIC):
            kept += struct.pack(f"{order}II", MATRIX, len(payload))
            kept += payload
            kept += bytes(-len(payload) % 8)
    return bytes(kept)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
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


def _check_matrix(payload: memoryview, order: str, budget: _Budget, depth: int) -> int:
    """The class of a matrix, once its parts, and those of the matrices inside it, are known to fit its size."""
    budget.arrays -= 1
    if depth > MOST_DEPTH:
        raise InputError(f"has structures more than {MOST_DEPTH} deep; save the numbers themselves")
    if budget.arrays < 0:
        raise InputError(f"has more than {MOST_ARRAYS} matrices and fields; save the numbers themselves")
    (_, flags), *parts = list(_elements(payload, order))
    of_class = struct.unpack_from(f"{order}I", flags)[0] & 0xFF
    inside = [content for kind, content in parts if kind == MATRIX]
    for each in inside:
        if each:
            _check_matrix(each, order, budget, depth + 1)
    if of_class in (SPARSE, OPAQUE):
        return int(of_class)
    sizes = struct.unpack(f"{order}{len(parts[0][1]) // 4}i", parts[0][1])
    count = prod(sizes)
    if of_class in NUMERIC:
        _check_numbers(count, parts[2:], budget)
    elif min(sizes) < 0 or count > max(1, len(inside), len(payload) * (of_class == CHARACTERS)):
        raise _DamagedError("a matrix is smaller than its dimensions say")
    return int(of_class)


def _check_numbers(count: int, parts: list[tuple[int, memoryview]], budget: _Budget) -> None:
    budget.numbers -= 8 * count * len(parts)
    if budget.numbers < 0:
        raise InputError(f"holds more than {budget.limit / MEGABYTE:g} MB of numbers; {TOO_LARGE}")
    if not parts or any(kind not in WIDTHS or len(content) != count * WIDTHS[kind] for kind, content in parts):
        raise _DamagedError("a matrix has not as many numbers as its dimensions say")
