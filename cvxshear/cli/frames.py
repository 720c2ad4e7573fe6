"""Commands for a frame: identify it, find the missing physical effects, predict and reconstruct its motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cvxshear.cli.modes_and_check import measured, records_in_json, tables_of
from cvxshear.cli.options import (
    LIST,
    BackendName,
    File,
    Files,
    ReportOut,
    ResultOptions,
    SeriesOut,
    Writer,
    handed_over,
    input_files,
)
from cvxshear.cli.output import as_typed, deliver, doubts_of, heading_of, names, numbers, progress, show
from cvxshear.report import terminal
from cvxshear.report.describe import describe
from cvxshear.util.errors import NoScaleError, UnsuitableError
from cvxshear.util.results import as_json
from cvxshear.util.writing import write_file

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear import Identification
    from cvxshear.response import IdentifiedDamping, Models, Reconstruction, RecordPrediction
    from cvxshear.screening import FileFinding


UNCERTAIN = 3
"""Exit status of `loop --strict` for an unreliable verdict."""


def identify(
    file: File,
    method: str | None = None,
    backend: BackendName = "auto",
    initial_mass: str | None = None,
    tolerance: float = 1e-6,
    *,
    outputs: ResultOptions,
) -> None:
    """Identify floor masses and story stiffnesses.

    Where no method is named the efficient one answers, and the paper's is printed beside it if it can use the data.

    Example: cvxshear identify paper --method two-stage

    Parameters
    ----------
    file
        A measurement file (TOML), or 'paper' for the built-in example.
    method
        efficient (the default), two-stage, one-shot, berman or qi.
    initial_mass
        Where the mass iteration starts, kg, such as 9.5,7.5,5.5; means two-stage by itself.
    tolerance
        At which relative correction the mass iteration stops.
    """
    # The solvers load slowly, and the help does not need them.
    from cvxshear import Identification, load
    from cvxshear import identify as run
    from cvxshear.response import Fitted, damping_of
    from cvxshear.screening import refuse_mistakes

    files_of = outputs.prepared(Identification)
    experiment, start = load(file), numbers(initial_mass, "--initial-mass")
    doubts = refuse_mistakes(experiment)
    named = method or ("efficient" if start is None else "two-stage")
    result = run(experiment, method=named, backend=backend, initial_mass=start, tolerance=tolerance)
    beside = None
    if method is None and named == "efficient" and outputs.out != "-":
        with suppress(UnsuitableError):
            beside = run(experiment, method="two-stage", backend=backend)
    fitted = Fitted.of_identification(result)
    damping = None if fitted is None else damping_of(experiment, fitted, backend)
    said = {**result.to_dict(), "damping": as_json(damping), "warnings": as_json(doubts)}
    deliver(
        said,
        outputs.out,
        lambda: [*doubts_of(doubts), *_identified(result, beside, damping)],
        *files_of(result),
        title=experiment.report.title or experiment.name,
    )


def loop(
    sources: Files,
    effects: str | None = None,
    assume: str | None = None,
    backend: BackendName = "auto",
    jobs: int = 1,
    report: ReportOut = None,
    title: str | None = None,
    client: str | None = None,
    author: str | None = None,
    date: str | None = None,
    photograph: Annotated[str | None, typer.Option(callback=input_files)] = None,
    validate: Annotated[str | None, typer.Option(metavar="RECORD", callback=input_files)] = None,
    strict: bool = False,
    *,
    outputs: ResultOptions,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper

    Parameters
    ----------
    sources
        A measurement file (TOML), 'paper' for the built-in example, or record files.
    effects
        Which effects to look for, commas between; default: all. 'list' prints them, with the kinds of data and
        the verdicts.
    assume
        Effects that are in the model from the start, such as gravity.
    jobs
        Processes that fit candidates; -1 takes every core.
    title
        Title of the report.
    client
        For whom the report is.
    author
        Who answers for the report.
    date
        Date of the report.
    photograph
        A PNG or JPEG that the report shows.
    validate
        A record file: predict it by the models before and after.
    strict
        Status 3 where the verdict is not one to rely on, such as ambiguous.
    """
    from cvxshear import LoopResult
    from cvxshear.loop.verdicts import VERDICTS
    from cvxshear.response import damping_of, models_of_loop, predict
    from cvxshear.screening import close_loop

    if effects == LIST:
        show(_catalogued())
        raise typer.Exit
    files_of = outputs.prepared(LoopResult)
    if report is not None:
        from cvxshear.report.html import photograph_of, render
    said_of_it = heading_of(report, title=title, client=client, author=author, date=date, photograph=photograph)
    with progress("closing the loop", outputs.quiet) as advance:
        experiment, found = measured(sources, jobs=jobs, progress=advance)
        heading = dataclasses.replace(experiment.report, **said_of_it)
        if report is not None:
            photograph_of(heading)
        # A record has no declared mode numbers: the loop compares possible numbers together with the effects.
        result = close_loop(
            experiment,
            effects=names(effects),
            assume=names(assume) or (),
            backend=backend,
            jobs=jobs,
            weighed=[each.name for each in experiment.configurations if found],
        )
        models = models_of_loop(result)
        damping, tried, without = None, None, ""
        try:
            damping = damping_of(experiment, models.after, backend)
            tried = None if validate is None else predict(models, validate, backend)
        except UnsuitableError as error:
            # The verdict is valid without the predicted response.
            without = f"without its damping and response: {error}"
    said = {
        **result.to_dict(),
        "information": [*result.information, *filter(None, [without])],
        **records_in_json(found),
        "damping": as_json(damping),
    }
    if tried is not None:
        said["validation"] = tried.to_dict()
    files = files_of(result)
    if report is not None:
        page = partial(render, result, as_typed(), prediction=tried, heading=heading)
        files.append(lambda: write_file(report, page()))
    moved = damping if tried is None else tried
    beside = [*(() if moved is None else ("", *terminal.shown(moved))), *filter(None, [without])]
    deliver(
        said,
        outputs.out,
        lambda: [*tables_of(found), *doubts_of(result.warnings), *terminal.shown(result), *beside],
        *files,
        title=heading.title or experiment.name,
    )
    if strict and not VERDICTS[result.verdict].certain:
        raise typer.Exit(UNCERTAIN)


def _identified(
    result: Identification, beside: Identification | None, damping: IdentifiedDamping | None
) -> Iterator[RenderableType]:
    """Render an identification, the frames of another one for comparison, and the damping."""
    yield from terminal.shown(result)
    if beside is not None:
        yield f"\nFor comparison: method {beside.method}, each configuration by itself"
        for section in describe(beside).sections:
            if section.key.startswith("part-"):
                yield from terminal.rendered(section)
    if damping is not None:
        yield ""
        yield from terminal.shown(damping)


def _catalogued() -> Iterator[RenderableType]:
    """Tabulate the catalogue of effects, the kinds of data with their noise, and the verdicts."""
    from cvxshear.data import noise_kinds
    from cvxshear.effects import catalogue
    from cvxshear.loop import VERDICTS

    yield terminal.plain_table(
        "Effects", "name", "what it is", words=(0, 1), rows=((x.name, x.summary) for x in catalogue())
    )
    kinds = []
    for kind in noise_kinds().values():
        (usual, most), unit = kind.sized(1.0, kind.largest / kind.default)
        kinds.append((kind.plural, f"{usual:g} {unit}", f"{most:g} {unit}", kind.reason))
    yield ""
    head = ("kind", "std where none is declared", "largest std", "why")
    yield terminal.plain_table("Kinds of data", *head, words=(0, 3), rows=kinds)
    yield ""
    verdicts = ((x.name, x.sentence) for x in VERDICTS.values())
    yield terminal.plain_table("Verdicts", "name", "what it means", words=(0, 1), rows=verdicts)


@dataclass(frozen=True)
class Motion:
    """Options of commands that model the motion of a frame in a record.

    Parameters
    ----------
    file
        What the model is made of: a measurement file or a record file.
    damping
        modal, story or rayleigh; default: the kind that FILE declares.
    configuration
        Which test or state; default: the one with the record's added mass.
    assume : NAME,...
        Effects in the model from the start.
    detrend
        Take the straight line through each recorded acceleration off.
    """

    file: File
    record: Annotated[str, typer.Option("--record", callback=input_files)]
    backend: BackendName = "auto"
    damping: str | None = None
    configuration: str | None = None
    assume: str | None = None
    detrend: bool = True
    series: SeriesOut = None
    report: ReportOut = None

    def prepared(self, context: typer.Context) -> list[Callable[..., None]]:
        """Make the functions that write the requested time series and report of a result."""
        from cvxshear.report.handover import series_kind, write_series

        series = [self.series] if self.series else []
        written = handed_over(context, "--out", series, series_kind, write_series)
        if self.report is not None:
            written.append(partial(_write_page, self.report))
        return written

    def screened(self) -> tuple[Models, Sequence[FileFinding]]:
        """Close the loop on a measurement; return its models and warnings."""
        from cvxshear.response import models_of_loop
        from cvxshear.response.sources import load_unscaled
        from cvxshear.screening import close_loop

        try:
            experiment, found = measured([self.file])
        except NoScaleError:
            # Only forces need the scale of the masses; the result leaves forces out.
            experiment, found = load_unscaled(self.file), []
        # A record has no declared mode numbers: the loop compares possible numbers together with the effects.
        weighed = [each.name for each in experiment.configurations if found]
        result = close_loop(experiment, assume=names(self.assume) or (), backend=self.backend, weighed=weighed)
        return models_of_loop(result), result.warnings

    @property
    def model(self) -> dict[str, Any]:
        """Keywords of `predict` and `reconstruct`."""
        shared = ("backend", "damping", "configuration", "detrend")
        return {name: getattr(self, name) for name in shared}


def _write_page(path: str, result: RecordPrediction | Reconstruction) -> None:
    from cvxshear.report.html import render_response

    write_file(path, render_response(result, as_typed()))


def predict(context: typer.Context, *, motion: Motion, export: list[str] | None = None, outputs: ResultOptions) -> None:
    """Predict how every floor answers to a record, beside what was measured.

    Example: cvxshear predict frame.toml --record earthquake.toml

    Parameters
    ----------
    record
        A record file: the base motion or force, and responses to compare with.
    export : OUT
        Write the model here: .npz, .mat, .json or .py (OpenSeesPy); may be repeated.
    """
    from cvxshear.report.handover import model_kind, write_model
    from cvxshear.response import RecordPrediction
    from cvxshear.response import predict as run

    written = motion.prepared(context)
    written += handed_over(context, "--export", export or [], model_kind, write_model)
    files_of = outputs.prepared(RecordPrediction)
    with progress("predicting", outputs.quiet):
        source, doubts = motion.screened()
        result = run(source, motion.record, **motion.model)
    _deliver_motion(result, doubts, outputs.out, *files_of(result), *(partial(write, result) for write in written))


def reconstruct(
    context: typer.Context, *, motion: Motion, fit: bool = True, leave_out: bool = True, outputs: ResultOptions
) -> None:
    """Find how every floor moved, from the floors that carry sensors: drifts, forces, and whether a story changed.

    Example: cvxshear reconstruct frame.toml --record earthquake.toml --report drifts.html

    Parameters
    ----------
    record
        A record file: floors that carry sensors, with gaps or not, and the base motion; input = "none" where nobody
        measured that.
    fit
        Fit the frame to the record; otherwise it stays as identified.
    leave_out
        Leave each sensor out in turn and predict it from the others.
    """
    from cvxshear.response import Reconstruction
    from cvxshear.response import reconstruct as run

    written, files_of = motion.prepared(context), outputs.prepared(Reconstruction)
    with progress("reconstructing", outputs.quiet) as advance:
        source, doubts = motion.screened()
        result = run(source, motion.record, fit=fit, leave_out=leave_out, progress=advance, **motion.model)
    _deliver_motion(result, doubts, outputs.out, *files_of(result), *(partial(write, result) for write in written))


def _deliver_motion(
    result: RecordPrediction | Reconstruction, doubts: Sequence[FileFinding], out: str | None, *files: Writer
) -> None:
    from cvxshear.screening import in_json

    deliver({**result.to_dict(), **in_json(doubts)}, out, lambda: [*doubts_of(doubts), *terminal.shown(result)], *files)
