"""Tables that are handed in from Python, and the sampling rate that their time stamps show."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import IN_SI, counted
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
        The object is not a table.
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


TIME_UNITS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
"""Units of time stamps, s."""
SAME_RATE = 0.01
"""Relative; how near the rate of the stamps must come to the declared one: clocks err by far less, typing by more."""
UNEVEN_STEP = 0.25
"""Largest deviation of a step, as a fraction of the median one; more is a gap, a repetition or another rate."""

FINEST = -9
"""Power of ten, s, of the finest rounding that is looked for; the coarsest is a second."""
WHOLE = 1e-4
"""Largest distance of a stamp from a whole multiple of the rounding step, as a fraction of the step."""
SHORTEST = 0.75
"""Shortest interval between samples that still shows when one is missing, as a fraction of the rounding step."""
LONGEST_IN_BAND = 1.5
"""Interval between samples, as a multiple of the rounding step, from which a missing one shows in exact stamps too."""
LEAST_SHARE = 0.02
"""Unusual steps are gaps, and not rounding, if they are a smaller fraction of the steps."""


class Stamped(Protocol):
    """Name of a table with time stamps and of a place in it, for messages."""

    @property
    def source(self) -> str:
        """Name of the table."""

    def at(self, row: int) -> str:
        """Name the place of a row."""


def sampling_rate_of(time: Floats, table: Stamped, name: str, declared: float | None = None) -> float:
    """Find the sampling rate that time stamps show, Hz; the declared one where the two agree.

    Stamps that a logger has rounded, 0.004, 0.008, 0.012, ... s at 256 Hz, show the rate that all of them fit.

    Parameters
    ----------
    time : array, shape (samples,)
        s.
    table : Stamped
        Where the stamps stand.
    name : str
        What they are called there.
    declared : float, optional
        Hz; with it the stamps may be coarser than the samples.

    Raises
    ------
    InputError
        Where the stamps do not ascend, have a gap, change their step or show another rate than was declared, naming
        the line.
    """
    rate = _rate_of_steps(time, table, name, declared)
    if declared is None:
        return rate
    if abs(rate - declared) > SAME_RATE * declared:
        raise InputError(f"sampling_rate = {declared:g} Hz, but {name} of {table.source} ticks at {rate:.6g} Hz")
    return declared


def _rate_of_steps(time: Floats, table: Stamped, name: str, declared: float | None) -> float:
    missing = np.flatnonzero(~np.isfinite(time))
    if missing.size:
        raise InputError(f"{table.at(int(missing[0]))}: {name} is missing; samples must be evenly spaced")
    steps = np.diff(time)
    step = float(np.median(steps))
    odd = np.flatnonzero(np.abs(steps - step) > UNEVEN_STEP * abs(step))
    if step > 0 and not odd.size:
        return float((len(time) - 1) / (time[-1] - time[0]))
    rate = rate_within_rounding(time, declared)
    if rate is None:
        _refuse_uneven(time, steps, step, odd, table, name, declared)
    return rate


def _refuse_uneven(
    time: Floats, steps: Floats, step: float, odd: Ints, table: Stamped, name: str, declared: float | None
) -> NoReturn:
    repeated = int(np.count_nonzero(steps == 0))
    if declared is None and repeated > 1 and np.all(steps >= 0) and time[-1] > time[0]:
        raise InputError(
            f"{table.source}: {name} is rounded to {rounding_of(time):g} s, more than a sample, so that stamps repeat; "
            "give sampling_rate, in Hz"
        )
    if step <= 0:
        raise InputError(f"{table.source}: {name} must ascend; its median step is {step:g} s")
    first = int(odd[0])
    if steps[first] <= 0:
        raise InputError(
            f"{table.at(first + 1)}: {name} goes back, or stands still, by {steps[first]:g} s after the sample before"
        )
    # A handful of odd steps are gaps; a fifth of all, each like the next, are a second rate.
    others = float(np.median(steps[odd]))
    alike = np.mean(np.abs(steps[odd] - others) < UNEVEN_STEP * others)
    if odd.size > 0.1 * len(steps) and alike > 0.9:
        before = float(steps[0])
        change = int(np.argmax(np.abs(steps - before) > UNEVEN_STEP * before))
        raise InputError(
            f"{table.at(change + 1)}: {name} has two sampling rates, {1 / before:.6g} Hz and from here "
            f"{1 / float(steps[change]):.6g} Hz; hand in the stretches as separate records or resample them to one rate"
        )
    raise InputError(
        f"{table.at(first + 1)}: {name} has a gap of {steps[first]:g} s where the step is {step:g} s "
        f"({counted(int(odd.size), 'uneven step')} in all); hand in what lies before and after as two runs"
    )


def rounding_of(time: Floats) -> float:
    """Find the coarsest power of ten, s, that all stamps are whole multiples of; 0 where they are of none.

    Parameters
    ----------
    time : array, shape (samples,)
        s.
    """
    for power in range(0, FINEST - 1, -1):
        in_steps = time * 10.0**-power
        if np.abs(in_steps - np.round(in_steps)).max() < WHOLE:
            return 10.0**power
    return 0.0


def rate_within_rounding(time: Floats, declared: float | None = None) -> float | None:
    """Find the one sampling rate that the stamps fit within their rounding, Hz; None where they fit none.

    Parameters
    ----------
    time : array, shape (samples,)
        s.
    declared : float, optional
        Hz; the rate where it is known. Without it the stamps must be fine enough to show a missing sample.

    Returns
    -------
    float or None
        By least squares.
    """
    rounding = rounding_of(time)
    if rounding == 0.0:
        return None
    places = np.arange(len(time)) - (len(time) - 1) / 2
    interval = float(places @ (time - time.mean()) / (places @ places))
    residual = time - time.mean() - interval * places
    if interval <= 0 or np.ptp(residual) > (1 + UNEVEN_STEP) * rounding:
        return None
    if declared is None and interval < SHORTEST * rounding:
        return None
    _, counts = np.unique(np.round(np.diff(time) / rounding), return_counts=True)
    if interval < LONGEST_IN_BAND * rounding and 1.0 - counts.max() / (len(time) - 1) < LEAST_SHARE:
        return None
    return 1.0 / interval
