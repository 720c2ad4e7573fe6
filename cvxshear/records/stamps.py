"""The sampling rate behind time stamps that a logger has rounded.

Stamps t_k that were rounded, up, down or to the nearest, to a whole multiple of q stand within a band of height q
around a straight line t_0 + k / f. A sample that is missing moves all that follow by 1 / f and out of the band,
but for two cases: 1 / f is small beside q, or 1 / f is a whole multiple of q, so that the stamps are exact and
leave the band empty. The second shows by its steps, which are all alike but for those at the gaps.
"""

from typing import NoReturn, Protocol

import numpy as np

from cvxshear.util.errors import InputError
from cvxshear.util.quantities import counted
from cvxshear.util.typing import Floats, Ints

TIME_UNITS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
"""Units of time stamps, s."""
SAME_RATE = 0.01
"""Relative; how near the rate of the stamps must come to the declared one: clocks err by far less, typing by more."""
UNEVEN_STEP = 0.25
"""Largest deviation of a step, as a fraction of the median one; more is a gap, a repetition or another rate."""

COARSE = 0.1
"""Largest fraction of unusual steps that gaps explain."""

FINEST, COARSEST = -9, 0
"""Powers of ten, s, that loggers round to."""
WHOLE = 1e-4
"""Largest distance of a stamp from a whole multiple of the rounding step, as a fraction of the step."""
SLACK = 0.1
"""Width added to the band of stamps on either side for the line's own error, as a fraction of the rounding step."""
SHORTEST = 0.75
"""Shortest interval between samples that still shows when one is missing, as a fraction of the rounding step."""
LONGEST_IN_BAND = 1.5
"""Interval between samples, as a multiple of the rounding step, from which a missing one shows in exact stamps too."""
LEAST_SHARE = 0.02
"""Unusual steps are gaps, and not rounding, if they are a smaller fraction of the steps."""
DIGITS = 1e-12
"""Rounding of the binary number itself, as a fraction of the largest stamp."""


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
    rounded = rate_within_rounding(time, declared)
    if rounded is None:
        if step <= 0 or odd.size > COARSE * len(steps):
            _refuse_coarse(time, step, table, name)
        _refuse_uneven(steps, step, odd, table, name)
    return rounded


def _refuse_coarse(time: Floats, step: float, table: Stamped, name: str) -> None:
    """Refuse stamps that repeat because they are rounded to more than a sample, where they do."""
    rounding = rounding_of(time)
    repeats = bool(np.any(np.isclose(step, (0.0, rounding), atol=1e-9))) and bool(np.all(np.diff(time) >= 0))
    if repeats and time[-1] > time[0]:
        raise InputError(
            f"{table.source}: {name} is rounded to {rounding:g} s, more than a sample, so that stamps repeat; give "
            "sampling_rate, in Hz"
        )
    if step <= 0:
        raise InputError(f"{table.source}: {name} must ascend; its median step is {step:g} s")


def _refuse_uneven(steps: Floats, step: float, odd: Ints, table: Stamped, name: str) -> NoReturn:
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
    for power in range(COARSEST, FINEST - 1, -1):
        in_steps = time * 10.0**-power
        error = np.abs(in_steps - np.round(in_steps)).max()
        if error < WHOLE + DIGITS * np.abs(in_steps).max():
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
    if interval <= 0 or np.ptp(residual) > (1 + 2 * SLACK) * rounding:
        return None
    if declared is None and interval < SHORTEST * rounding:
        return None
    _, counts = np.unique(np.round(np.diff(time) / rounding), return_counts=True)
    if interval < LONGEST_IN_BAND * rounding and 1.0 - counts.max() / (len(time) - 1) < LEAST_SHARE:
        return None
    return 1.0 / interval
