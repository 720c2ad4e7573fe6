"""Quantities of a response over time, their largest values, and response spectra of the floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.response.damped import Response, held
from cvxshear.util.results import InJson, as_json
from cvxshear.util.typing import Floats, Json

RESPONSES = {
    "floor_acceleration": "m/s2",
    "floor_displacement": "m",
    "story_drift": "m",
    "story_drift_ratio": "",
    "story_shear": "N",
    "base_shear": "N",
    "overturning_moment": "N m",
}
"""With their units; the last two are one number each, the others one a floor or story."""


def histories(response: Response) -> dict[str, Floats | None]:
    """Every quantity over time, shapes (samples, N) or (samples,); None where it does not apply."""
    return {
        "floor_acceleration": response.acceleration,
        "floor_displacement": response.displacement,
        "story_drift": response.drift,
        "story_drift_ratio": response.drift_ratio,
        "story_shear": response.story_shear,
        "base_shear": response.base_shear,
        "overturning_moment": response.overturning_moment,
    }


def largest(responses: Sequence[Response]) -> dict[str, Floats]:
    """Largest size of each quantity that applies, over all samples of all runs, shape (N,) or (1,)."""
    result: dict[str, Floats] = {}
    for response in responses:
        for name, values in histories(response).items():
            if values is not None:
                peak = np.atleast_1d(np.max(np.abs(values), axis=0))
                result[name] = np.maximum(result[name], peak) if name in result else peak
    return result


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks with standard deviations.

    Parameters
    ----------
    values, std : dict of str to ndarray
        By the names of `RESPONSES`, those that apply; shape (N,) or (1,); nan where a deviation is not known.
    """

    values: dict[str, Floats]
    std: dict[str, Floats]

    def to_dict(self) -> Json:
        """Each quantity and its `_std`; null where it does not apply."""
        result: Json = {}
        for name in RESPONSES:
            single = name in ("base_shear", "overturning_moment")
            for key, values in ((name, self.values.get(name)), (f"{name}_std", self.std.get(name))):
                result[key] = as_json(values[0] if single and values is not None else values)
        return result


SPECTRUM_LINES = 60


@dataclass(frozen=True, eq=False)
class FloorSpectra(InJson):
    """Largest total acceleration of an oscillator on each floor.

    Parameters
    ----------
    frequencies : ndarray, shape (lines,)
        Natural frequencies of the oscillator, Hz.
    damping : float
        Its damping ratio.
    acceleration : ndarray, shape (N, lines)
        m/s2.
    """

    frequencies: Floats
    damping: float
    acceleration: Floats


def spectrum_lines(first: float, last: float, rate: float) -> Floats:
    """Frequencies for a spectrum, Hz: from a fifth of the frame's first to three times its last, as the rate allows."""
    return np.geomspace(first / 5, max(min(3 * last, rate / 4), first), SPECTRUM_LINES)


def floor_spectra(acceleration: Floats, step: float, frequencies: Floats, damping: float = 0.05) -> FloorSpectra:
    """Spectra of accelerations that are straight lines between samples.

    The oscillator's total acceleration is -(2 zeta omega v + omega^2 u) = 2 Re(-s^2 z / (2 i omega_d)).

    Parameters
    ----------
    acceleration : ndarray, shape (samples, N)
        m/s2.
    step : float
        s.
    frequencies : ndarray, shape (lines,)
        Hz.
    damping : float, optional
    """
    omega = 2 * np.pi * frequencies
    s = omega * (-damping + 1j * np.sqrt(1 - damping**2))
    factor = -(s**2) / (1j * s.imag)
    peaks = [
        np.max(np.abs((factor[:, None] * held(s, floor, step)).real), axis=1)
        for floor in np.ascontiguousarray(acceleration.T)
    ]
    return FloorSpectra(frequencies, damping, np.array(peaks))
