"""A prediction's time series as named columns."""

from __future__ import annotations

import numpy as np

from cvxshear.response.peaks import histories
from cvxshear.response.prediction import RecordPrediction
from cvxshear.util.typing import Floats

NAMES = {
    "floor_acceleration": "acceleration",
    "floor_displacement": "displacement",
    "story_drift": "drift",
    "story_drift_ratio": "drift_ratio",
    "story_shear": "shear",
    "base_shear": "base_shear",
    "overturning_moment": "overturning_moment",
}
"""Of the columns; those of floor or story 1 end in `_1`."""


def series(result: RecordPrediction) -> dict[str, Floats]:
    """Every quantity of the final model at every floor or story, a column each.

    Returns
    -------
    dict of str to ndarray, shape (samples,)
        `run` (from 1, several one after the other), `time` (s, from the start of each), `excitation` (m/s2 or N), then
        those of `NAMES` that apply, the accelerations with their standard deviations.
    """
    runs = []
    for place, (drive, response, band) in enumerate(
        zip(result.motion.drives, result.after.responses, result.acceleration_std, strict=True), 1
    ):
        columns = {
            "run": np.full(drive.samples, float(place)),
            "time": response.time,
            "excitation": drive.excitation,
        }
        for quantity, values in histories(response).items():
            if values is not None:
                columns |= _columns(NAMES[quantity], values)
            if quantity == "floor_acceleration" and np.isfinite(band).all():
                columns |= _columns("acceleration_std", band)
        runs.append(columns)
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _columns(name: str, values: Floats) -> dict[str, Floats]:
    if values.ndim == 1:
        return {name: values}
    return {f"{name}_{place + 1}": values[:, place] for place in range(values.shape[1])}
