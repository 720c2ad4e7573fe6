"""Which single mistake, if any, explains what a configuration reads.

A reading is compared, as it is given and after each single repair, with the nearest shear frame. A mistake is told
where one repair brings it nearer by more than `TOLD`, a difference of sums of squared standard deviations; repairs
that do as well as the best within `ALIKE` are named with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.frame import Modes
from cvxshear.screening.reading import Reading
from cvxshear.screening.repairs import KINDS, Repair
from cvxshear.screening.shear_fit import Fit, distance, farthest, misfit, modes_at, robust_fit, starts

TOLD = 25.0
"""Gain in squared standard deviations from which on a mistake is told; 2 log of the number of choices comes on top."""

ALIKE = 9.0
"""Repairs whose cost is so near to the best one's are named with it."""

FITTED = 6
"""Repairs of the least misfit to each reference frame that are fitted."""

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
        if not self.judged or self.given.cost - self.judged[0].cost < TOLD:
            return ()
        return tuple(item for item in self.judged if item.cost - self.judged[0].cost < ALIKE)


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
    judged = [
        Judged(repair, distance(repair.reading, [robust.theta, begin[0]]).cost + 2 * np.log(repair.choices))
        for repair in _nearest(candidates, frames)
    ]
    return Verdict(given, tuple(sorted(judged, key=lambda item: item.cost)))


def _nearest(candidates: Sequence[Repair], frames: Sequence[Modes]) -> list[Repair]:
    """The candidates of the least misfit to one of the frames, each reading once, in their order."""
    chosen: set[int] = set()
    for frame in frames:
        misfits = [misfit(repair.reading, frame) for repair in candidates]
        chosen |= set(np.argsort(misfits, kind="stable")[:FITTED].tolist())
    return [candidates[place] for place in sorted(chosen)]
