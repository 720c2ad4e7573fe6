"""Reports of a closed loop, of a response and of modes: one HTML file each that stands by itself, figures inside."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cvxshear.backends import Comparison
from cvxshear.files.inputs import read_bytes
from cvxshear.loop import Closure
from cvxshear.measurement.declaration import Heading
from cvxshear.measurement.experiment import Experiment
from cvxshear.methods import Prediction, compare_backends
from cvxshear.modal import ModalResult
from cvxshear.report.describe import Sentence, Table, describe
from cvxshear.report.describe.closed_loop import open_questions
from cvxshear.report.describe.headline import headline, verdict_of
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.util.errors import CvxshearError, InputError
from cvxshear.util.quantities import AUTOMATIC, Units, capital
from cvxshear.util.results import as_json
from cvxshear.util.typing import Json

try:
    from cvxshear.report import figures  # noqa: F401 - raises here, before the loop is closed, where it is missing
    from cvxshear.report.pages import drawings, environment, readable_json, versions
except ImportError as error:
    raise CvxshearError(
        f"the report needs {error.name}, which is not installed: pip install jinja2 matplotlib"
    ) from error

FIRST_SECTIONS = ("verdict",)
"""Sections of the description that stand on the first screen."""

APPENDIX = ("steps", "effort")
"""Sections that say how the result was computed; they stand in the appendix, with the agreement of the backends."""

PHOTOGRAPHS = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg"}
"""How the files of pictures begin that a page may hold, and what they are called there."""

LARGEST_PHOTOGRAPH = 20_000_000
"""Bytes; a picture of a camera has fewer, and the page holds it whole."""


def render(
    result: Closure,
    command: str,
    comparison: Comparison | None = None,
    units: Units = AUTOMATIC,
    prediction: RecordPrediction | None = None,
    heading: Heading | None = None,
) -> str:
    """Write the report of a closed loop as HTML.

    Parameters
    ----------
    result : Closure
    command : str
        What makes this report again, as it was typed.
    comparison : Comparison, optional
        Of the backends; made where not given.
    units : Units, optional
        In which quantities are shown.
    prediction : RecordPrediction, optional
        Of a record by the models of the loop; a section of its own.
    heading : Heading, optional
        Title, client, author, date and photograph; those of the measurement file where not given.

    Returns
    -------
    str
        One page that refers to nothing outside itself.
    """
    if comparison is None:
        comparison = compare_backends(result.experiment, repeats=1)
    page = environment().get_template("report.html")
    beside = None if prediction is None else _response_contents(prediction)
    drawn = {**drawings(comparison), **drawings(result)}
    if beside is not None:
        drawn |= beside["figure"]
    document = describe(result, units)
    heading = result.experiment.report if heading is None else heading
    return page.render(
        document=document,
        first=[section for section in document.sections if section.key in FIRST_SECTIONS],
        body=[s for s in document.sections if s.parts and s.key not in (*FIRST_SECTIONS, *APPENDIX)],
        appendix=[section for section in document.sections if section.parts and section.key in APPENDIX],
        heading=heading,
        photograph=photograph_of(heading),
        headline=capital(headline(result)),
        verdict=verdict_of(result),
        open_questions=open_questions(result),
        figure=drawn,
        backends=describe(comparison)["worst"],
        left_out=comparison.left_out,
        motion=moving_shapes(result),
        motion_size=(WIDTH, HEIGHT),
        versions=list(versions()),
        command=command,
        experiment_json=readable_json(as_json(result.experiment)),
        result_json=readable_json(result.to_dict()),
        beside=beside,
    )


def photograph_of(heading: Heading) -> str:
    """Encode the photograph as an address that holds it; empty where there is none.

    Raises
    ------
    InputError
        Where it cannot be read, is larger than `LARGEST_PHOTOGRAPH`, or is no PNG or JPEG.
    """
    if heading.photograph is None:
        return ""
    path = Path(heading.photograph)
    content = read_bytes(path, LARGEST_PHOTOGRAPH, "make the picture smaller")
    kind = next((kind for start, kind in PHOTOGRAPHS.items() if content.startswith(start)), None)
    if kind is None:
        raise InputError(f"report: photograph = {str(path)!r} must be a PNG or JPEG file")
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def render_response(result: RecordPrediction | Reconstruction, command: str) -> str:
    """Write the report of a prediction or of a reconstruction as HTML."""
    word = "Reconstructed" if isinstance(result, Reconstruction) else "Predicted"
    page = environment().get_template("prediction_report.html")
    contents = _response_contents(result)
    return page.render(**contents, heading=f"{word} response", command=command, versions=list(versions()))


def _response_contents(result: RecordPrediction | Reconstruction) -> Json:
    """Collect what the templates put on a page of a response, or into the section that a loop's report has of it."""
    drawn = {
        name: dataclasses.replace(each, section=f"predicted-{each.section}") for name, each in drawings(result).items()
    }
    return {"prediction": describe(result), "prediction_json": readable_json(result.to_dict()), "figure": drawn}


MOST_SHAPES = 4
"""Mode shapes beside each other on the page; more go below."""


def render_modes(results: Sequence[ModalResult], command: str, failed: Sequence[str] = ()) -> str:
    """Write the report of the modes of one record or of several as HTML.

    Parameters
    ----------
    results : sequence of ModalResult
    command : str
    failed : sequence of str, optional
        Why other records are not in it.
    """
    page = environment().get_template("modal_report.html")
    return page.render(
        title=", ".join(result.name for result in results),
        records=[_record(result, place) for place, result in enumerate(results, 1)],
        failed=list(failed),
        command=command,
        versions=list(versions()),
        result_json=readable_json([result.to_dict() for result in results]),
        figure=drawings(*results),
    )


def _record(result: ModalResult, place: int) -> Json:
    parts = describe(result)["modes"].parts
    return {
        "name": result.name,
        "how": next(part.text for part in parts if isinstance(part, Sentence)),
        "tables": [
            dataclasses.replace(table, key=f"{table.key}-{place}")
            for part in parts
            if isinstance(part, Table)
            for table in (part.folded(MOST_SHAPES) if part.key == "identified-shapes" else (part,))
        ],
        "findings": result.findings,
    }


# Mode shapes as drawings that a small script of the page can set in motion.

WIDTH, HEIGHT = 120.0, 170.0
"""Of one drawing, in its own units."""

MARGIN = 12.0
"""Free room around the frame of a drawing."""
HALF = 15.0
"""Half the width of the drawn frame."""

SWAY = 34.0
"""Of the largest entry of a shape."""

MOST_MODES = 6
"""Modes of a configuration that are drawn, from the lowest."""


@dataclass(frozen=True)
class MovingShape:
    """One mode of one configuration.

    Parameters
    ----------
    label : str
    sway : tuple of float
        From the ground up, largest 1 in size.
    heights : tuple of float
        Of the ground and the floors in the drawing, from its top.
    left, right : str
        Points of the columns at full sway, as a polyline has them.
    floors : tuple of (float, float, float)
        Both ends and the height of each floor at full sway.
    """

    label: str
    sway: tuple[float, ...]
    heights: tuple[float, ...]
    left: str
    right: str
    floors: tuple[tuple[float, float, float], ...]


def moving_shapes(result: Closure) -> list[tuple[str, list[MovingShape]]]:
    """List the lowest modes of the final model, by configuration."""
    shown = range(min(result.experiment.stories, MOST_MODES))
    return [
        (each.configuration, [_moving(result.experiment, each, mode) for mode in shown])
        for each in result.estimate.predictions
    ]


def _moving(experiment: Experiment, prediction: Prediction, mode: int) -> MovingShape:
    declared = experiment.frame.elevations
    z = np.arange(1.0, experiment.stories + 1) if declared is None else declared
    heights = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * np.concatenate([[0.0], z]) / z[-1]
    sway = np.concatenate([[0.0], prediction.mode_shapes[mode]])
    centre = WIDTH / 2 + SWAY * sway
    return MovingShape(
        f"mode {mode + 1}: {prediction.frequencies[mode]:.4g} Hz",
        tuple(round(float(value), 4) for value in sway),
        tuple(round(float(value), 2) for value in heights),
        _points(centre - HALF, heights),
        _points(centre + HALF, heights),
        tuple(
            (round(float(x - HALF), 2), round(float(x + HALF), 2), round(float(y), 2))
            for x, y in zip(centre[1:], heights[1:], strict=True)
        ),
    )


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x, y, strict=True))
