"""A predicted or reconstructed response as a page of its own; a prediction also as a part of the loop's report."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from cvxshear.report.describe import describe
from cvxshear.report.pages import drawings, environment, readable_json, versions
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.util.typing import Json
from cvxshear.util.writing import write_file


def write_prediction_report(result: RecordPrediction, path: str | Path, command: str) -> None:
    """Write the report of a prediction, one HTML file that refers to nothing outside itself.

    Parameters
    ----------
    result : RecordPrediction
    path : str or Path
        Written in one piece; whatever was there before is replaced.
    command : str
        What makes this report again, as it was typed.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    write_file(path, render_prediction(result, command))


def render_prediction(result: RecordPrediction, command: str) -> str:
    """The report of a prediction as HTML.

    Parameters
    ----------
    result : RecordPrediction
    command : str
    """
    page = environment().get_template("prediction_report.html")
    return page.render(
        **prediction_contents(result), heading="Predicted response", command=command, versions=list(versions())
    )


def write_reconstruction_report(result: Reconstruction, path: str | Path, command: str) -> None:
    """Write the report of a reconstruction, one HTML file that refers to nothing outside itself.

    Parameters
    ----------
    result : Reconstruction
    path : str or Path
        Written in one piece; whatever was there before is replaced.
    command : str
        What makes this report again, as it was typed.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    page = environment().get_template("prediction_report.html")
    text = page.render(
        **prediction_contents(result), heading="Reconstructed response", command=command, versions=list(versions())
    )
    write_file(path, text)


def prediction_contents(result: RecordPrediction | Reconstruction) -> Json:
    """What the templates put on a page of a prediction or a reconstruction.

    Parameters
    ----------
    result : RecordPrediction or Reconstruction
    """
    drawn = {
        name: dataclasses.replace(each, section=f"predicted-{each.section}") for name, each in drawings(result).items()
    }
    return {
        "prediction": describe(result),
        "prediction_json": readable_json(result.to_dict()),
        "figure": drawn,
    }
