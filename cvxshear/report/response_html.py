"""A predicted or reconstructed response as a page of its own; a prediction also as a part of the loop's report."""

from __future__ import annotations

from pathlib import Path

from cvxshear.report import figures
from cvxshear.report.contents import readable_json, versions
from cvxshear.report.describe import describe
from cvxshear.report.drawings import drawings
from cvxshear.report.pages import environment
from cvxshear.response import Reconstruction, RecordPrediction
from cvxshear.util.typing import Json
from cvxshear.util.writing import write_file

CAPTIONS = {
    "history": (
        "Accelerations of the floors over time, predicted and measured.",
        "Total accelerations of the floors around the strongest motion: predicted (dashed), with the band that holds "
        "95\N{NO-BREAK SPACE}% by the deviations of masses, stiffnesses, effects and damping, and, where the record "
        "has them, measured.",
    ),
    "transfer": (
        "Sizes of the transfer functions from the excitation to the floors: measured, before and after.",
        "Size of each floor's transfer function: measured, of the shear model (before), and of the model with what the "
        "loop found (after). All go through the same estimate.",
    ),
    "peaks": (
        "Peaks over the height; the numbers are in the table above.",
        "Peaks over the height with error bars that hold 95\N{NO-BREAK SPACE}%; circles are measured.",
    ),
    "spectra": (
        "Response spectra of the floors.",
        "Peak acceleration of an oscillator on each floor: what equipment there is shaken by.",
    ),
}
"""For each figure what it is to whoever cannot see it, and what stands below it."""

ONE_MODEL = {
    "transfer": (
        "Sizes of the transfer functions from the excitation to the floors: measured and predicted.",
        "Size of each floor's transfer function, measured and predicted. Both go through the same estimate.",
    ),
}
"""The same where nothing was added to the shear model, so that before and after are one."""


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


RECONSTRUCTED = {
    "drifts": (
        "The frame with the peak drift of each story; the numbers are in the table below.",
        "Left: the frame, each story coloured by its peak drift, with its standard deviation; * marks a story that "
        "changed, triangles the floors with sensors. Right: the same with bars that hold 95\N{NO-BREAK SPACE}%, the "
        "prediction that looks at no sensor, and the limits.",
    ),
    "drift_histories": (
        "Drifts of the stories over time.",
        "Drifts around the strongest motion, with the band that holds 95\N{NO-BREAK SPACE}%.",
    ),
}
"""As `CAPTIONS`, of a reconstruction."""


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
    drawn = {"drifts": figures.story_drifts(result), "drift_histories": figures.reconstructed_histories(result)}
    text = page.render(
        heading="Reconstructed response",
        prediction=describe(result),
        prediction_json=readable_json(result.to_dict()),
        captions=RECONSTRUCTED,
        figures_of={"motion": ("drifts",), "frame": ("drift_histories",)},
        figure=drawings(drawn),
        command=command,
        versions=list(versions()),
    )
    write_file(path, text)


def prediction_contents(result: RecordPrediction) -> Json:
    """What the templates put on a page of a prediction.

    Parameters
    ----------
    result : RecordPrediction
    """
    drawn = {
        "history": figures.response_histories(result),
        "peaks": figures.response_peaks(result),
        "spectra": figures.floor_spectra(result),
    }
    figures_of: dict[str, tuple[str, ...]] = {"peaks": ("history", "peaks", "spectra")}
    if result.after.comparison is not None:
        drawn["transfer"] = figures.transfer_functions(result)
        figures_of = {"errors": ("history", "transfer"), "peaks": ("peaks", "spectra")}
    return {
        "prediction": describe(result),
        "prediction_json": readable_json(result.to_dict()),
        "captions": CAPTIONS | (ONE_MODEL if result.otherwise_before is None else {}),
        "figures_of": figures_of,
        "figure": drawings(drawn),
    }
