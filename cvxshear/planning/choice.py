"""From shares to a choice: rounding, and exchanges of one candidate for another while they improve it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.criteria import Criterion
from cvxshear.planning.others import equally_spaced
from cvxshear.planning.relaxation import relaxed
from cvxshear.util.typing import Floats, Ints

IMPROVES = 1e-9
"""Relative gain from which on an exchange is made; less is rounding."""

AT_ONCE = 2_000_000
"""Numbers in the information matrices that are formed at a time."""

FEW = 20_000
"""Choices of which every one is looked at, where the information has `TYPICAL` rows: eighteen floors choose six."""

TYPICAL = 45

AT_LAST = 2
"""Times as many, of which every one is looked at where windows leave a gap: a few sensors on a tall frame."""

ENOUGH = 0.05
"""Gap from which on no closer bound is looked for."""

WIDTHS = (4, 6, 8, 10)
"""Floors in the windows of the closer bound, tried one after the other."""

MOST_WORK = 6e7
"""Parameters, times choices within a window, times the numbers that each takes: two seconds."""

SEED = 2009
DRAWS, FEWER_DRAWS = 8, 1
"""Choices drawn with the shares as odds; fewer where there are more than `MANY` candidates, and each takes long."""

MANY = 24


@dataclass(frozen=True, eq=False)
class Choice:
    """Candidates that are chosen, and how far from the best they can be.

    Parameters
    ----------
    chosen : ndarray of int, shape (N,)
        Ascending, zero-based.
    value : float
        The criterion's standard deviation.
    bound : float
        What no choice of as many can beat; the value itself where all were looked at.
    program : float
        What the convex program alone says that no choice can beat; the value where it was not needed.
    """

    chosen: Ints
    value: float
    bound: float
    program: float

    @property
    def gap(self) -> float:
        """How far the choice is above the bound, relative."""
        return self.value / self.bound - 1.0 if self.bound > 0 else float("inf")


def choose(
    of: Candidates,
    number: int,
    by: Criterion,
    solver: str = "clarabel",
    enumerate_up_to: int = FEW,
    widths: Sequence[int] = WIDTHS,
) -> Choice:
    """The best choice: of all, where there are few, else the best that rounding and exchange find.

    Parameters
    ----------
    of : Candidates
    number : int
        How many.
    by : Criterion
    solver : str, optional
    enumerate_up_to : int, optional
        Where there are no more choices than this, each is looked at.
    widths : sequence of int, optional
        Of the windows with which a closer bound is looked for while the gap is above `ENOUGH`; none where the choice
        alone is wanted.
    """
    work = comb(of.count, number) * (len(of.base) / TYPICAL) ** 3
    if work <= enumerate_up_to:
        return _best_of_all(of, number, by)
    found = relaxed(of, number, by, solver)
    value, chosen = min(exchanged(of, start, by) for start in _roundings(found.shares, number))
    bound = found.bound
    # Tangents at the program's own shares are far below where it leaves whole parts of the frame without any.
    evened = (found.shares + number / of.count) / 2
    for width in _affordable(widths, of):
        if value <= (1 + ENOUGH) * bound:
            break
        higher, start = by.windowed(of, evened, number, width, value / (1 + ENOUGH))
        bound = max(bound, higher)
        value, chosen = min((value, chosen), exchanged(of, start, by))
    if widths and value > (1 + ENOUGH) * bound and work <= AT_LAST * enumerate_up_to:
        return _best_of_all(of, number, by, found.bound)
    return Choice(np.array(chosen), value, min(bound, value), min(found.bound, value))


def _best_of_all(of: Candidates, number: int, by: Criterion, program: float | None = None) -> Choice:
    value, chosen = exhaustive(of, number, by)
    return Choice(np.array(chosen), value, value, value if program is None else program)


def _affordable(widths: Sequence[int], of: Candidates) -> list[int]:
    """Those of the windows whose choices can all be looked at in a few seconds."""
    n, d, _ = of.rows.shape
    return [width for width in widths if width <= n and len(of.asked) * 2**width * n * d**2 <= MOST_WORK]


def _roundings(shares: Floats, number: int) -> list[list[int]]:
    """Choices to exchange from: the largest shares, equal distances, and a few drawn with the shares as odds."""
    rng = np.random.default_rng(SEED)
    count = len(shares)
    # The largest of log(share) + Gumbel noise are a draw without replacement with the shares as odds.
    odds = np.log(np.maximum(shares, 1e-6))
    drawn = [odds + rng.gumbel(size=count) for _ in range(DRAWS if count <= MANY else FEWER_DRAWS)]
    largest = [np.argsort(-each, kind="stable")[:number].tolist() for each in (shares, *drawn)]
    return [*largest, equally_spaced(count, number)]


def exchanged(of: Candidates, start: Sequence[int], by: Criterion) -> tuple[float, list[int]]:
    """Exchange one candidate for another, the best exchange each time, while that improves the choice.

    Returns
    -------
    value : float
    chosen : list of int
        Ascending.
    """
    chosen = sorted(start)
    value = float(by.value(of, of.subset(chosen)))
    while True:
        others = [j for j in range(of.count) if j not in chosen]
        if not others:
            return value, chosen
        ends = []
        for out in chosen:
            kept = [i for i in chosen if i != out]
            values = by.value_of(of, of.own_with_each(kept, others))
            best = int(np.argmin(values))
            ends.append((float(values[best]), sorted([*kept, others[best]])))
        least, nearest = min(ends)
        if least >= value * (1 - IMPROVES):
            return value, chosen
        value, chosen = least, nearest


def values_of(of: Candidates, choices: Sequence[Sequence[int]], by: Criterion) -> Floats:
    """The criterion of each of many choices, shape (len(choices),)."""
    step = max(1, AT_ONCE // of.base.size)
    parts = []
    for first in range(0, len(choices), step):
        some = choices[first : first + step]
        shares = np.zeros((len(some), of.count))
        np.put_along_axis(shares, np.array(some), 1.0, axis=1)
        parts.append(by.value(of, of.information(shares)))
    return np.concatenate(parts)


def exhaustive(of: Candidates, number: int, by: Criterion) -> tuple[float, list[int]]:
    """The best of all choices of so many candidates, each of them looked at.

    Returns
    -------
    value : float
    chosen : list of int
        Ascending.
    """
    every = list(combinations(range(of.count), number))
    values = values_of(of, every, by)
    best = int(np.argmin(values))
    return float(values[best]), list(every[best])
