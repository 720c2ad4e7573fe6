"""Time series of a prediction into files: CSV, MAT, NPZ, universal file."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from scipy import io

from cvxshear.response import RecordPrediction
from cvxshear.response.series import series
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Json
from cvxshear.util.writing import ending_of, write_file

TIME, X_TRANSLATION = 1, 1
ACCELERATION, DISPLACEMENT, FORCE = 12, 8, 13
"""Of universal files: the function type, the direction, and the kinds of ordinate."""


def write_series(path: str | Path, result: RecordPrediction) -> None:
    """Write the time series of a prediction.

    Parameters
    ----------
    path : str or Path
        Ending in .csv, .mat, .npz or .uff; a device is written CSV to.
    result : RecordPrediction

    Raises
    ------
    InputError
        Where the ending is another, pyuff is missing for .uff, or the file cannot be written.
    """
    write_file(path, WRITERS[series_kind(path)](result))


def series_kind(path: str | Path) -> str:
    """The kind of file that a name asks for.

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    return ending_of(path, WRITERS, "time series are written as")


def _csv(result: RecordPrediction) -> bytes:
    columns = series(result)
    out = StringIO()
    np.savetxt(
        out, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.9g"
    )
    return out.getvalue().encode()


def _mat(result: RecordPrediction) -> bytes:
    out = BytesIO()
    io.savemat(out, {name: values[:, None] for name, values in series(result).items()})  # type: ignore[arg-type]  # a stream will do
    return out.getvalue()


def _npz(result: RecordPrediction) -> bytes:
    out = BytesIO()
    np.savez_compressed(out, **series(result))  # type: ignore[arg-type]  # numpy takes any names
    return out.getvalue()


def _uff(result: RecordPrediction) -> bytes:
    """Accelerations, displacements and story shears as data sets 58, a node a floor."""
    try:
        pyuff = importlib.import_module("pyuff")
    except ImportError:
        raise InputError("universal files need pyuff: pip install pyuff") from None
    sets: list[Json] = []
    for run, response in enumerate(result.after.responses, 1):
        quantities: list[tuple[str, int, Floats | None]] = [
            ("acceleration", ACCELERATION, response.acceleration),
            ("displacement", DISPLACEMENT, response.displacement),
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
        data=values, x=time, id1=f"{name}, floor {floor}"[:80], rsp_ent_name="floor", ref_ent_name="ground",
        abscissa_spacing=1, abscissa_min=0.0, abscissa_inc=float(time[1] - time[0]), num_pts=len(values),
        ord_data_type=4, abscissa_spec_data_type=17, ordinate_spec_data_type=kind, orddenom_spec_data_type=0,
        z_axis_spec_data_type=0,
    )  # fmt: skip
    return made


WRITERS: dict[str, Callable[[RecordPrediction], bytes]] = {"csv": _csv, "mat": _mat, "npz": _npz, "uff": _uff}
"""By the ending of the file."""
