"""The report of identified modes as one HTML file that stands by itself: no network, figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from markupsafe import Markup

from cvxshear.modal import ModalResult
from cvxshear.report.contents import readable_json, versions
from cvxshear.report.describe import Sentence, Table, describe
from cvxshear.report.figures import kinds
from cvxshear.report.figures.output import inline_svg
from cvxshear.report.pages import environment
from cvxshear.util.typing import Json
from cvxshear.util.writing import write_file

MOST_SHAPES = 4
"""Mode shapes beside each other on the page; more go below."""

SECTIONS = (
    ("stabilization", "stabilization", "Stabilization diagram"),
    ("functions", "functions", "Measured and synthesized functions"),
    ("coherence", "coherence", "Coherence"),
    ("shapes", "shapes", "Mode shapes"),
    ("mac", "mac", "Modal assurance criterion"),
)
CAPTIONS = {
    "stabilization": "Poles of models of growing order. A pole that comes back from order to order is stable; those of "
    "a mode are what its values are medians of. Behind them stands the mode indicator function, logarithmic.",
    "functions": "What was measured, and what the poles and shapes found make of it, residual terms included. Where "
    "the curves part, a mode is missing or its shape is wrong. Grey lines: the natural frequencies.",
    "coherence": "The share of each response that is due to the input; where no input was measured, what it has in "
    "common with the highest floor. Low values beside a resonance are usual, low values at one are not.",
    "shapes": "Real normal modes, the largest entry 1; bars are one standard deviation.",
    "mac": "The modes against one another: values beside the diagonal that are not small mean that the sensors hardly "
    "tell two modes apart.",
}
ALTERNATIVES = {
    "stabilization": "Poles over model order; the modes are in the table above.",
    "functions": "Measured and synthesized functions over frequency, floor by floor.",
    "coherence": "Coherence over frequency, floor by floor.",
    "shapes": "Mode shapes; the numbers are in the table above.",
    "mac": "Matrix of the modal assurance criterion of every mode with every other.",
}


def write_modal_report(
    results: Sequence[ModalResult], path: str | Path, command: str, failed: Sequence[str] = ()
) -> None:
    """Write the report of the modes of one record or of several.

    Parameters
    ----------
    results : sequence of ModalResult
    path : str or Path
        Written in one piece; whatever was there before is replaced.
    command : str
        What makes this report again, as it was typed.
    failed : sequence of str, optional
        Why other records are not in it.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    page = environment().get_template("modal_report.html")
    write_file(path, page.render(**_contents(results, command, failed), figure=_figures(results)))


def _figures(results: Sequence[ModalResult]) -> dict[str, Markup]:
    """Those figures that every result has the data of."""
    drawn = {}
    for name, draw in kinds.OF_RECORDS.items():
        lacking = {
            "stabilization": any(result.sweep is None for result in results),
            "functions": any(result.functions is None for result in results),
            "coherence": any(result.functions is None or result.functions.coherence is None for result in results),
        }
        if not lacking.get(name, False):
            drawn[name] = Markup(inline_svg(draw(*results), name))
    return drawn


def _contents(results: Sequence[ModalResult], command: str, failed: Sequence[str]) -> Json:
    return {
        "title": ", ".join(result.name for result in results),
        "records": [_record(result, place) for place, result in enumerate(results, 1)],
        "failed": list(failed),
        "sections": SECTIONS,
        "captions": CAPTIONS,
        "alternatives": ALTERNATIVES,
        "command": command,
        "versions": list(versions()),
        "result_json": readable_json([result.to_dict() for result in results]),
    }


def _record(result: ModalResult, place: int) -> Json:
    parts = describe(result)["modes"].parts
    return {
        "name": result.name,
        "how": next(part.text for part in parts if isinstance(part, Sentence)),
        "tables": [
            replace(table, key=f"{table.key}-{place}")
            for part in parts
            if isinstance(part, Table)
            for table in (part.folded(MOST_SHAPES) if part.key == "identified-shapes" else (part,))
        ],
        "findings": [{"kind": finding.kind, "message": finding.message} for finding in result.findings],
    }
