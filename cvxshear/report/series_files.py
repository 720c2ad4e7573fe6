"""Time series of a prediction or a reconstruction into files: CSV, MAT, NPZ, universal file."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from scipy import io

from cvxshear.response import Reconstruction, RecordPrediction, Response
from cvxshear.response.peaks import histories
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Json
from cvxshear.util.writing import ending_of, write_file

TIME, X_TRANSLATION = 1, 1
ACCELERATION, DISPLACEMENT, FORCE = 12, 8, 13
"""Of universal files: the function type, the direction, and the kinds of ordinate."""


COLUMN_NAMES = {
    "floor_acceleration": "acceleration", "floor_displacement": "displacement", "story_drift": "drift",
    "story_drift_ratio": "drift_ratio", "story_shear": "shear", "base_shear": "base_shear",
    "overturning_moment": "overturning_moment",
}  # fmt: skip
"""Of the columns; those of floor or story 1 end in `_1`."""

Moved = RecordPrediction | Reconstruction


@dataclass(frozen=True, eq=False)
class _Run:
    """One run's motion: excitation (m/s2 or N), response, and the deviations that are known, by quantity."""

    excitation: Floats
    response: Response
    std: dict[str, Floats]


def _runs(result: Moved) -> list[_Run]:
    if isinstance(result, Reconstruction):
        return [_Run(run.excitation if run.base is None else run.base, run.response, run.std) for run in result.runs]
    return [
        _Run(drive.excitation, response, {name: band for name, band in std.items() if np.isfinite(band).all()})
        for drive, response, std in zip(result.motion.drives, result.after.responses, result.std, strict=True)
    ]


def series(result: Moved) -> dict[str, Floats]:
    """Every quantity at every floor or story, a column each.

    Returns
    -------
    dict of str to ndarray, shape (samples,)
        `run` (from 1, several one after the other), `time` (s, from the start of each), `excitation` (m/s2 or N), then
        those of `COLUMN_NAMES` that apply, each followed by its standard deviations (`drift_std_1`) where known.
    """
    runs = []
    for place, run in enumerate(_runs(result), 1):
        columns = {
            "run": np.full(len(run.excitation), float(place)), "time": run.response.time, "excitation": run.excitation
        }  # fmt: skip
        for quantity, values in histories(run.response).items():
            if values is not None:
                columns |= _columns(COLUMN_NAMES[quantity], values)
                if quantity in run.std:
                    columns |= _columns(f"{COLUMN_NAMES[quantity]}_std", run.std[quantity])
        runs.append(columns)
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _columns(name: str, values: Floats) -> dict[str, Floats]:
    if values.ndim == 1:
        return {name: values}
    return {f"{name}_{place + 1}": values[:, place] for place in range(values.shape[1])}


def write_series(path: str | Path, result: Moved) -> None:
    """Write the time series of a prediction or a reconstruction.

    Parameters
    ----------
    path : str or Path
        Ending in .csv, .mat, .npz or .uff; a device is written CSV to.
    result : RecordPrediction or Reconstruction

    Raises
    ------
    InputError
        Where the ending is another, pyuff is missing for .uff, or the file cannot be written.
    """
    write_file(path, SERIES_WRITERS[series_kind(path)](result))


def series_kind(path: str | Path) -> str:
    """Tell the kind of file that a name asks for.

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    return ending_of(path, SERIES_WRITERS, "time series are written as")


def _csv(result: Moved) -> bytes:
    columns = series(result)
    out = StringIO()
    np.savetxt(
        out, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.9g"
    )
    return out.getvalue().encode()


def _mat(result: Moved) -> bytes:
    out = BytesIO()
    io.savemat(out, {name: values[:, None] for name, values in series(result).items()})  # type: ignore[arg-type]  # a stream will do
    return out.getvalue()


def _npz(result: Moved) -> bytes:
    out = BytesIO()
    np.savez_compressed(out, **series(result))  # type: ignore[arg-type]  # numpy takes any names
    return out.getvalue()


def _uff(result: Moved) -> bytes:
    """Excitation, accelerations, displacements, drifts and story shears as data sets 58, a node a floor."""
    try:
        pyuff = importlib.import_module("pyuff")
    except ImportError:
        raise InputError("universal files need pyuff: pip install pyuff") from None
    sets: list[Json] = []
    forced = (result.recording if isinstance(result, Reconstruction) else result.motion).input == "force"
    for run, moved in enumerate(_runs(result), 1):
        response = moved.response
        driven = "force" if forced else "base acceleration"
        kind = FORCE if forced else ACCELERATION
        sets.append(_function(pyuff, f"{driven}, run {run}", kind, 0, response.time, moved.excitation))
        quantities: list[tuple[str, int, Floats | None]] = [
            ("acceleration", ACCELERATION, response.acceleration),
            ("displacement", DISPLACEMENT, response.displacement),
            ("drift", DISPLACEMENT, response.drift),
            ("story shear", FORCE, response.story_shear),
        ]
        for name, kind, values in quantities:
            if values is not None:
                sets += [
                    _function(pyuff, f"{name}, run {run}", kind, floor, response.time, values[:, floor - 1])
                    for floor in range(1, values.shape[1] + 1)
                ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "series.uff"
        file = pyuff.UFF(str(path))
        for item in sets:
            file.write_sets(item, mode="add")
        return path.read_bytes()


def _function(pyuff: object, name: str, kind: int, floor: int, time: Floats, values: Floats) -> Json:
    made: Json = pyuff.prepare_58(  # type: ignore[attr-defined]  # pyuff has no types
        binary=0, func_type=TIME, rsp_node=floor, rsp_dir=X_TRANSLATION, ref_node=0, ref_dir=X_TRANSLATION,
        data=values, x=time, id1=(f"{name}, floor {floor}" if floor else name)[:80], rsp_ent_name="floor",
        ref_ent_name="ground",
        abscissa_spacing=1, abscissa_min=0.0, abscissa_inc=float(time[1] - time[0]), num_pts=len(values),
        ord_data_type=4, abscissa_spec_data_type=17, ordinate_spec_data_type=kind, orddenom_spec_data_type=0,
        z_axis_spec_data_type=0,
    )  # fmt: skip
    return made


SERIES_WRITERS: dict[str, Callable[[Moved], bytes]] = {"csv": _csv, "mat": _mat, "npz": _npz, "uff": _uff}
"""By the ending of the file."""
