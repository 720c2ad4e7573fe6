"""The report of identified modes as one HTML file that stands by itself: no network, figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cvxshear.modal import ModalResult
from cvxshear.report.describe import Sentence, Table, describe
from cvxshear.report.pages import drawings, environment, readable_json, versions
from cvxshear.util.typing import Json
from cvxshear.util.writing import write_file

MOST_SHAPES = 4
"""Mode shapes beside each other on the page; more go below."""


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
    write_file(path, page.render(**_contents(results, command, failed), figure=drawings(*results)))


def _contents(results: Sequence[ModalResult], command: str, failed: Sequence[str]) -> Json:
    return {
        "title": ", ".join(result.name for result in results),
        "records": [_record(result, place) for place, result in enumerate(results, 1)],
        "failed": list(failed),
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
