"""Response spectra of floors: what equipment on a floor is shaken by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.fit.results import plain
from cvxshear.response.hold import held
from cvxshear.util.typing import Floats, Json

LINES = 60


@dataclass(frozen=True, eq=False)
class FloorSpectra:
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

    def to_dict(self) -> Json:
        """The fields as lists."""
        return {
            "frequencies": plain(self.frequencies),
            "damping": self.damping,
            "acceleration": plain(self.acceleration),
        }


def spectrum_lines(first: float, last: float, rate: float) -> Floats:
    """Frequencies for a spectrum, Hz: from a fifth of the frame's first to three times its last, as the rate allows."""
    return np.geomspace(first / 5, max(min(3 * last, rate / 4), first), LINES)


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
