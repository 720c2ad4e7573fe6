"""Tables that are handed in from Python, and the sampling rate that their time stamps show."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from cvxshear.util import checks, quantities
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

#: Names of a column of times, s, that need no declaration.
TIME_NAMES = ("time", "time_s", "t", "t_s", "Time", "TIME", "seconds")

#: A run with fewer has too few periods for any of the methods.
FEWEST_SAMPLES = 128

#: Share of the samples that sound pieces must hold: a record that has lost more is for a person to look at.
LEAST_USED = 0.5


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


class _InMemory:
    """Names of an array or a data frame, for messages."""

    source = "the table"

    def at(self, row: int) -> str:
        """Name the place of a row."""
        return f"the table, sample {row + 1}"


def columns_of(table: Any, sampling_rate: float | None) -> tuple[dict[str, Floats], float]:
    """Read the columns of an array or a pandas DataFrame by their names, and their sampling rate, Hz.

    The time is the index of a data frame, numbers (s) or dates, or a column with one of `TIME_NAMES`. An index of whole
    numbers is taken for a count of rows.

    Raises
    ------
    InputError
        The object is not a table, a name occurs twice, the rate is unknown, the times are not evenly spaced, or times
        and rate contradict each other.
    """
    framed = hasattr(table, "columns") and hasattr(table, "index")
    values = matrix_of(table.to_numpy() if framed else table, "the table", np.float64)
    names = [str(name) for name in table.columns] if framed else [f"channel {k + 1}" for k in range(values.shape[1])]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'the table has the column "{name}" {names.count(name)} times; name each once')
    columns = dict(zip(names, values.T, strict=True))
    times = _seconds(table.index) if framed else None
    if times is None:
        times = next((columns.pop(name) for name in names if framed and name in TIME_NAMES), None)
    if times is not None and len(times) > 1:
        return columns, sampling_rate_of(times, _InMemory(), "the time", sampling_rate)
    if sampling_rate is None:
        raise InputError("give sampling_rate, in Hz: the table has no time that tells it")
    return columns, sampling_rate


def _seconds(index: Any) -> Floats | None:
    """Return the times of an index in seconds; None if it counts rows."""
    if getattr(index, "tz", None) is not None:
        index = index.tz_convert("UTC").tz_localize(None)
    times = np.asarray(index)
    if times.dtype.kind in "mM":
        return np.asarray((times - times[0]) / np.timedelta64(1, "s"))
    return times.astype(np.float64) if times.dtype.kind == "f" else None


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


#: Units of time stamps, s.
TIME_UNITS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
#: Relative; how near the rate of the stamps must come to the declared one: clocks err by far less, typing by more.
SAME_RATE = 0.01
#: Largest deviation of a step, as a fraction of the median one; more is a gap, a repetition or another rate.
UNEVEN_STEP = 0.25

#: Interval between samples, as a multiple of the rounding step, from which a missing one shows in exact stamps too.
LONGEST_IN_BAND = 1.5
#: Unusual steps are gaps, and not rounding, if they are a smaller fraction of the steps.
LEAST_SHARE = 0.02


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
        Hz.

    Raises
    ------
    InputError
        Where the stamps do not ascend, have a gap, change their step or show another rate than was declared, naming
        the line.
    """
    rate = _rate_of_steps(time, table, name)
    if declared is None:
        return rate
    if abs(rate - declared) > SAME_RATE * declared:
        raise InputError(f"sampling_rate = {declared:g} Hz, but {name} of {table.source} ticks at {rate:.6g} Hz")
    return declared


def _rate_of_steps(time: Floats, table: Stamped, name: str) -> float:
    missing = np.flatnonzero(~np.isfinite(time))
    if missing.size:
        raise InputError(f"{table.at(int(missing[0]))}: {name} is missing; samples must be evenly spaced")
    steps = np.diff(time)
    step = float(np.median(steps))
    odd = np.flatnonzero(np.abs(steps - step) > UNEVEN_STEP * abs(step))
    if step > 0 and not odd.size:
        return float((len(time) - 1) / (time[-1] - time[0]))
    rate = _rate_within_rounding(time, steps)
    if rate is None:
        _refuse_uneven(steps, step, odd, table, name)
    return rate


def _rate_within_rounding(time: Floats, steps: Floats) -> float | None:
    """Find the one sampling rate, by least squares, that rounded stamps fit within their rounding; None without it."""
    if np.any(steps < 0) or not np.any(steps):
        return None
    # Steps between rounded stamps are whole multiples of the rounding.
    usual = np.median(steps[steps > 0])
    rounding = float(usual * np.diff(np.unique(np.round(np.append(steps, 0.0) / usual, 4))).min())
    places = np.arange(len(time)) - (len(time) - 1) / 2
    interval = float(places @ (time - time.mean()) / (places @ places))
    if np.ptp(time - interval * places) > (1 + UNEVEN_STEP) * rounding:
        return None
    multiples, counts = np.unique(np.round(steps / rounding), return_counts=True)
    rare = 1.0 - counts.max() / len(steps) < LEAST_SHARE
    # Stamps that mostly repeat are too coarse to show a gap.
    if rare and interval < LONGEST_IN_BAND * rounding and multiples[np.argmax(counts)] > 0:
        return None
    return 1.0 / interval


def _refuse_uneven(steps: Floats, step: float, odd: Ints, table: Stamped, name: str) -> NoReturn:
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
        f"({quantities.counted(int(odd.size), 'uneven step')} in all); hand in what lies before and after as two runs"
    )
