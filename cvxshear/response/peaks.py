"""Quantities of a response over time, their largest values, and response spectra of the floors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cvxshear.response.damped import DampedModel, Response, driven_poles
from cvxshear.util import ranking
from cvxshear.util.quantities import column_name
from cvxshear.util.results import InJson, as_json, data_frame
from cvxshear.util.typing import Floats, Ints, Json

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Quantity:
    """A quantity of a response.

    Parameters
    ----------
    attribute : str
        Of `Response`, that has it over time.
    word, unit : str
        The unit is empty where there is none.
    single : bool, optional
        Whether it is one number, not one a floor or story.
    """

    attribute: str
    word: str
    unit: str
    single: bool = False


RESPONSES = {
    "floor_acceleration": Quantity("acceleration", "acceleration", "m/s²"),
    "floor_displacement": Quantity("displacement", "displacement", "m"),
    "story_drift": Quantity("drift", "drift", "m"),
    "story_drift_ratio": Quantity("drift_ratio", "drift ratio", ""),
    "story_shear": Quantity("story_shear", "shear", "N"),
    "base_shear": Quantity("base_shear", "base shear", "N", single=True),
    "overturning_moment": Quantity("overturning_moment", "overturning moment", "N m", single=True),
}
"""Quantities of a response."""


def histories(response: Response) -> dict[str, Floats | None]:
    """Every quantity over time, shapes (samples, N) or (samples,); None where it does not apply."""
    return {name: getattr(response, quantity.attribute) for name, quantity in RESPONSES.items()}


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
        for name, quantity in RESPONSES.items():
            for key, values in ((name, self.values.get(name)), (f"{name}_std", self.std.get(name))):
                result[key] = as_json(values[0] if quantity.single and values is not None else values)
        return result

    def to_dataframe(self, more: Mapping[str, Floats] | None = None) -> pd.DataFrame:
        """Return a row for each floor or story: each quantity and its `_std` with their unit, then more columns.

        Quantities of the whole frame, such as the base shear, are left out.
        """
        columns: dict[str, Sequence[object]] = {}
        for name, values in self.values.items():
            quantity = RESPONSES[name]
            if not quantity.single:
                columns[column_name(name, quantity.unit)] = values.tolist()
                columns[column_name(f"{name}_std", quantity.unit)] = self.std[name].tolist()
        columns |= {name: values.tolist() for name, values in (more or {}).items()}
        count = len(self.values["story_drift"])
        return data_frame({"story": range(1, count + 1), **columns}).set_index("story")


STRONG = 0.5
"""Size of a sample, relative to the peak, from which on it belongs to the strong part of a motion."""


def peaks_of(runs: Iterable[tuple[Response, Mapping[str, Floats]]]) -> Peaks:
    """Find the largest size of each quantity that applies, with its deviation.

    A peak stands between samples, on the parabola through the largest one and its neighbors: at 50 Hz the sample itself
    is up to 1.8 % too small for a motion of 3 Hz, the parabola 0.05 %.

    Its deviation is that of the sample at which the peak stands, but no less, relative to the peak, than the rms
    deviation of the strong part is to the rms motion there. What one direction of the frame's uncertainty moves swings
    as the motion does, and where it passes through zero at the peak the deviation of that one sample says nothing of
    what is known to second order, or of what the model lacks.

    Parameters
    ----------
    runs : iterable of (Response, dict of str to ndarray)
        Each with the standard deviations over time that are known, by the names of `RESPONSES`.
    """
    values: dict[str, Floats] = {}
    stds: dict[str, Floats] = {}
    for moved, deviations in runs:
        for name, history in histories(moved).items():
            if history is None:
                continue
            columns = history.reshape(len(history), -1)
            at = ranking.largest(np.abs(columns), axis=0)
            take = np.arange(columns.shape[1])
            peak = _between_samples(np.abs(columns), at)
            std = np.full(len(peak), np.nan)
            if name in deviations:
                band, strong = deviations[name].reshape(columns.shape), np.abs(columns) >= STRONG * peak
                of_motion = np.sum(band**2 * strong, axis=0) / np.maximum(np.sum(columns**2 * strong, axis=0), 1e-300)
                std = np.maximum(band[at, take], peak * np.sqrt(of_motion))
            if name in values:
                larger = peak > values[name]
                peak, std = np.where(larger, peak, values[name]), np.where(larger, std, stds[name])
            values[name], stds[name] = peak, std
    return Peaks(values, stds)


def _between_samples(sizes: Floats, at: Ints) -> Floats:
    """Find the top of the parabola through the largest sample of each column and its neighbors, shape (columns,)."""
    take = np.arange(sizes.shape[1])
    before, top, after = (sizes[np.clip(at + step, 0, len(sizes) - 1), take] for step in (-1, 0, 1))
    bend = 2 * top - before - after
    # A jump is no parabola, and neither is a motion of fewer than six samples a period.
    inside = (at > 0) & (at < len(sizes) - 1)
    smooth = inside & (bend > 0) & (np.minimum(before, after) > STRONG * top)
    rise: Floats = (after - before) ** 2 / (8 * np.where(smooth, bend, 1.0))
    return top + np.where(smooth, rise, 0.0)


SPECTRUM_LINES = 60
"""Frequencies of a response spectrum: twelve an octave over five octaves."""


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
        np.max(np.abs((factor[:, None] * driven_poles(s, floor, step)).real), axis=1)
        for floor in np.ascontiguousarray(acceleration.T)
    ]
    return FloorSpectra(frequencies, damping, np.array(peaks))


def largest_spectra(model: DampedModel, accelerations: Sequence[Floats], step: float) -> FloorSpectra:
    """Compute the response spectra of the floors at 5 % damping, the largest over all runs of accelerations, m/s2.

    Their frequencies are a fifth of the frame's first to three times its last, as the sampling allows.
    """
    first, last = model.modes.frequencies[[0, -1]]
    lines = np.geomspace(first / 5, max(min(3 * last, 0.25 / step), first), SPECTRUM_LINES)
    runs = [floor_spectra(each, step, lines) for each in accelerations]
    return FloorSpectra(lines, runs[0].damping, np.max([run.acceleration for run in runs], axis=0))
