"""Largest values of a response over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.response.model import Response
from cvxshear.util.typing import Floats, Json

QUANTITIES = {
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
        By the names of `QUANTITIES`, those that apply; shape (N,) or (1,); nan where a deviation is not known.
    """

    values: dict[str, Floats]
    std: dict[str, Floats]

    def to_dict(self) -> Json:
        """Each quantity and its `_std`; null where it does not apply."""
        result: Json = {}
        for name in QUANTITIES:
            single = name in ("base_shear", "overturning_moment")
            result[name] = _plain(self.values.get(name), single=single)
            result[f"{name}_std"] = _plain(self.std.get(name), single=single)
        return result


def _plain(values: Floats | None, *, single: bool) -> object:
    if values is None:
        return None
    listed = [None if np.isnan(value) else float(value) for value in values]
    return listed[0] if single else listed
