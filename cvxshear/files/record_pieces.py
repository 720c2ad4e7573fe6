"""Where the samples of a run stand: its time column, its sampling rate, and the stretches without gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.files.columns import Columns, sampling_rate_of
from cvxshear.files.record_tables import ChannelDeclaration
from cvxshear.records.data_frames import FEWEST_SAMPLES, LEAST_USED, TIME_NAMES
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
"""Units of a time column, s."""

LONG_STEP = 1.75
"""Longest step without a gap, as a multiple of the usual one; a longer one lost a sample, whatever the rounding."""

MOST_GAPS = 0.01
"""Share of the steps: where more are too long it is no gap but another sampling rate, which is refused."""


def pieces_of(
    columns: Columns,
    needed: Sequence[ChannelDeclaration],
    declared: Mapping[str, Any],
    run: Mapping[str, Any],
    path: Path,
) -> tuple[list[slice], float, str]:
    """Find the longest stretches of a file without gaps, its sampling rate, and what was left out, in words.

    Parameters
    ----------
    columns : Columns
    needed : sequence of ChannelDeclaration
        Whose columns must hold numbers.
    declared, run : dict
        The tables [record] and [[run]]; of the latter, `start` and `end` in s since the first sample.
    path : Path
        The record file.

    Returns
    -------
    pieces : list of slice
        Of the rows, in their order; one where nothing is missing.
    rate : float
        Hz.
    left_out : str
        Empty where nothing was.

    Raises
    ------
    InputError
        Where most of the samples would be left out, or none is between `start` and `end`.
    """
    for item in needed:
        columns.check(item.name, item.place or path.name)
    name = time_column_of(declared, columns)
    sound: Bools = np.all(np.isfinite(columns.values[:, [columns.names.index(item.name) for item in needed]]), axis=1)
    # A break stands before each row that does not follow the one before.
    breaks = np.zeros(len(columns.values), dtype=np.bool_)
    if name is None:
        rate = rate_of(declared, columns)
    else:
        time = columns.values[:, columns.names.index(name)]
        sound &= np.isfinite(time)
        steps = np.diff(time[sound])
        jumps = np.flatnonzero(steps > LONG_STEP * np.median(steps)) if steps.size else np.zeros(0, dtype=int)
        if 0 < jumps.size <= MOST_GAPS * len(time) and np.all(steps > 0):
            breaks[np.flatnonzero(sound)[jumps + 1]] = True
    first, last = _asked(columns, name, declared, run)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], sound, [False]]).astype(int)) != 0)
    stretches = [slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    pieces = []
    for stretch in stretches:
        cuts = [stretch.start, *(stretch.start + np.flatnonzero(breaks[stretch])).tolist(), stretch.stop]
        pieces += [slice(max(a, first), min(b, last)) for a, b in pairwise(sorted(set(cuts)))]
    lengths = [max(0, each.stop - each.start) for each in pieces]
    longest = max(lengths, default=0)
    kept = [each for each, length in zip(pieces, lengths, strict=True) if length >= max(FEWEST_SAMPLES, longest / 4)]
    wanted, used = last - first, sum(each.stop - each.start for each in kept)
    if used < LEAST_USED * wanted or (not kept and longest == wanted):
        # Whatever is wrong with the whole is said by those who read it.
        kept = [slice(first, last)]
        for item in needed:
            columns.rows(kept[0]).column(item.name, item.place or path.name)
    if name is not None:
        rate = rate_of(declared, columns.rows(max(kept, key=lambda each: each.stop - each.start)))
    if len(kept) == 1 and kept[0] == slice(first, last):
        return kept, rate, ""
    told = ", ".join(f"{each.start / rate:.4g} to {each.stop / rate:.4g} s" for each in kept)
    return kept, rate, (
        f"{wanted - used} of {wanted} samples are missing or stand between gaps; the longest sound pieces are used as "
        f"runs of their own: {told}"
    )  # fmt: skip


def _asked(columns: Columns, name: str | None, declared: Mapping[str, Any], run: Mapping[str, Any]) -> tuple[int, int]:
    """Return the rows from `start` to `end` of a run: the first, and the one after the last."""
    count = len(columns.values)
    if not {"start", "end"} & set(run):
        return 0, count
    if name is None:
        time = np.arange(count) / rate_of(declared, columns)
    else:
        time = seconds_of(declared, columns.values[:, columns.names.index(name)])
        time = np.maximum.accumulate(np.nan_to_num(time - time[np.isfinite(time)][0], nan=0.0))
    first, last = np.searchsorted(time, [run.get("start", 0.0), run.get("end", np.inf)])
    if last - first < FEWEST_SAMPLES:
        raise InputError(
            f"{columns.source} has {last - first} samples between start and end of the run; it lasts {time[-1]:.4g} s "
            f"from its first sample, and at least {FEWEST_SAMPLES} samples are needed"
        )
    return int(first), int(last)


def rate_of(declared: Mapping[str, Any], columns: Columns) -> float:
    """Find the sampling rate: of the time column, as declared where the two agree, or else as the file states it."""
    name = time_column_of(declared, columns)
    said = declared.get("sampling_rate")
    if said is not None:
        said = checks.number(said, "record: sampling_rate", above=0.0)
    if name is None:
        if said is not None:
            return said
        if columns.stated_rate is not None:
            return columns.stated_rate[1]
        raise InputError(f"record: give sampling_rate, in Hz, or time, the name of the time column of {columns.source}")
    rate = sampling_rate_of(seconds_of(declared, columns.column(name, "record: time")), columns, name, said)
    if said is not None:
        if abs(rate - said) > 0.01 * said:
            raise InputError(
                f'record: sampling_rate = {said:g} Hz, but column "{name}" of {columns.source} ticks at {rate:.6g} Hz'
            )
        return said
    return rate


def time_column_of(declared: Mapping[str, Any], columns: Columns) -> str | None:
    """Find the name of the time column: that declared, or one of the usual names; None where there is none."""
    name = declared.get("time") or next((item for item in TIME_NAMES if item in columns.names), None)
    if name is not None:
        columns.check(name, "record: time")
    return name


def seconds_of(declared: Mapping[str, Any], time: Floats) -> Floats:
    """Return a time column in s."""
    unit = checks.choice(declared.get("time_unit", "s"), tuple(TIME_UNITS), "record: time_unit")
    return time * TIME_UNITS[unit]


def refuse_two_rates(rates: list[tuple[float, str]]) -> None:
    """Raise `InputError` where files of one record were sampled at different rates."""
    for rate, source in rates[1:]:
        if abs(rate - rates[0][0]) > 1e-3 * rates[0][0]:
            raise InputError(
                f"{source} is sampled at {rate:.6g} Hz, {rates[0][1]} at {rates[0][0]:.6g} Hz: two sampling rates in "
                "one record; resample one of them"
            )
