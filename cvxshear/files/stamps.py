"""The sampling rate behind a column of time stamps that a logger has rounded.

Stamps t_k that were rounded, up, down or to the nearest, to a whole multiple of q stand within a band of height q
around a straight line t_0 + k / f. A sample that is missing moves all that follow by 1 / f and out of the band,
but for two cases: 1 / f is small beside q, or 1 / f is a whole multiple of q, so that the stamps are exact and
leave the band empty. The second shows by its steps, which are all alike but for those at the gaps.
"""

from __future__ import annotations

import numpy as np

from cvxshear.util.typing import Floats

FINEST, COARSEST = -9, 0
"""Powers of ten, s: what loggers round to."""
WHOLE = 1e-4
"""Of the rounding step: so near must all stamps be to whole multiples of it."""
SLACK = 0.1
"""Of the rounding step on either side, for the line's own error."""
SHORTEST = 0.75
"""Of the rounding step: an interval between samples that still shows when one is missing."""
EXACT = 1.5
"""Of the rounding step: an interval so long leaves the band where a sample is missing from exact stamps too."""
LEAST_SHARE = 0.02
"""Of the steps: where fewer differ from the usual one, they are gaps and not the work of rounding."""
DIGITS = 1e-12
"""Of the largest stamp: what the binary number itself rounds."""


def rounding_of(time: Floats) -> float:
    """The coarsest power of ten, s, that all stamps are whole multiples of; 0 where they are of none.

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
    """The one sampling rate that the stamps fit within their rounding, Hz; None where they fit none.

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
    if interval < EXACT * rounding and _share_of_odd_steps(time, rounding) < LEAST_SHARE:
        return None
    return 1.0 / interval


def _share_of_odd_steps(time: Floats, rounding: float) -> float:
    steps = np.round(np.diff(time) / rounding)
    _, counts = np.unique(steps, return_counts=True)
    return 1.0 - float(counts.max()) / len(steps)
