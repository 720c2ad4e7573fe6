"""Which of the starting points of a fit is nearest to the data."""

from __future__ import annotations

import numpy as np

from cvxshear.fit.misfit import Misfit
from cvxshear.fit.smooth import smooth_start
from cvxshear.fit.start import starts, uniform
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Floats

FAR_OFF = 100.0
"""Chi-square a datum beyond which a starting point is not near the data: errors of ten standard deviations."""


def nearest_start(misfit: Misfit) -> Floats:
    """The starting point nearest to the data, the effects' parameters where they start.

    Parameters
    ----------
    misfit : Misfit

    Returns
    -------
    ndarray, shape (P,)

    Raises
    ------
    NoModesError
        Where no starting point has modes.
    """
    own = np.array([value for placed in misfit.effects for value in placed.start])
    for start in nearest_first(misfit, own):
        return np.concatenate([start, own])
    raise NoModesError("no starting point has modes")


def nearest_first(misfit: Misfit, own: Floats) -> list[Floats]:
    """The starting points with modes, the nearest to the data first; before them a smooth frame where none is near.

    Parameters
    ----------
    misfit : Misfit
    own : ndarray, shape (p,)
        Starting values of the effects' parameters.

    Returns
    -------
    list of ndarray, shape (2N,)
    """

    def chi2(start: Floats) -> float:
        try:
            return misfit.evaluate(np.concatenate([start, own]), derivatives=False).chi2
        except NoModesError:
            return float("inf")

    measured = [(chi2(start), start) for start in starts(misfit.experiment)]
    usable = sorted((item for item in measured if np.isfinite(item[0])), key=lambda item: item[0])
    ordered = [start for _, start in usable]
    if usable and usable[0][0] <= FAR_OFF * misfit.count(np.concatenate([ordered[0], own])):
        return ordered
    smooth = smooth_start(misfit.experiment, uniform(misfit.experiment))
    return [smooth, *ordered] if np.isfinite(chi2(smooth)) else ordered
