"""Commands with a record of a frame: predict its response, reconstruct the motion of every floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.before import measured
from cvxshear.cli.options import BackendName, File, JsonOut, Quiet, ReportOut, input_files
from cvxshear.cli.output import as_typed, deliver, doubts_of, names, progress
from cvxshear.cli.written import CsvOut, FiguresOut, Pictures, SeriesOut, Spreadsheets, XlsxOut, handed_over
from cvxshear.util.errors import InputError, NoScaleError
from cvxshear.util.writing import write_file

if TYPE_CHECKING:
    from cvxshear.response.sources import ModelSource
    from cvxshear.screening import FileFinding

DampingKind = Annotated[
    str | None, typer.Option("--damping", help="modal, story or rayleigh; what FILE declares where not given.")
]
StateName = Annotated[
    str | None,
    typer.Option("--configuration", help="Which test or state; the one with the record's added mass where not given."),
]
Assumed = Annotated[
    str | None, typer.Option("--assume", help="Effects that are in the model from the start.", metavar="NAME,...")
]
Detrend = Annotated[bool, typer.Option(help="Take the straight line through each recorded acceleration off.")]


def predict(
    context: typer.Context,
    file: File,
    record: Annotated[str, typer.Option("--record", callback=input_files)],
    backend: BackendName = "auto",
    damping: DampingKind = None,
    configuration: StateName = None,
    assume: Assumed = None,
    detrend: Detrend = True,
    series: SeriesOut = None,
    export: list[str] | None = None,
    figure: FiguresOut = None,
    report: ReportOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Predict how every floor answers to a record, beside what was measured.

    Example: cvxshear predict frame.toml --record earthquake.toml

    Parameters
    ----------
    file
        What the model is made of: a measurement file, a record file, or what 'loop --json' wrote.
    record
        A record file: the base motion or force, and responses to compare with.
    export : OUT
        Write the model here: .npz, .mat, .json or .py (OpenSeesPy); may be repeated.
    """
    from cvxshear.report import terminal
    from cvxshear.report.handover import model_kind, write_model
    from cvxshear.response import RecordPrediction
    from cvxshear.response import predict as run
    from cvxshear.screening import in_json

    written = [*_series_and_page(context, series, report)]
    written += handed_over(context, "--export", export or [], model_kind, write_model)
    pictures = Pictures(figure, RecordPrediction)
    with progress("predicting", quiet):
        source, doubts = screened(file, backend, names(assume) or ())
        result = run(source, record, backend, damping=damping, configuration=configuration, detrend=detrend)
    said = {**result.to_dict(), **in_json(doubts)}
    files: list[Callable[[], None]] = [*pictures.of(result), *(partial(write, result) for write in written)]
    deliver(said, out, lambda: [*doubts_of(doubts), *terminal.shown(result)], *files)


def reconstruct(
    context: typer.Context,
    file: File,
    record: Annotated[str, typer.Option("--record", callback=input_files)],
    backend: BackendName = "auto",
    damping: DampingKind = None,
    configuration: StateName = None,
    assume: Assumed = None,
    detrend: Detrend = True,
    fit: bool = True,
    leave_out: bool = True,
    series: SeriesOut = None,
    figure: FiguresOut = None,
    report: ReportOut = None,
    csv: CsvOut = None,
    xlsx: XlsxOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find how every floor moved, from the floors that carry sensors: drifts, forces, and whether a story changed.

    Example: cvxshear reconstruct frame.toml --record earthquake.toml --report drifts.html

    Parameters
    ----------
    file
        What the model is made of: a measurement file, a record file, or what 'loop --json' wrote.
    record
        A record file: floors that carry sensors, with gaps or not, and the base motion; input = "none" where nobody
        measured that.
    fit
        Fit the frame to the record; otherwise it stays as identified.
    leave_out
        Leave each sensor out in turn and predict it from the others.
    """
    from cvxshear.report import terminal
    from cvxshear.report.handover import sheets_of
    from cvxshear.response import Reconstruction
    from cvxshear.response import reconstruct as run
    from cvxshear.screening import in_json

    written = _series_and_page(context, series, report)
    pictures, tables = Pictures(figure, Reconstruction), Spreadsheets(csv, xlsx)
    with progress("reconstructing", quiet) as advance:
        source, doubts = screened(file, backend, names(assume) or ())
        result = run(
            source, record, backend, damping=damping, configuration=configuration, detrend=detrend, fit=fit,
            leave_out=leave_out, progress=advance,
        )  # fmt: skip
    said = {**result.to_dict(), **in_json(doubts)}
    files: list[Callable[[], None]] = [*pictures.of(result), *(partial(write, result) for write in written)]
    files += tables.of(lambda: sheets_of(result))
    deliver(said, out, lambda: [*doubts_of(doubts), *terminal.shown(result)], *files)


def _series_and_page(context: typer.Context, series: str | None, report: str | None) -> list[Callable[..., None]]:
    """Make the functions that write the requested time series and report of a result."""
    from cvxshear.report.handover import series_kind, write_series

    written = handed_over(context, "--out", [series] if series else [], series_kind, write_series)
    if report is not None:
        from cvxshear.report.html import render_response

        written.append(lambda result: write_file(report, render_response(result, as_typed())))
    return written


def screened(file: str, backend: str, assume: Sequence[str] = ()) -> tuple[ModelSource, Sequence[FileFinding] | None]:
    """Close the loop on a file and return its models and warnings; a result of `loop` is returned without warnings."""
    from cvxshear.response import models_of_loop
    from cvxshear.response.sources import load_unscaled
    from cvxshear.screening import close_loop

    if Path(file).suffix.lower() == ".json":
        if assume:
            raise InputError(f"{file} holds a model that the loop ended with; --assume belongs to 'cvxshear loop'")
        return file, None
    try:
        experiment, found = measured([file])
    except NoScaleError:
        # Only forces need the scale of the masses; the result leaves forces out.
        experiment, found = load_unscaled(file), []
    # A record has no declared mode numbers: the loop compares possible numbers together with the effects.
    weighed = [each.name for each in experiment.configurations if found]
    result = close_loop(experiment, assume=assume, backend=backend, weighed=weighed)
    return models_of_loop(result), result.warnings
