"""Write reports of a closed loop, of a response and of modes, each as one HTML file that contains its figures."""

import base64
import dataclasses
import platform
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cvxshear.backends import Comparison
from cvxshear.fit.identification import compare_backends
from cvxshear.io.formats import read_bytes
from cvxshear.loop import LoopResult
from cvxshear.measurement.declaration import Heading
from cvxshear.records import ModalResult
from cvxshear.report.describe import PAGE_COLUMNS, Sentence, Table, describe
from cvxshear.report.describe.headline import headline, verdict_of
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.util.errors import InputError, printable
from cvxshear.util.quantities import AUTOMATIC, Units, capital
from cvxshear.util.results import as_json
from cvxshear.util.typing import Json
from cvxshear.util.writing import json_text
from cvxshear.version import __version__

PACKAGES = (
    "numpy", "scipy", "qpsolvers", "clarabel", "cvxpy", "osqp", "scs", "highspy", "piqp", "proxsuite", "quadprog",
    "daqp",
)  # fmt: skip
"""Packages that may compute the numbers of a report; the report lists their versions."""


@cache
def environment() -> Environment:
    """Load the templates of the reports."""
    # Every text is escaped in every template: names and priors come from files.
    found = Environment(
        loader=PackageLoader("cvxshear.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["printable"] = printable
    return found


def drawings(*results: Any) -> dict[str, Json]:
    """Draw all figures that apply to these results, by name.

    Parameters
    ----------
    *results : object
        Results of one type; most figures show one result.

    Returns
    -------
    dict of str to dict
        `name`, `title`, `caption`, `alternative` and `section` as in the table of figures; `wide`, the drawing as SVG;
        `narrow`, the drawing for a telephone, or None if the telephone scrolls the wide drawing.
    """
    # Imported here, because a notebook shows tables without matplotlib.
    from cvxshear.report.figures import style  # noqa: PLC0415

    found = {}
    for entry in style.applicable(*results):
        # matplotlib has escaped the texts in a drawing.
        wide, narrow = Markup(style.inline_svg(entry.draw(*results), entry.name)), None
        if entry.narrow:
            with style.for_narrow_page():
                narrow = Markup(style.inline_svg(entry.draw(*results), f"{entry.name}-narrow"))
        words = {"caption": entry.caption_of(*results), "alternative": entry.alternative_of(*results)}
        place = {"name": entry.name, "title": entry.title, "section": entry.section}
        found[entry.name] = {**place, **words, "wide": wide, "narrow": narrow}
    return found


def versions() -> Iterator[tuple[str, str]]:
    """Yield names and versions of the packages that computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue


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
    drawn = drawings(result)
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
        figure=drawn,
        backends=describe(comparison)["worst"],
        left_out=comparison.left_out,
        motion=moving_shapes(result),
        versions=list(versions()),
        command=command,
        experiment_json=json_text(as_json(result.experiment), indent=1),
        result_json=json_text(result.to_dict(), indent=1),
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
    return {"prediction": describe(result), "prediction_json": json_text(result.to_dict(), indent=1), "figure": drawn}


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
        result_json=json_text([result.to_dict() for result in results], indent=1),
        figure=drawings(*results),
    )


def _record(result: ModalResult, place: int) -> Json:
    parts = describe(result)["modes"].parts
    how = next(part.text for part in parts if isinstance(part, Sentence))
    tables: list[Table] = []
    for part in parts:
        if isinstance(part, Table):
            tables += part.folded(PAGE_COLUMNS) if part.key == "identified-shapes" else (part,)
    named = [dataclasses.replace(table, key=f"{table.key}-{place}") for table in tables]
    return {"name": result.name, "how": how, "tables": named, "findings": result.findings}


MOST_MODES = 6
"""Number of modes of a configuration that are animated, from the lowest."""

MovingShape = tuple[str, list[tuple[float, float]]]
"""Label of a mode, and for the ground and each floor the sway (largest value 1) and the height (roof 1)."""


def moving_shapes(result: LoopResult) -> list[tuple[str, list[MovingShape]]]:
    """List the lowest modes of the final model, by configuration."""
    declared = result.experiment.frame.elevations
    z = np.arange(1.0, result.experiment.stories + 1) if declared is None else declared
    heights = (np.concatenate([[0.0], z]) / z[-1]).round(4).tolist()
    return [
        (found.configuration, [
            (f"mode {mode}: {frequency:.4g} Hz", list(zip([0.0, *sway.round(4).tolist()], heights, strict=True)))
            for mode, (frequency, sway) in enumerate(zip(found.frequencies, found.mode_shapes, strict=True), 1)
            if mode <= MOST_MODES
        ])
        for found in result.estimate.predictions
    ]  # fmt: skip
