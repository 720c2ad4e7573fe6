"""`cvxshear reconstruct`: the motion of every floor from the floors that carry sensors."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated

import typer

from cvxshear.cli.checked import claim, input_files
from cvxshear.cli.output import BackendName, JsonOut, Quiet, ReportOut, deliver, names, progress, typed
from cvxshear.cli.predict import screened
from cvxshear.cli.spreadsheets import CsvOut, Spreadsheets, XlsxOut
from cvxshear.util.text import shell_line


def reconstruct(
    context: typer.Context,
    file: Annotated[
        str,
        typer.Argument(
            help="What the model is made of: a measurement file, a record file, or what 'loop --json' wrote.",
            metavar="FILE",
            callback=input_files,
        ),
    ],
    record: Annotated[
        str,
        typer.Option(
            "--record",
            help='A record file: floors that carry sensors, with gaps or not, and the base motion; input = "none" '
            "where nobody measured that.",
            callback=input_files,
        ),
    ],
    backend: BackendName = "auto",
    damping: Annotated[
        str | None, typer.Option(help="modal, story or rayleigh; what FILE declares where not given.")
    ] = None,
    configuration: Annotated[
        str | None, typer.Option(help="Which tested state; that of the record where not given.")
    ] = None,
    assume: Annotated[
        str | None, typer.Option(help="Effects that are in the model from the start.", metavar="NAME,...")
    ] = None,
    detrend: Annotated[
        bool, typer.Option(help="Take the straight line through each recorded acceleration off.")
    ] = True,
    fit: Annotated[bool, typer.Option(help="Fit the frame to the record; otherwise it stays as identified.")] = True,
    check: Annotated[bool, typer.Option(help="Predict each sensor from the others.")] = True,
    series: Annotated[
        str | None, typer.Option("--out", help="Write the time series here: .csv, .mat, .npz or .uff.", metavar="OUT")
    ] = None,
    report: ReportOut = None,
    csv: CsvOut = None,
    xlsx: XlsxOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find how every floor moved, from the floors that carry sensors: drifts, forces, and whether a story changed.

    Example: cvxshear reconstruct frame.toml --record earthquake.toml --report drifts.html
    """
    from cvxshear.report import terminal
    from cvxshear.report.series_files import WRITERS, series_kind, write_series
    from cvxshear.report.sheets import sheets_of_response
    from cvxshear.response import reconstruct as run
    from cvxshear.screening import in_json

    if series is not None:
        series_kind(series)
        claim(context, "--out", series, [f".{kind}" for kind in WRITERS])
    tables = Spreadsheets(csv, xlsx)
    pages: list[Callable[[], None]] = []
    if report is not None:
        from cvxshear.report.html import write_reconstruction_report

        pages.append(lambda: write_reconstruction_report(result, report, shell_line(["cvxshear", *typed])))
    with progress("reconstructing", quiet) as advance:
        source, doubts = screened(file, backend, names(assume) or ())
        result = run(
            source, record, backend, damping=damping, configuration=configuration, detrend=detrend, fit=fit,
            leave_out=check, progress=advance,
        )  # fmt: skip
    said = {**result.to_dict(), **in_json(doubts)}
    files = [*pages, *tables.of(lambda: sheets_of_response(said))]
    if series is not None:
        files.append(partial(write_series, series, result))
    deliver(said, out, lambda: [*terminal.doubts(doubts or ()), *terminal.shown(result)], *files)
