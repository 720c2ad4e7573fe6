"""Tables that are handed in from Python: arrays, data frames of pandas, data arrays of xarray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

UNEVEN = 0.01
"""Largest change of a step, over the usual step: time stamps are rounded, and a gap is at least one step."""


@dataclass(frozen=True, eq=False)
class TableColumns:
    """Columns of a table.

    Parameters
    ----------
    values : ndarray, shape (samples, columns)
    names : list of str
    times : ndarray, shape (samples,), or None
        s, of a table that has times.
    """

    values: Floats
    names: list[str]
    times: Floats | None

    def samples(self, name: str) -> Floats:
        """Return the samples of one column, shape (samples,)."""
        if name not in self.names:
            raise InputError(f'there is no channel "{name}" in the table; there are {", ".join(self.names)}')
        return np.asarray(self.values[:, self.names.index(name)])

    def sampling_rate(self) -> float:
        """Hz, from the times.

        Raises
        ------
        InputError
            Where there are none, or they are not evenly spaced.
        """
        if self.times is None or len(self.times) < 2:
            raise InputError("give sampling_rate, in Hz: the table has no time that tells it")
        steps = np.diff(self.times)
        rate = 1.0 / float(np.median(steps))
        uneven = np.flatnonzero(np.abs(steps * rate - 1.0) > UNEVEN)
        if uneven.size:
            raise InputError(
                f"the table's time steps from {self.times[uneven[0]]:g} s to {self.times[uneven[0] + 1]:g} s, where "
                f"its step is {1 / rate:g} s; samples must be evenly spaced"
            )
        return rate


def table_columns(table: Any) -> TableColumns:
    """Read the columns of a table; their names and times as a data frame or a data array has them.

    Of a data array the first dimension is time, the second one named coordinate a channel. Times of any numeric or
    date type but whole numbers count, which are taken for a count of rows.
    """
    names: Any = None
    times: Any = None
    if hasattr(table, "columns") and hasattr(table, "index"):
        names, times = list(table.columns), np.asarray(table.index)
    elif hasattr(table, "dims") and hasattr(table, "coords"):
        if len(table.dims) != 2:
            raise InputError(f"the data array has the dimensions {tuple(table.dims)}; it needs two, time and channels")
        time, channel = table.dims
        names = list(table.coords[channel].values) if channel in table.coords else None
        times = np.asarray(table.coords[time].values) if time in table.coords else None
    values = matrix_of(getattr(table, "values", table), "the table", np.float64)
    if times is not None and times.dtype.kind in "mM":
        times = (times - times[0]) / np.timedelta64(1, "s")
    if times is not None and (times.dtype.kind != "f" or len(times) != len(values)):
        times = None
    if names is None:
        names = [f"channel {place}" for place in range(1, values.shape[1] + 1)]
    return TableColumns(values, [str(name) for name in names], times)


def matrix_of(value: Any, where: str, dtype: type) -> Any:
    """Check a table of numbers, samples by channels, and return it read-only.

    Raises
    ------
    InputError
        Where it is none.
    """
    try:
        result: NDArray[Any] = np.array(value, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{where} must be a table of numbers, samples by channels") from None
    if result.ndim != 2 or 0 in result.shape:
        raise InputError(f"{where} must be a table of samples by channels, not of shape {result.shape}")
    return checks.frozen(result)
