"""Tables that are handed in from Python: arrays, data frames of pandas, data arrays of xarray."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cvxshear.records.stamps import TIME_UNITS, sampling_rate_of
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import IN_SI
from cvxshear.util.typing import Bools, Floats, Ints

TIME_NAMES = ("time", "time_s", "t", "t_s", "Time", "TIME", "seconds")
"""Names of a column of times, s, that need no declaration."""

FEWEST_SAMPLES = 128
"""A run with fewer has too few periods for any of the methods."""

LEAST_USED = 0.5
"""Share of the samples that sound pieces must hold: a record that has lost more is for a person to look at."""


def stretches(there: Bools) -> Ints:
    """Find where samples are there without a break: first sample and the one after the last, shape (stretches, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8))).reshape(-1, 2)


def sound_pieces(sound: Bools, breaks: Iterable[int] = (), asked: slice = slice(None)) -> list[slice]:
    """Cut rows into pieces between those that are missing; short pieces beside long ones are left out.

    Parameters
    ----------
    sound : ndarray of bool, shape (samples,)
    breaks : iterable of int, optional
        Rows that do not follow the one before, ascending.
    asked : slice, optional
        The rows that count; all where not given.

    Returns
    -------
    list of slice
        One slice of all valid rows if no row or too many rows are missing.
    """
    first, last, _ = asked.indices(len(sound))
    pieces: list[tuple[int, int]] = []
    for start, stop in (first + stretches(sound[asked])).tolist():
        pieces += pairwise([start, *(row for row in breaks if start < row < stop), stop])
    longest = max((stop - start for start, stop in pieces), default=0)
    kept = [slice(start, stop) for start, stop in pieces if stop - start >= max(FEWEST_SAMPLES, longest / 4)]
    used = sum(each.stop - each.start for each in kept)
    return kept if used >= LEAST_USED * (last - first) else [slice(first, last)]


@dataclass(frozen=True, eq=False)
class TableColumns:
    """Columns of a table.

    Parameters
    ----------
    values : ndarray, shape (samples, columns)
    names : list of str
        By `label`.
    times : ndarray, shape (samples,), or None
        s, of a table that has times.
    unit : str or None
        In which the table says that its values are.
    """

    values: Floats
    names: list[str]
    times: Floats | None
    unit: str | None = None

    def samples(self, name: Hashable) -> Floats:
        """Return the samples of one column, shape (samples,)."""
        if label(name) not in self.names:
            raise InputError(f'there is no channel "{label(name)}" in the table; there are {", ".join(self.names)}')
        return np.asarray(self.values[:, self.names.index(label(name))])

    @property
    def source(self) -> str:
        """Name of the table in messages."""
        return "the table"

    def at(self, row: int) -> str:
        """Name the place of a row."""
        return f"the table, sample {row + 1}"

    def sampling_rate(self, given: float | None = None) -> float:
        """Hz, from the times, or as given.

        Raises
        ------
        InputError
            The rate is unknown, the times are not evenly spaced, or times and rate contradict each other.
        """
        if self.times is None or len(self.times) < 2:
            if given is None:
                raise InputError("give sampling_rate, in Hz: the table has no time that tells it")
            return given
        return sampling_rate_of(self.times, self, "the time", given)


def label(name: Hashable) -> str:
    """Write the name of a column, with blanks between several levels."""
    return " ".join(map(str, name)) if isinstance(name, tuple) else str(name)


def table_columns(table: Any) -> TableColumns:
    """Read the columns of a table; their names, times and unit as a data frame or a data array has them.

    The first dimension of a data array is time; the second has one named coordinate for each channel. Times of any
    numeric or date type but whole numbers count, which are taken for a count of rows. The unit is `attrs["units"]`.

    Raises
    ------
    InputError
        The object is not a table, a name occurs twice, or a unit is not a unit of acceleration, velocity or
        displacement.
    """
    names: Any = None
    times: Any = None
    if hasattr(table, "columns") and hasattr(table, "index"):
        names, times = list(table.columns), table.index
        if getattr(times, "tz", None) is not None:
            times = times.tz_convert("UTC").tz_localize(None)
    elif hasattr(table, "dims") and hasattr(table, "coords"):
        if len(table.dims) != 2:
            raise InputError(f"the data array has the dimensions {tuple(table.dims)}; it needs two, time and channels")
        time, channel = table.dims
        names = list(table.coords[channel].values.tolist()) if channel in table.coords else None
        times = table.coords.get(time, None)
    values = matrix_of(getattr(table, "values", table), "the table", np.float64)
    seconds = _seconds(times)
    column = next((place for place, name in enumerate(names or ()) if name in TIME_NAMES), None)
    if column is not None and seconds is None:
        seconds, values = values[:, column], np.delete(values, column, axis=1)
        names = [name for place, name in enumerate(names) if place != column]
    if names is None:
        names = [f"channel {place}" for place in range(1, values.shape[1] + 1)]
    names = [label(name) for name in names]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f'the table has the column "{twice[0]}" {names.count(twice[0])} times; name each once')
    return TableColumns(values, names, seconds, _unit_of(table))


def _seconds(times: Any) -> Floats | None:
    """Return times in seconds; None without times, or if the index counts rows."""
    values = np.asarray(getattr(times, "values", times))
    if times is None or values.ndim != 1 or values.dtype.kind not in "fmM":
        return None
    if values.dtype.kind in "mM":
        return np.asarray((values - values[0]) / np.timedelta64(1, "s"))
    unit = str(getattr(times, "attrs", {}).get("units", "s"))
    if unit not in TIME_UNITS:
        raise InputError(f'the unit of the time is "{unit}"; it must be one of {", ".join(TIME_UNITS)}')
    return values.astype(np.float64) * TIME_UNITS[unit]


def _unit_of(table: Any) -> str | None:
    """Read the unit in which a table says that its values are, as it is called here; None where it says none."""
    said = getattr(table, "attrs", {}).get("units")
    if said is None:
        return None
    plain = "".join(str(said).split()).replace("^", "").replace("**", "").replace("s-2", "/s2").replace("s-1", "/s")
    known = {unit.lower(): unit for units in IN_SI.values() for unit in units}
    if plain.replace("//", "/").lower() not in known:
        raise InputError(f'units = "{said}" of the table is none of {", ".join(known.values())}')
    return known[plain.replace("//", "/").lower()]


def matrix_of(value: Any, where: str, dtype: type) -> Any:
    """Check a table of numbers, samples by channels, and return it read-only; a masked value is nan.

    Raises
    ------
    InputError
        Where it is none.
    """
    try:
        given = np.ma.filled(value.astype(dtype), np.nan) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        if np.iscomplexobj(given) and not issubclass(dtype, np.complexfloating):
            raise TypeError
        result: NDArray[Any] = np.array(given, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{where} must be a table of numbers, samples by channels") from None
    if result.ndim != 2 or 0 in result.shape:
        raise InputError(f"{where} must be a table of samples by channels, not of shape {result.shape}")
    return checks.frozen(result)
