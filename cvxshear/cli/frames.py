"""Commands for a frame: identify its masses and stiffnesses, and find the missing physical effects."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.before import measured, records_in_json, tables_of
from cvxshear.cli.options import BackendName, File, Files, JsonOut, Quiet, ReportOut, UnitsOption, input_files
from cvxshear.cli.output import as_typed, deliver, doubts_of, heading_of, names, numbers, progress, show
from cvxshear.cli.written import LIST, CsvOut, FiguresOut, Pictures, Spreadsheets, XlsxOut
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.results import as_json
from cvxshear.util.writing import write_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rich.console import RenderableType

    from cvxshear import Identification
    from cvxshear.response import IdentifiedDamping
    from cvxshear.util.quantities import Units


UNCERTAIN = 3
"""Exit status of `loop --strict` for an unreliable verdict."""


def identify(
    file: File,
    method: str | None = None,
    backend: BackendName = "auto",
    initial_mass: str | None = None,
    tolerance: float = 1e-6,
    units: UnitsOption = None,
    figure: FiguresOut = None,
    csv: CsvOut = None,
    xlsx: XlsxOut = None,
    out: JsonOut = None,
) -> None:
    """Identify floor masses and story stiffnesses.

    Where no method is named the efficient one answers, and the paper's is printed beside it if it can use the data.

    Example: cvxshear identify paper --method two-stage

    Parameters
    ----------
    file
        A measurement file (TOML), or 'paper' for the built-in example.
    method
        efficient (where none is named), two-stage, one-shot, berman or qi.
    initial_mass
        Where the mass iteration starts, kg, such as 9.5,7.5,5.5; means two-stage by itself.
    tolerance
        At which relative correction the mass iteration stops.
    """
    # The solvers load slowly, and the help does not need them.
    from cvxshear import Identification, load
    from cvxshear import identify as run
    from cvxshear.report.handover import sheets_of
    from cvxshear.response import Fitted, damping_of
    from cvxshear.screening import refuse_mistakes
    from cvxshear.util.quantities import Units

    pictures, tables, display = Pictures(figure, Identification), Spreadsheets(csv, xlsx), Units.parse(units)
    experiment, start = load(file), numbers(initial_mass, "--initial-mass")
    doubts = refuse_mistakes(experiment)
    named = method or ("efficient" if start is None else "two-stage")
    result = run(experiment, method=named, backend=backend, initial_mass=start, tolerance=tolerance)
    beside = None
    if method is None and named == "efficient" and out != "-":
        with suppress(UnsuitableError):
            beside = run(experiment, method="two-stage", backend=backend)
    fitted = Fitted.of_identification(result)
    damping = None if fitted is None else damping_of(experiment, fitted, backend)
    files = [*pictures.of(result), *tables.of(lambda: sheets_of(result))]
    said = {**result.to_dict(), "damping": as_json(damping), "warnings": as_json(doubts)}
    deliver(
        said,
        out,
        lambda: [*doubts_of(doubts), *_identified(result, beside, display), *_damping_of(damping)],
        *files,
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
    units: UnitsOption = None,
    figure: FiguresOut = None,
    csv: CsvOut = None,
    xlsx: XlsxOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper

    Parameters
    ----------
    sources
        A measurement file (TOML), 'paper' for the built-in example, or record files and patterns of them.
    effects
        Which effects to look for, commas between; all where not given. 'list' prints them, with the kinds of data and
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
    from cvxshear.report import terminal
    from cvxshear.report.handover import sheets_of
    from cvxshear.response import damping_of, models_of_loop, predict
    from cvxshear.screening import close_loop
    from cvxshear.util.quantities import Units

    if effects == LIST:
        show(_catalogued())
        raise typer.Exit
    pictures, tables, display = Pictures(figure, LoopResult), Spreadsheets(csv, xlsx), Units.parse(units)
    if report is not None:
        from cvxshear.report.html import photograph_of, render
    said_of_it = heading_of(report, title=title, client=client, author=author, date=date, photograph=photograph)
    with progress("closing the loop", quiet) as advance:
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
        "model": models.to_dict(),
    }
    if tried is not None:
        said["validation"] = tried.to_dict()
    files = [*pictures.of(result), *tables.of(lambda: sheets_of(result))]
    if report is not None:
        page = partial(render, result, as_typed(), units=display, prediction=tried, heading=heading)
        files.append(lambda: write_file(report, page()))
    beside = _damping_of(damping) if tried is None else ("", *terminal.shown(tried))
    beside = [*beside, *filter(None, [without])]
    deliver(
        said,
        out,
        lambda: [*tables_of(found), *doubts_of(result.warnings), *terminal.shown(result, display), *beside],
        *files,
        title=heading.title or experiment.name,
    )
    if strict and not VERDICTS[result.verdict].certain:
        raise typer.Exit(UNCERTAIN)


def _damping_of(found: IdentifiedDamping | None) -> Iterable[RenderableType]:
    from cvxshear.report import terminal
    from cvxshear.report.describe.responses import damping_section

    return () if found is None else terminal.rendered(damping_section(found))


def _identified(result: Identification, beside: Identification | None, units: Units) -> Iterator[RenderableType]:
    """Render an identification, and the frames of another one for comparison."""
    from cvxshear.report import terminal
    from cvxshear.report.describe import describe

    yield from terminal.shown(result, units)
    if beside is not None:
        yield f"\nFor comparison: method {beside.method}, each configuration by itself"
        for section in describe(beside, units).sections:
            if section.key.startswith("part-"):
                yield from terminal.rendered(section)


def _catalogued() -> Iterator[RenderableType]:
    """Tabulate the catalogue of effects, the kinds of data with their noise, and the verdicts."""
    from cvxshear.data import noise_kinds
    from cvxshear.effects import catalogue
    from cvxshear.loop import VERDICTS
    from cvxshear.report.terminal import plain_table

    yield plain_table("Effects", "name", "what it is", words=(0, 1), rows=((x.name, x.summary) for x in catalogue()))
    kinds = []
    for kind in noise_kinds().values():
        (usual, most), unit = kind.sized(1.0, kind.largest / kind.default)
        kinds.append((kind.plural, f"{usual:g} {unit}", f"{most:g} {unit}", kind.reason))
    yield ""
    head = ("kind", "std where none is declared", "largest std", "why")
    yield plain_table("Kinds of data", *head, words=(0, 3), rows=kinds)
    yield ""
    verdicts = ((x.name, x.sentence) for x in VERDICTS.values())
    yield plain_table("Verdicts", "name", "what it means", words=(0, 1), rows=verdicts)
