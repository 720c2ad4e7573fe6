"""The best choice along a row of candidates, where what counts is the choice within each window of neighbours.

Dynamic programming: the state is the choice within the last window and the number chosen so far.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.util.typing import Bools, Floats, Ints


def patterns(width: int) -> Ints:
    """Every choice within a window, shape (2^width, width): bit b of a choice's place is candidate b."""
    result: Ints = (np.arange(2**width)[:, None] >> np.arange(width)) & 1
    return result


def least_sum(values: Floats, slopes: Floats, number: int) -> tuple[float, list[int]]:
    """The least that the windows' values and the chosen candidates' slopes can add up to, and where.

    Parameters
    ----------
    values : ndarray, shape (n - width + 1, 2^width)
        Of each window, for each choice within it.
    slopes : ndarray, shape (n,)
    number : int
        Candidates that are chosen.
    """
    return _least(values, slopes, number, np.add)


def least_largest(values: Floats, number: int) -> tuple[float, list[int]]:
    """The least that the largest of the windows' values can be, and where; parameters as in `least_sum`."""
    width = int(values.shape[1]).bit_length() - 1
    return _least(values, np.zeros(len(values) + width - 1), number, np.maximum)


def _least(values: Floats, slopes: Floats, number: int, together: np.ufunc) -> tuple[float, list[int]]:
    every = values.shape[1]
    half, width = every // 2, every.bit_length() - 1
    within = patterns(width)
    counts = within.sum(axis=1)
    cost = np.full((every, number + 1), np.inf)
    few = np.flatnonzero(counts <= number)
    cost[few, counts[few]] = (values[0] + within @ slopes[:width])[few]
    gone = []
    for first in range(1, len(values)):
        # The lowest candidate leaves the window, of whose two states the better is kept; a new one enters at the top.
        without, with_it = cost[0::2], cost[1::2]
        gone.append(with_it < without)
        kept = np.minimum(without, with_it)
        cost = np.full((every, number + 1), np.inf)
        cost[:half] = kept
        cost[half:, 1:] = kept[:, :-1] + slopes[first + width - 1]
        cost = together(cost, values[first][:, None])
    state = int(np.argmin(cost[:, number]))
    return float(cost[state, number]), _traced(state, number, gone, width)


def _traced(state: int, number: int, gone: Sequence[Bools], width: int) -> list[int]:
    """The candidates of the path that ends in a state of the last window, ascending."""
    last = len(gone)
    chosen = [last + bit for bit in range(width) if state >> bit & 1]
    for first in range(last - 1, -1, -1):
        entered, before = state >> (width - 1), state & (2 ** (width - 1) - 1)
        number -= entered
        leaves = int(gone[first][before, number])
        if leaves:
            chosen.append(first)
        state = before << 1 | leaves
    return sorted(chosen)
