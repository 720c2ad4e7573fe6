"""Tables of named columns, whatever file they came from, and the checks that name a column and a line.

Also the sampling rate behind a column of time stamps that a logger has rounded.

Stamps t_k that were rounded, up, down or to the nearest, to a whole multiple of q stand within a band of height q
around a straight line t_0 + k / f. A sample that is missing moves all that follow by 1 / f and out of the band,
but for two cases: 1 / f is small beside q, or 1 / f is a whole multiple of q, so that the stamps are exact and
leave the band empty. The second shows by its steps, which are all alike but for those at the gaps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import counted
from cvxshear.util.typing import Floats, Ints

FEWEST_ROWS = 32
LIMIT = 100_000_000
"""Bytes that a file of a record, and the numbers in it, may have where nothing else is said."""
TOO_LARGE = "cut it into runs, or raise the limit by size_limit, in MB, in the table [record]"
UNEVEN_STEP = 0.25
"""Largest deviation of a step, as a fraction of the median one; more is a gap, a repetition or another rate."""

COARSE = 0.1
"""Fraction of all steps that differ from the usual one, above which they are no handful of gaps."""

FINEST, COARSEST = -9, 0
"""Powers of ten, s: what loggers round to."""
WHOLE = 1e-4
"""Largest distance of a stamp from a whole multiple of the rounding step, as a fraction of the step."""
SLACK = 0.1
"""Width added to the band of stamps on either side for the line's own error, as a fraction of the rounding step."""
SHORTEST = 0.75
"""Shortest interval between samples that still shows when one is missing, as a fraction of the rounding step."""
LONGEST_IN_BAND = 1.5
"""Interval between samples, as a multiple of the rounding step, from which a missing one shows in exact stamps too."""
LEAST_SHARE = 0.02
"""Fraction of the steps that differ from the usual one below which they are gaps and not the work of rounding."""
DIGITS = 1e-12
"""Rounding of the binary number itself, as a fraction of the largest stamp."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of equal length.

    Parameters
    ----------
    source : str
        The file, for messages.
    names : tuple of str
    values : array, shape (rows, columns)
    lines : array of int, shape (rows,), optional
        The line of the file that each row stands on; None for a binary file.
    units : tuple of str, optional
        What a line of units says of each column; empty where there is none.
    stated_rate : tuple of (str, float), optional
        A lone number of the file that gives the sampling rate: its name, and the rate in Hz.
    """

    source: str
    names: tuple[str, ...]
    values: Floats
    lines: Ints | None = None
    units: tuple[str, ...] = ()
    stated_rate: tuple[str, float] | None = None

    def __post_init__(self) -> None:
        if len(self.values) < FEWEST_ROWS:
            raise InputError(f"{self.source} holds {len(self.values)} samples; at least {FEWEST_ROWS} are needed")
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise InputError(f'{self.source} has two columns named "{name}"')
            seen.add(name)

    def at(self, row: int) -> str:
        """Name the place of a row as a person would."""
        if self.lines is None:
            return f"{self.source}, sample {row + 1}"
        return f"{self.source}, line {int(self.lines[row])}"

    def rows(self, which: slice) -> Columns:
        """Keep some of the rows."""
        lines = None if self.lines is None else self.lines[which]
        return replace(self, values=self.values[which], lines=lines)

    def check(self, name: str, asked: str) -> None:
        """Raise `InputError` where there is no such column; `asked` says who asks for it."""
        if name not in self.names:
            shown = ", ".join(each[:60] for each in self.names[:12]) + (", ..." if len(self.names) > 12 else "")
            raise InputError(f'{asked}: {self.source} has no column "{name[:60]}"; it has {shown}')

    def column(self, name: str, asked: str) -> Floats:
        """Return the values of a column, once they are known to be finite, shape (rows,).

        Parameters
        ----------
        name : str
        asked : str
            Who asks for it, for messages.
        """
        self.check(name, asked)
        values = self.values[:, self.names.index(name)]
        bad = np.flatnonzero(~(np.abs(values) <= checks.LARGEST))
        if bad.size:
            raise InputError(
                f'{self.at(int(bad[0]))}: channel "{name}" holds {values[bad[0]]} ({bad.size} such values in '
                "all); mend the record or cut it before that line"
            )
        return checks.frozen(values.copy())


def sampling_rate_of(time: Floats, columns: Columns, name: str, declared: float | None = None) -> float:
    """Find the sampling rate that a time column shows, Hz.

    Stamps that a logger has rounded, 0.004, 0.008, 0.012, ... s at 256 Hz, show the rate that all of them fit.

    Parameters
    ----------
    time : array, shape (samples,)
        s.
    columns : Columns
    name : str
        Of the column.
    declared : float, optional
        Hz; with it the stamps may be coarser than the samples.

    Raises
    ------
    InputError
        Where the column does not ascend, has a gap, or changes its step, naming the line.
    """
    steps = np.diff(time)
    step = float(np.median(steps))
    odd = np.flatnonzero(np.abs(steps - step) > UNEVEN_STEP * abs(step))
    if step > 0 and not odd.size:
        return float((len(time) - 1) / (time[-1] - time[0]))
    rounded = rate_within_rounding(time, declared)
    if rounded is None:
        if step <= 0 or odd.size > COARSE * len(steps):
            _refuse_coarse(time, step, columns, name)
        _refuse_uneven(steps, step, odd, columns, name)
    return rounded


def _refuse_coarse(time: Floats, step: float, columns: Columns, name: str) -> None:
    """Refuse stamps that repeat because they are rounded to more than a sample, where they do."""
    rounding = rounding_of(time)
    repeats = bool(np.any(np.isclose(step, (0.0, rounding), atol=1e-9))) and bool(np.all(np.diff(time) >= 0))
    if repeats and time[-1] > time[0]:
        raise InputError(
            f'{columns.source}: column "{name}" is rounded to {rounding:g} s, more than a sample, so that stamps '
            "repeat; give record: sampling_rate, in Hz"
        )
    if step <= 0:
        raise InputError(f'{columns.source}: column "{name}" must ascend; its median step is {step:g} s')


def _refuse_uneven(steps: Floats, step: float, odd: Ints, columns: Columns, name: str) -> NoReturn:
    first = int(odd[0])
    if steps[first] <= 0:
        raise InputError(
            f'{columns.at(first + 1)}: channel "{name}" goes back, or stands still, by {steps[first]:g} s after the '
            "sample before"
        )
    # A handful of odd steps are gaps; a fifth of all, each like the next, are a second rate.
    others = float(np.median(steps[odd]))
    alike = np.mean(np.abs(steps[odd] - others) < UNEVEN_STEP * others)
    if odd.size > 0.1 * len(steps) and alike > 0.9:
        before = float(steps[0])
        change = int(np.argmax(np.abs(steps - before) > UNEVEN_STEP * before))
        raise InputError(
            f'{columns.at(change + 1)}: channel "{name}" has two sampling rates, {1 / before:.6g} Hz and from here '
            f"{1 / float(steps[change]):.6g} Hz; hand in the stretches as separate records or resample them to one rate"
        )
    raise InputError(
        f'{columns.at(first + 1)}: channel "{name}" has a gap of {steps[first]:g} s where the step is {step:g} s '
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
