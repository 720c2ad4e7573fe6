"""The report of a closed loop as one HTML file that stands by itself: no network, figures inside."""

from __future__ import annotations

from pathlib import Path

from cvxshear.backends import Comparison
from cvxshear.loop import Closure
from cvxshear.methods import compare_backends
from cvxshear.util.errors import CvxshearError
from cvxshear.util.quantities import AUTOMATIC, Units
from cvxshear.util.writing import write_file

try:
    from markupsafe import Markup

    from cvxshear.report import figures
    from cvxshear.report.drawings import drawings
    from cvxshear.report.pages import environment
    from cvxshear.report.response_html import (
        prediction_contents,
        write_prediction_report,
        write_reconstruction_report,
    )
except ImportError as error:
    raise CvxshearError(
        f"the report needs {error.name}, which is not installed: pip install jinja2 matplotlib"
    ) from error

from cvxshear.report.contents import contents
from cvxshear.response import RecordPrediction

__all__ = ["render", "write_prediction_report", "write_reconstruction_report", "write_report"]


def write_report(
    result: Closure,
    path: str | Path,
    command: str,
    comparison: Comparison | None = None,
    units: Units = AUTOMATIC,
    prediction: RecordPrediction | None = None,
) -> None:
    """Write the report of a closed loop.

    Parameters
    ----------
    result : Closure
    path : str or Path
        Written in one piece; whatever was there before is replaced.
    command : str
        What makes this report again, as it was typed.
    comparison : Comparison, optional
        Of the backends; made where not given.
    units : Units, optional
        In which quantities are shown.
    prediction : RecordPrediction, optional
        Of a record by the models of the loop; a section of its own.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    write_file(path, render(result, command, comparison, units, prediction))


def render(
    result: Closure,
    command: str,
    comparison: Comparison | None = None,
    units: Units = AUTOMATIC,
    prediction: RecordPrediction | None = None,
) -> str:
    """The report of a closed loop as HTML.

    Parameters
    ----------
    result : Closure
    command : str
    comparison : Comparison, optional
    units : Units, optional
    prediction : RecordPrediction, optional

    Returns
    -------
    str
        One page that refers to nothing outside itself.
    """
    if comparison is None:
        comparison = compare_backends(result.experiment)
    page = environment().get_template("report.html")
    found, drawn = contents(result, comparison, command, units), _figures(result, comparison)
    beside = None if prediction is None else prediction_contents(prediction)
    if beside is not None:
        drawn |= beside["figure"]
    return page.render(**found, figure=drawn, beside=beside)


def _figures(result: Closure, comparison: Comparison) -> dict[str, Markup]:
    """The drawings by name."""
    drawn = {
        "frame": figures.frame(result),
        "shapes": figures.shapes(result),
        "residual": figures.residual(result),
        "backends": figures.backend_differences(comparison),
    }
    if any(each.measured.any() for each in result.experiment.configurations):
        drawn["mac"] = figures.mac(result)
    if result.candidates:
        drawn["ranking"] = figures.ranking(result)
    return drawings(drawn)
