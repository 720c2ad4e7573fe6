"""Reads a MAT file of version 5 or older with scipy, as a process of its own: a damaged file may end it.

scipy's reader believes what the file says of itself: a matrix that says it is complex and has no imaginary part ends
the process. This module is that process, and nothing but NumPy and scipy is imported here. It takes the file from its
standard input and the limit of its numbers in bytes from the command line, and writes one line of JSON, then each
array as a .npy file. The line is {"names": [...]}, {"large": true}, or {"error": message}.
"""

import json
import sys
import warnings
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import Any

import numpy as np
from scipy.io import loadmat

ROOM = 2**30
"""Bytes of memory beyond four times the limit: what Python, NumPy and scipy themselves take."""


def numeric(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield the numeric arrays by name, a field `x` of a structure `run` as `run.x`."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from numeric(value, f"{prefix}{name}.")
        elif not name.startswith("__") and isinstance(value, np.ndarray | int | float | complex):
            array = np.asarray(value)
            if array.dtype.kind in "fiuc":
                yield f"{prefix}{name}", array


def main(limit: float) -> None:
    """Read standard input, write standard output."""
    try:
        import resource  # noqa: PLC0415  # there is none on Windows

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        room = int(ROOM + 4 * limit)
        resource.setrlimit(resource.RLIMIT_AS, (room if most < 0 else min(room, most), most))
    except ImportError:
        pass
    found: dict[str, np.ndarray[Any, Any]] = {}
    try:
        warnings.simplefilter("error")
        content: Any = BytesIO(sys.stdin.buffer.read())
        found = dict(numeric(loadmat(content, simplify_cells=True)))
        large = 8 * sum(array.size * (1 + (array.dtype.kind == "c")) for array in found.values()) > limit
        said: dict[str, Any] = {"large": True} if large else {"names": list(found)}
    except MemoryError:
        said = {"large": True}
    except Exception as error:
        # scipy raises whatever a damaged file makes it run into.
        said = {"error": str(error)}
    sys.stdout.buffer.write(json.dumps(said).encode() + b"\n")
    for name in said.get("names", ()):
        np.lib.format.write_array(sys.stdout.buffer, found[name], allow_pickle=False)


if __name__ == "__main__":
    main(float(sys.argv[1]))
