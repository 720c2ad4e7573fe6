"""Write reports of a closed loop, of a response and of modes, each as one HTML file that contains its figures."""

import base64
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear.backends import Comparison
from cvxshear.fit.identification import compare_backends
from cvxshear.io.formats import read_bytes
from cvxshear.loop import LoopResult
from cvxshear.measurement.declaration import Heading
from cvxshear.records import ModalResult
from cvxshear.report.describe import Sentence, Table, describe
from cvxshear.report.describe.closed_loop import open_questions
from cvxshear.report.describe.headline import headline, verdict_of
from cvxshear.report.figures.drawn_frame import elevations
from cvxshear.report.pages import drawings, environment, readable_json, versions
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import AUTOMATIC, Units, capital
from cvxshear.util.results import as_json
from cvxshear.util.typing import Json

PHOTOGRAPHS = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg"}
"""First bytes of the allowed picture files, and the name of each file type in a page."""

LARGEST_PHOTOGRAPH = 20_000_000
"""Largest size of a photograph in bytes. Camera pictures are smaller, and the page contains the whole file."""


def render(
    result: LoopResult,
    command: str,
    comparison: Comparison | None = None,
    units: Units = AUTOMATIC,
    prediction: RecordPrediction | None = None,
    heading: Heading | None = None,
) -> str:
    """Write the report of a closed loop as HTML.

    Parameters
    ----------
    result : LoopResult
    command : str
        Command line that writes this report.
    comparison : Comparison, optional
        Comparison of the backends. Default: a new comparison.
    units : Units, optional
        Units of the quantities.
    prediction : RecordPrediction, optional
        Prediction of a record by the models of the loop, for a separate section.
    heading : Heading, optional
        Title, client, author, date and photograph; by default from the measurement file.

    Returns
    -------
    str
        One page without references to other files.
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
        heading=heading,
        photograph=photograph_of(heading),
        headline=capital(headline(result)),
        verdict=verdict_of(result),
        open_questions=open_questions(result),
        figure=drawn,
        backends=describe(comparison)["worst"],
        left_out=comparison.left_out,
        motion=moving_shapes(result),
        versions=list(versions()),
        command=command,
        experiment_json=readable_json(as_json(result.experiment)),
        result_json=readable_json(result.to_dict()),
        beside=beside,
    )


def photograph_of(heading: Heading) -> str:
    """Encode the photograph as a data URL; empty without a photograph.

    Raises
    ------
    InputError
        If the file cannot be read, is larger than `LARGEST_PHOTOGRAPH`, or is neither PNG nor JPEG.
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
    """Collect the values that the templates need for a page or a section about a response."""
    drawn = {name: {**each, "section": f"predicted-{each['section']}"} for name, each in drawings(result).items()}
    return {"prediction": describe(result), "prediction_json": readable_json(result.to_dict()), "figure": drawn}


MOST_SHAPES = 4
"""Number of mode shapes in one row of the page; the next rows show more."""


def render_modes(results: Sequence[ModalResult], command: str, failed: Sequence[str] = ()) -> str:
    """Write the report of the modes of one record or of several as HTML.

    Parameters
    ----------
    results : sequence of ModalResult
    command : str
    failed : sequence of str, optional
        Reasons why other records are missing.
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
    how = next(part.text for part in parts if isinstance(part, Sentence))
    tables: list[Table] = []
    for part in parts:
        if isinstance(part, Table):
            tables += part.folded(MOST_SHAPES) if part.key == "identified-shapes" else (part,)
    named = [dataclasses.replace(table, key=f"{table.key}-{place}") for table in tables]
    return {"name": result.name, "how": how, "tables": named, "findings": result.findings}


MOST_MODES = 6
"""Number of modes of a configuration that are animated, from the lowest."""

ROOF_HEIGHT, GROUND_HEIGHT = 12.0, 158.0
"""Vertical positions of the roof and the ground in the drawing of a mode, from its top, as in the template."""

MovingShape = tuple[str, list[tuple[float, float]]]
"""Label of a mode, and for the ground and each floor the sway (largest value 1) and the height in the drawing."""


def moving_shapes(result: LoopResult) -> list[tuple[str, list[MovingShape]]]:
    """List the lowest modes of the final model, by configuration."""
    z, _ = elevations(result.experiment)
    heights = (GROUND_HEIGHT - (GROUND_HEIGHT - ROOF_HEIGHT) * np.concatenate([[0.0], z]) / z[-1]).round(2).tolist()
    return [
        (found.configuration, [
            (f"mode {mode}: {frequency:.4g} Hz", list(zip([0.0, *sway.round(4).tolist()], heights, strict=True)))
            for mode, (frequency, sway) in enumerate(zip(found.frequencies, found.mode_shapes, strict=True), 1)
            if mode <= MOST_MODES
        ])
        for found in result.estimate.predictions
    ]  # fmt: skip
