"""Quantities of a response over time, and their peaks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from cvxshear.response.state_space import Response
from cvxshear.util import ranking
from cvxshear.util.results import as_json
from cvxshear.util.typing import Floats, Ints, Json


@dataclass(frozen=True)
class Quantity:
    """A quantity of a response.

    Parameters
    ----------
    attribute : str
        Attribute of `Response` with the values over time.
    word, unit : str
        Name and unit; the unit of a ratio is empty.
    single : bool, optional
        Whether the quantity is one number, not one per floor or story.
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
    """Return every quantity over time, shapes (samples, N) or (samples,); None for quantities that do not apply."""
    return {name: getattr(response, quantity.attribute) for name, quantity in RESPONSES.items()}


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks with standard deviations.

    Parameters
    ----------
    values, std : dict of str to ndarray
        Keys are the names in `RESPONSES` that apply; shape (N,) or (1,); nan for unknown deviations.
    """

    values: dict[str, Floats]
    std: dict[str, Floats]

    def to_dict(self) -> Json:
        """Return each quantity and its `_std` as JSON; null for quantities that do not apply."""
        result: Json = {}
        for name, quantity in RESPONSES.items():
            for key, values in ((name, self.values.get(name)), (f"{name}_std", self.std.get(name))):
                result[key] = as_json(values[0] if quantity.single and values is not None else values)
        return result


STRONG = 0.5
"""Least size of a sample in the strong part of a motion, relative to the peak."""


def peaks_of(runs: Iterable[tuple[Response, Mapping[str, Floats]]]) -> Peaks:
    """Find the peak of each quantity that applies, and its standard deviation.

    A peak is the top of the parabola through the largest sample and its neighbors. For a motion of 3 Hz at 50 Hz, the
    largest sample is up to 1.8 % too small, the parabola 0.05 %.

    The deviation of a peak is the deviation of its sample. Its ratio to the peak is at least the ratio of the rms
    deviation to the rms motion in the strong part. The reason: the change along one direction of the frame's
    uncertainty oscillates as the motion does. If this change is zero at the peak, the deviation of that sample lacks
    terms of second order and the errors of the model.

    Parameters
    ----------
    runs : iterable of (Response, dict of str to ndarray)
        Response and known standard deviations over time of each run, by the names in `RESPONSES`.
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
    # A parabola fits neither a jump nor a motion with fewer than six samples per period.
    inside = (at > 0) & (at < len(sizes) - 1)
    smooth = inside & (bend > 0) & (np.minimum(before, after) > STRONG * top)
    rise: Floats = (after - before) ** 2 / (8 * np.where(smooth, bend, 1.0))
    return top + np.where(smooth, rise, 0.0)
