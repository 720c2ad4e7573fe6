"""The command that predicts the response of a frame to a record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.checked import claim, input_files
from cvxshear.cli.output import FIGURES as FIGURE_ENDINGS
from cvxshear.cli.output import (
    BackendName,
    JsonOut,
    Quiet,
    ReportOut,
    deliver,
    figures_for,
    names,
    progress,
    typed,
)
from cvxshear.cli.records import measured, needs_mass
from cvxshear.util.errors import InputError, NoScaleError
from cvxshear.util.text import shell_line

if TYPE_CHECKING:
    from cvxshear.response import RecordPrediction
    from cvxshear.response.sources import ModelSource
    from cvxshear.screening import Finding


def predict(
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
            help="A record file: the base motion or force, and responses to compare with.",
            callback=input_files,
        ),
    ],
    backend: BackendName = "auto",
    damping: Annotated[
        str | None, typer.Option(help="modal, story or rayleigh; what FILE declares where not given.")
    ] = None,
    configuration: Annotated[
        str | None, typer.Option(help="Which tested state; the one with the record's added mass where not given.")
    ] = None,
    assume: Annotated[
        str | None, typer.Option(help="Effects that are in the model from the start.", metavar="NAME,...")
    ] = None,
    detrend: Annotated[
        bool, typer.Option(help="Take the straight line through each recorded acceleration off.")
    ] = True,
    series: Annotated[
        str | None, typer.Option("--out", help="Write the time series here: .csv, .mat, .npz or .uff.", metavar="OUT")
    ] = None,
    export: Annotated[
        list[str] | None,
        typer.Option(
            help="Write the model here: .npz, .mat, .json, .py (OpenSeesPy) or .xlsx; may be repeated.", metavar="OUT"
        ),
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option(
            help="Draw history, peaks, transfer or spectra into a file: KIND:OUT.svg, .png or .pdf; may be repeated.",
            metavar="KIND:OUT",
        ),
    ] = None,
    report: ReportOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Predict how every floor answers to a record, beside what was measured.

    Example: cvxshear predict frame.toml --record earthquake.toml
    """
    from cvxshear.report import terminal
    from cvxshear.response import predict as run
    from cvxshear.screening import in_json

    files = Files(series, export or [], figure or [])
    files.claim(context)
    pages: list[Callable[[], None]] = []
    if report is not None:
        from cvxshear.report.html import write_prediction_report

        pages.append(lambda: write_prediction_report(result, report, shell_line(["cvxshear", *typed])))
    with progress("predicting", quiet):
        source, doubts = screened(file, backend, names(assume) or ())
        result = run(source, record, backend, damping=damping, configuration=configuration, detrend=detrend)
    said = {**result.to_dict(), **in_json(doubts)}
    deliver(said, out, lambda: [*terminal.doubts(doubts or ()), *terminal.shown(result)], *files.of(result), *pages)


def screened(file: str, backend: str, assume: Sequence[str] = ()) -> tuple[ModelSource, Sequence[Finding] | None]:
    """What the model is made of, without mistakes, and its warnings; None where `loop` looked for them before."""
    from cvxshear import backends, close_loop
    from cvxshear.measurement.declaration import NUMBERS
    from cvxshear.response import models_of_loop
    from cvxshear.response.sources import load_unscaled
    from cvxshear.screening import refuse_mistakes

    if Path(file).suffix.lower() == ".json":
        if assume:
            raise InputError(f"{file} holds a model that the loop ended with; --assume belongs to 'cvxshear loop'")
        return file, None
    mass_known = True
    try:
        experiment, found = measured([file])
    except NoScaleError:
        # Only forces need the scale of the masses, and the result leaves those out.
        experiment, mass_known = load_unscaled(file)
        found = []
    doubts = refuse_mistakes(experiment, NUMBERS if found else ())
    if not found and not assume and mass_known:
        return experiment, doubts
    closure = close_loop(experiment, assume=assume, backend=backends.get(backend))
    return models_of_loop(closure, mass_known=mass_known and not needs_mass(found)), doubts


class Files:
    """The files that are asked for besides the JSON; wrong names are told before anything runs.

    Parameters
    ----------
    series : str, optional
    models, figures : list of str
        Figures as KIND:OUT.

    Raises
    ------
    InputError
        Where an ending or a kind of figure is unknown, or figures are asked for without matplotlib.
    """

    def __init__(self, series: str | None, models: list[str], figures: list[str]) -> None:
        from cvxshear.report.handover import model_kind
        from cvxshear.report.series_files import series_kind

        self.series, self.models = series, models
        self.figures = [_figure(each) for each in figures]
        if series is not None:
            series_kind(series)
        for each in models:
            model_kind(each)
        self.drawing = figures_for(*(path for _, path in self.figures))

    def claim(self, context: typer.Context) -> None:
        """Refuse, before the run, what could not be written, or would be written over what is read."""
        from cvxshear.report import handover
        from cvxshear.report import series_files as tables

        if self.series is not None:
            claim(context, "--out", self.series, [f".{kind}" for kind in tables.WRITERS])
        for path in self.models:
            claim(context, "--export", path, [f".{kind}" for kind in handover.WRITERS])
        for _, path in self.figures:
            claim(context, "--figure", path, FIGURE_ENDINGS)

    def of(self, result: RecordPrediction) -> list[Callable[[], None]]:
        """What writes each of them."""
        from cvxshear.report.handover import write_model
        from cvxshear.report.series_files import write_series

        writers = [] if self.series is None else [partial(write_series, self.series, result)]
        writers += [partial(write_model, each, result) for each in self.models]
        return [*writers, *(partial(self._draw, kind, path, result) for kind, path in self.figures)]

    def _draw(self, kind: str, path: str, result: RecordPrediction) -> None:
        if self.drawing is not None:
            self.drawing.save(self.drawing.drawn_figure(kind, result), path)


def _figure(text: str) -> tuple[str, str]:
    """Kind and file of a figure."""
    kind, mark, path = text.partition(":")
    if not mark or not path:
        raise InputError("--figure must be KIND:OUT, such as peaks:peaks.svg")
    figures_for(path)
    from cvxshear.report.figures import figures_of
    from cvxshear.response import RecordPrediction

    known = figures_of(RecordPrediction)
    if kind not in known:
        raise InputError(f"--figure must be KIND:OUT, such as peaks:peaks.svg, KIND one of {', '.join(known)}")
    return kind, path
