"""Standard deviations of what is computed of an uncertain frame.

Linear, along each of the independent directions of the frame's uncertainty: half the difference between plus and minus
one standard deviation. That is the slope of a secant; a peak changes its time along the way, where a derivative at
one point would know but one of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cvxshear.response.uncertain import Damped, UncertainFrame
from cvxshear.util.typing import Floats

FARTHEST = 0.5
"""Largest relative change of a mass or stiffness on the way; a direction that would change one by more is gone along
as far as that."""


def propagated(frame: UncertainFrame, function: Callable[[Damped], Floats]) -> tuple[Damped, Floats]:
    """The frame as it was fitted, and the standard deviations of a function of it.

    Parameters
    ----------
    frame : UncertainFrame
    function : callable
        Takes a `Damped`, returns an array of any one shape.

    Returns
    -------
    centre : Damped
    std : ndarray
        Of the shape that the function returns; nan where nothing tells the noise.
    """
    centre = frame.at(np.zeros(frame.size))
    if not frame.uncertain:
        return centre, np.full_like(function(centre), np.nan)
    variance: Floats | float = 0.0
    for direction, length in enumerate(_lengths(frame)):
        xi = np.zeros(frame.size)
        xi[direction] = length
        slope = (function(frame.at(xi, centre)) - function(frame.at(-xi, centre))) / (2 * length)
        variance = variance + slope**2
    return centre, np.sqrt(variance)


def sampled(
    frame: UncertainFrame, function: Callable[[Damped], Floats], samples: int, rng: np.random.Generator
) -> Floats:
    """The function at random frames, shape (samples, ...): what the linear propagation is checked by.

    Parameters
    ----------
    frame : UncertainFrame
    function : callable
    samples : int
    rng : numpy.random.Generator

    Raises
    ------
    InputError
        Where a frame drawn has no modes.
    """
    centre = frame.at(np.zeros(frame.size))
    return np.array([function(frame.at(rng.standard_normal(frame.size), centre)) for _ in range(samples)])


def _lengths(frame: UncertainFrame) -> Floats:
    """How far each direction is gone along, in standard deviations."""
    fitted = frame.fitted
    n = 2 * fitted.experiment.stories
    share = np.max(np.abs(fitted.root[:n]) / fitted.theta[:n, None], axis=0, initial=0.0)
    steps = np.minimum(1.0, FARTHEST / np.maximum(share, FARTHEST))
    return np.concatenate([steps, np.ones(frame.size - len(steps))])
