"""Names for the array types that signatures use."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Complexes = NDArray[np.complex128]
#: A result as plain Python values, ready for `json.dumps`.
Json = dict[str, Any]

#: Any type; the same type in all places of one signature.
T = TypeVar("T")
