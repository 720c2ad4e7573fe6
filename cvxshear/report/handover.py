"""Write files for other programs: tables as sheets, the frame as matrices or a script, time series as columns."""

import re
from collections.abc import Callable
from importlib import resources
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from scipy import io

from cvxshear.io.spreadsheets import Sheet
from cvxshear.report.describe import describe
from cvxshear.response import Reconstruction, RecordPrediction, Response
from cvxshear.response.damping import DampedModel
from cvxshear.response.predicted import RESPONSES, histories
from cvxshear.response.uncertain import Damped
from cvxshear.util.errors import UnsuitableError, printable
from cvxshear.util.results import as_json
from cvxshear.util.typing import Floats
from cvxshear.util.writing import ending_of, json_text, write_file


def sheets_of(*results: object) -> list[Sheet]:
    """Convert the tables of results to sheets of a spreadsheet program.

    Parameters
    ----------
    *results : object
        Results of a type that `describe` supports.
    """
    sheets = []
    for result in results:
        for each in describe(result).data:
            columns = [(column.spelled(name), values) for column in each.columns for name, values in column.exported]
            rows = list(zip(*(values for _, values in columns), strict=True))
            sheets.append(Sheet(each.key, tuple(header for header, _ in columns), rows))
    return sheets


def write_model(path: str | Path, result: RecordPrediction) -> None:
    """Write the final model of a prediction, in the predicted state.

    Parameters
    ----------
    path : str or Path
        Ending in .npz, .mat or .json: matrices, modes and state-space form by the names of
        `matrices`; .py: a script for OpenSeesPy. A device receives JSON.
    result : RecordPrediction

    Raises
    ------
    InputError
        If the ending is unknown, or the file cannot be written.
    UnsuitableError
        If OpenSees cannot represent the frame.
    """
    write_file(path, MODEL_WRITERS[model_kind(path)](result))


def model_kind(path: str | Path) -> str:
    """Return the kind of file by the ending of its name.

    Raises
    ------
    InputError
        If the ending is unknown.
    """
    return ending_of(path, MODEL_WRITERS, "a model is written as", device="json")


def _npz(arrays: dict[str, Floats]) -> bytes:
    np.savez_compressed(out := BytesIO(), **arrays)  # type: ignore[arg-type]  # numpy takes any names
    return out.getvalue()


def _mat(arrays: dict[str, Floats]) -> bytes:
    io.savemat(out := BytesIO(), arrays, oned_as="column")  # type: ignore[arg-type]  # a stream will do
    return out.getvalue()


MODEL_WRITERS: dict[str, Callable[[RecordPrediction], str | bytes]] = {
    "npz": lambda result: _npz(matrices(result.after.damped)),
    "mat": lambda result: _mat(matrices(result.after.damped)),
    "json": lambda result: json_text(as_json(matrices(result.after.damped)), indent=1),
    "py": lambda result: opensees_script(
        result.after.damped, f"{result.after.fitted.experiment.name}, {result.configuration.name}"
    ),
}
"""Writers of a model by the ending of the file."""


def matrices(damped: Damped) -> dict[str, Floats]:
    """Collect the matrices and modes of a frame for other programs, SI units.

    Returns
    -------
    dict of str to ndarray
        `M`, `C`, `K`, shape (N, N); `frequencies` (Hz), `damping_ratios`, shape (N,); `mode_shapes`, one row a
        mode, mass-normalized; `story_dashpots`, `rayleigh`, `story_heights` if they exist; and the state-space form
        `state_A`, `state_B`, `state_C`, `state_D`:

            x' = A x + B w,   y = C x + D w

        with the displacements against the ground and the velocities in x, the base acceleration and then the force on
        each floor in w, and the total accelerations of the floors in y.
    """
    model = damped.model
    modes, dashpots = model.modes, damped.dashpots
    result = {"M": model.M, "C": model.C, "K": model.K, "frequencies": modes.frequencies}
    result |= {"damping_ratios": model.ratios, "mode_shapes": modes.shapes}
    optional = {
        "story_dashpots": None if dashpots is None else dashpots.values,
        "rayleigh": damped.rayleigh,
        "story_heights": model.heights,
    }
    return result | {key: value for key, value in optional.items() if value is not None} | state_space(model)


def state_space(model: DampedModel) -> dict[str, Floats]:
    """Write the state-space form of `matrices`."""
    n = len(model.M)
    inverse = np.linalg.inv(model.M)
    rows = -inverse @ np.hstack([model.K, model.C])
    none = np.zeros((n, n))
    return {
        "state_A": np.block([[none, np.eye(n)], [rows]]),
        "state_B": np.block([[np.zeros((n, 1)), none], [-np.ones((n, 1)), inverse]]),
        "state_C": rows,
        "state_D": np.hstack([np.zeros((n, 1)), inverse]),
    }


def opensees_script(damped: Damped, title: str) -> str:
    """Write a script that makes the frame in OpenSeesPy, with its damping.

    Any symmetric stiffness matrix belongs to springs -K_ij between floors i and j and springs sum_j K_ij to the ground.

    Parameters
    ----------
    damped : Damped
    title : str

    Raises
    ------
    UnsuitableError
        If the mass matrix is not diagonal: OpenSees has masses at nodes only.
    """
    M = damped.model.M
    if np.any(np.abs(M - np.diag(np.diag(M))) > 1e-12 * np.abs(M).max()):
        raise UnsuitableError(
            "OpenSees has masses at nodes only, and the mass matrix of this frame couples its floors (mass_coupling); "
            "hand it on as .npz, .mat or .json"
        )
    script = resources.files("cvxshear.report").joinpath("templates", "opensees.py.txt").read_text(encoding="utf-8")
    modal = damped.dashpots is None and damped.rayleigh is None
    return script.format(
        title=printable(" ".join(title.split())).replace("\\", "/").replace('"', "'") or "frame",
        masses=np.diag(M).tolist(),
        springs=_links(damped.model.K),
        dashpots=[] if damped.dashpots is None else _links(damped.model.C),
        ratios=damped.model.ratios.tolist() if modal else [],
        rayleigh=[] if damped.rayleigh is None else damped.rayleigh.tolist(),
    )


def _links(matrix: Floats) -> list[tuple[int, int, float]]:
    """List the springs between nodes that give this stiffness matrix; node 0 is the ground."""
    n = len(matrix)
    ground = [(0, i + 1, float(matrix[i].sum())) for i in range(n)]
    between = [(i + 1, j + 1, float(-matrix[i, j])) for i in range(n) for j in range(i + 1, n)]
    # A row sum that only rounding makes different from zero is not a spring to the ground.
    return [link for link in (*ground, *between) if abs(link[2]) > 1e-12 * np.abs(matrix).max()]


COLUMN_NAMES = {name: quantity.word.replace(" ", "_") for name, quantity in RESPONSES.items()}
"""Names of the columns by quantity; the columns of floor or story 1 end in `_1`."""

SERIES_UNITS = {"time": "s"} | {COLUMN_NAMES[name]: each.unit.replace("²", "2") for name, each in RESPONSES.items()}
"""Units of the columns; the header of a CSV file shows them in brackets. A drift ratio has no unit."""

Moved = RecordPrediction | Reconstruction


def _runs(result: Moved) -> list[tuple[Floats, Response, dict[str, Floats]]]:
    """List each run's excitation (m/s2 or N), its response, and the known standard deviations by quantity."""
    if isinstance(result, Reconstruction):
        return [(run.excitation, run.response, run.std) for run in result.runs]
    return [
        (run.excitation, response, {name: band for name, band in std.items() if np.isfinite(band).all()})
        for run, response, std in zip(result.motion.runs, result.after.responses, result.std, strict=True)
    ]


def series(result: Moved) -> dict[str, Floats]:
    """Collect every quantity at every floor or story, one column each.

    Returns
    -------
    dict of str to ndarray, shape (samples,)
        `run` (from 1, several one after the other), `time` (s, from the start of each), `excitation` (m/s2 or N), then
        the applicable columns of `COLUMN_NAMES`, each followed by its known standard deviations (`drift_std_1`).
    """
    runs = []
    for place, (excitation, response, std) in enumerate(_runs(result), 1):
        columns = {"run": np.full(len(excitation), float(place)), "time": response.time, "excitation": excitation}
        for quantity, values in histories(response).items():
            if values is not None:
                columns |= _columns(COLUMN_NAMES[quantity], values)
                if quantity in std:
                    columns |= _columns(f"{COLUMN_NAMES[quantity]}_std", std[quantity])
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
        Ending in .csv, .mat or .npz; a device receives CSV.
    result : RecordPrediction or Reconstruction

    Raises
    ------
    InputError
        If the ending is unknown, or the file cannot be written.
    """
    write_file(path, SERIES_WRITERS[series_kind(path)](result))


def series_kind(path: str | Path) -> str:
    """Return the kind of file by the ending of its name.

    Raises
    ------
    InputError
        If the ending is unknown.
    """
    return ending_of(path, SERIES_WRITERS, "time series are written as")


def _csv(result: Moved) -> bytes:
    columns, out = series(result), StringIO()
    units = SERIES_UNITS | {"excitation": "N" if _driven(result) == "force" else "m/s2"}
    heads = [f"{name} ({unit})" if (unit := units.get(re.sub(r"_std|_\d+", "", name))) else name for name in columns]
    np.savetxt(
        out, np.column_stack(list(columns.values())), delimiter=",", header=",".join(heads), comments="", fmt="%.9g"
    )
    return out.getvalue().encode()


def _driven(result: Moved) -> str:
    return (result.recording if isinstance(result, Reconstruction) else result.motion).input


SERIES_WRITERS: dict[str, Callable[[Moved], bytes]] = {
    "csv": _csv,
    "mat": lambda result: _mat(series(result)),
    "npz": lambda result: _npz(series(result)),
}
"""Writers of time series by the ending of the file."""
