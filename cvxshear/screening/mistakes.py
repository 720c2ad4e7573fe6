"""Which single mistake, if any, explains what a configuration reads.

A reading is compared, as it is given and after each single repair, with the nearest shear frame. A mistake is told
where one repair brings it nearer by more than `TOLD`, a difference of sums of squared standard deviations; repairs
that do as well as the best within `ALIKE` are named with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.reading import Reading
from cvxshear.screening.repairs import KINDS, Repair
from cvxshear.screening.shear_fit import Fit, distance, farthest, fit, misfit, modes_at, robust_fit, starts
from cvxshear.util.typing import Floats

TOLD = 25.0
"""Gain in squared standard deviations from which on a mistake is told; 2 log of the number of choices comes on top."""

ALIKE = 9.0
"""Repairs whose cost is so near to the best one's are named with it."""

PLAUSIBLE = 4.0
"""A datum: where no more than this is left, a repair explains the reading."""

UNEXPLAINED = 0.25
"""Of the cost as given: nor need less than this be left."""

FITTED = 6
"""Repairs of the least misfit to each reference frame that are fitted."""

ROUGHLY = 10
"""Evaluations of a fit that only ranks."""

KEPT = 6
"""Of these, the best, which are fitted with either tolerance."""

TALLEST = 24
"""Stories up to which repairs are tried: there are as many as the square of their number, each a fit."""

FAR = 3.5
"""Standard deviations, the smaller tolerance included: a reading none of whose data are farther off is let pass."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A repair and what is left after it.

    Parameters
    ----------
    repair : Repair
    cost : float
        Of its fit, and 2 log of the number of choices.
    """

    repair: Repair
    cost: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """One configuration as it is given, and after each repair that was fitted.

    Parameters
    ----------
    given : Fit
    judged : tuple of Judged
        The best first; empty where the reading as given needs none.
    """

    given: Fit
    judged: tuple[Judged, ...]

    @property
    def told(self) -> tuple[Judged, ...]:
        """The repairs that explain the reading, one of which is needed; none where it may stand as given."""
        if not self.judged:
            return ()
        best = self.judged[0]
        left = max(TOLD + PLAUSIBLE * best.repair.reading.count, UNEXPLAINED * self.given.cost)
        if self.given.cost - best.cost < TOLD or best.cost > left:
            return ()
        return tuple(item for item in self.judged if item.cost - best.cost < ALIKE)


def judge(reading: Reading) -> Verdict:
    """Compare a reading with shear frames, as given and after single repairs."""
    begin = starts(reading.stories)
    given = distance(reading, begin)
    if given.cost < TOLD or farthest(reading.closer, given.modes) < FAR:
        return Verdict(given, ())
    robust = robust_fit(reading, given.theta)
    references = [*begin, robust.theta]
    frames = [modes_at(theta) for theta in references]
    candidates = [repair for kind in KINDS for repair in kind(reading, frames)]
    misfits = np.array([[misfit(repair.reading, frame) for frame in frames] for repair in candidates])
    nearest = np.unique(np.argsort(misfits, axis=0, kind="stable")[:FITTED])
    first = {
        place: fit(candidates[place].reading, [references[int(np.argmin(misfits[place]))]], evaluations=ROUGHLY)
        for place in nearest.tolist()
    }
    order = sorted(first, key=lambda place: first[place].cost)[:KEPT]
    judged = [_judged(candidates[place], first[place].theta) for place in order]
    return Verdict(given, tuple(sorted(judged, key=lambda item: item.cost)))


def _judged(repair: Repair, at: Floats) -> Judged:
    return Judged(repair, distance(repair.reading, [at]).cost + 2 * float(np.log(repair.choices)))
