"""An identified frame into files for other programs: NPZ, MAT, JSON, an OpenSeesPy script, a spreadsheet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import resources
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy import io

from cvxshear.data import Deviation
from cvxshear.files.spreadsheets import Cell, Sheet, workbook
from cvxshear.fit.misfit import Misfit
from cvxshear.report.describe.consequences import MODELS
from cvxshear.response import Fitted, RecordPrediction
from cvxshear.response.damped import DampedModel
from cvxshear.response.uncertain import Damped
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.results import as_json
from cvxshear.util.text import json_text, printable
from cvxshear.util.typing import Floats
from cvxshear.util.writing import ending_of, write_file


def write_model(path: str | Path, result: RecordPrediction) -> None:
    """Write the final model of a prediction, in the state that was predicted.

    Parameters
    ----------
    path : str or Path
        Ending in .npz, .mat or .json: matrices, modes and state-space form by the names of
        `matrices`; .py: a script for OpenSeesPy; .xlsx: masses, stiffnesses, their standard
        deviations, effects and residuals. A device is written JSON to.
    result : RecordPrediction

    Raises
    ------
    InputError
        Where the ending is another, openpyxl is missing for .xlsx, or the file cannot be written.
    UnsuitableError
        Where OpenSees cannot have such a frame.
    """
    write_file(path, MODEL_WRITERS[model_kind(path)](result))


def model_kind(path: str | Path) -> str:
    """Tell the kind of file that a name asks for.

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    return ending_of(path, MODEL_WRITERS, "a model is written as", device="json")


def _npz(result: RecordPrediction) -> bytes:
    np.savez(out := BytesIO(), **matrices(result.after.damped))  # type: ignore[arg-type]  # numpy takes any names
    return out.getvalue()


def _mat(result: RecordPrediction) -> bytes:
    io.savemat(out := BytesIO(), matrices(result.after.damped), oned_as="column")  # type: ignore[arg-type]  # a stream will do
    return out.getvalue()


def _sheets(result: RecordPrediction) -> Iterator[Sheet]:
    fitted = result.after.fitted
    n = fitted.experiment.stories
    std = _std(fitted)
    unknown = np.full(n, np.nan)
    dashpots = (result.damping.story_dashpot, result.damping.story_dashpot_std)
    columns = [each[at : at + n] for at in (0, n) for each in (fitted.theta, std)]
    columns += [unknown if each is None else each for each in dashpots]
    header = ("floor / story", "mass, kg", "std", "stiffness, N/m", "std", "dashpot, N s/m", "std")
    rows = [(place, *row) for place, row in enumerate(np.column_stack(columns).tolist(), 1)]
    yield Sheet("frame", header, rows)
    yield _effects(fitted, std)
    yield _modes(result)
    yield _residuals(result)


def _std(fitted: Fitted) -> Floats:
    """Return the standard deviations of all parameters; nan where unknown or open."""
    if fitted.covariance is None:
        return np.full(len(fitted.theta), np.nan)
    return np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))


def _effects(fitted: Fitted, std: Floats) -> Sheet:
    n = 2 * fitted.experiment.stories
    named = [(placed.label, each.name, each.unit) for placed in fitted.effects for each in placed.effect.parameters]
    values = zip(fitted.theta[n:].tolist(), std[n:].tolist(), strict=False)
    rows: list[tuple[Cell, ...]] = [(*words, *numbers) for words, numbers in zip(named, values, strict=False)]
    return Sheet("effects", ("effect", "parameter", "unit", "value", "std"), rows)


def _modes(result: RecordPrediction) -> Sheet:
    model = result.after.damped.model
    n = len(model.M)
    header = ("mode", "frequency, Hz", "damping ratio", "std", *(f"shape at floor {i + 1}" for i in range(n)))
    damping = result.damping
    table = np.column_stack([model.modes.frequencies, damping.ratios, damping.ratios_std, model.modes.shapes])
    rows = [(mode, *row) for mode, row in enumerate(table[:n].tolist(), 1)]
    return Sheet("modes", header, rows)


def _residuals(result: RecordPrediction) -> Sheet:
    """Tabulate the error of each part of the measurement, relative and in standard deviations, for each model."""
    sides = [side.fitted for side in (result.before, result.after) if side is not None]
    words = MODELS if len(sides) == len(MODELS) else MODELS[bool(result.after.fitted.effects) :][:1]
    measures = ["relative error", "standard deviations off"]
    header = ("configuration", "part", "quantity", *(f"{measure}, {word}" for measure in measures for word in words))
    rows: list[tuple[Cell, ...]] = []
    for parts in zip(*(_parts(each) for each in sides), strict=True):
        what = parts[0].noise.replace("_", " ")
        numbers = [*(part.error for part in parts), *(part.deviations for part in parts)]
        rows.append((parts[0].configuration, parts[0].place, what, *numbers))
    return Sheet("residuals", header, rows)


def _parts(fitted: Fitted) -> list[Deviation]:
    """Describe what a fit leaves of each part of every datum."""
    misfit = Misfit(fitted.experiment, fitted.effects)
    models = {id(model.state.tested): model for model in misfit.evaluate(fitted.theta, derivatives=False).models}
    return [part for datum in misfit.data for part in datum.describe(models[id(datum.tested)])]


MODEL_WRITERS: dict[str, Callable[[RecordPrediction], str | bytes]] = {
    "npz": _npz,
    "mat": _mat,
    "json": lambda result: json_text(as_json(matrices(result.after.damped)), indent=1),
    "py": lambda result: opensees_script(
        result.after.damped, f"{result.after.fitted.experiment.name}, {result.configuration.name}"
    ),
    "xlsx": lambda result: workbook(_sheets(result)),
}
"""By the ending of the file."""


def matrices(damped: Damped) -> dict[str, Floats]:
    """Everything that another program needs of a frame, SI units.

    Returns
    -------
    dict of str to ndarray
        `M`, `C`, `K`, shape (N, N); `frequencies` (Hz), `damping_ratios`, shape (N,); `mode_shapes`, one row a
        mode, mass-normalized; `story_dashpots`, `rayleigh`, `story_heights` where there are such; and the state-space
        form `state_A`, `state_B`, `state_C`, `state_D`, of

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

    Any symmetric stiffness matrix is that of springs -K_ij between floors i and j and of sum_j K_ij to the ground.

    Parameters
    ----------
    damped : Damped
    title : str

    Raises
    ------
    UnsuitableError
        Where the mass matrix is not diagonal: nodes have masses of their own only.
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
    """Links between nodes, the ground being 0, whose matrix this is."""
    n = len(matrix)
    ground = [(0, i + 1, float(matrix[i].sum())) for i in range(n)]
    between = [(i + 1, j + 1, float(-matrix[i, j])) for i in range(n) for j in range(i + 1, n)]
    # Rounding of the row sums is no spring to the ground.
    return [link for link in (*ground, *between) if abs(link[2]) > 1e-12 * np.abs(matrix).max()]
