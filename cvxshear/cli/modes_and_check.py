"""Commands before the identification: make a file to fill in, check a file, find the modes of records."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType

import cvxshear
from cvxshear.cli import options
from cvxshear.cli.output import complain, deliver, numbers, progress
from cvxshear.io.formats import endings_of
from cvxshear.report import terminal
from cvxshear.util.errors import CvxshearError, InputError
from cvxshear.util.writing import write_file

if TYPE_CHECKING:
    from cvxshear.records import IdentifiedRecord, ModalResult
    from cvxshear.util.parallel import Progress
    from cvxshear.util.typing import Json


def new(
    more: Annotated[list[str] | None, typer.Argument(metavar="DATA...")] = None,
    output: options.TomlOut = None,
    stories: int | None = None,
    modes: Annotated[
        str | None,
        typer.Option("--from", help=f"Take the modes from this file: {endings_of('modes')}.", metavar="FILE"),
    ] = None,
    record: Annotated[
        str | None,
        typer.Option(
            "--record", help=f"Begin a record file for what a logger wrote: {endings_of('columns')}.", metavar="DATA"
        ),
    ] = None,
) -> None:
    """Begin a measurement file, or with --record a record file: one with every key explained, to fill in.

    Example: cvxshear new --stories 5 -o test.toml
    Example: cvxshear new --record hit1.csv hit2.csv hit3.csv -o hits.toml

    Parameters
    ----------
    more
        More files of the record that --record begins.
    output
        Write it here; default: print it.
    stories
        How many stories the frame has; default: 3.
    """
    from cvxshear.io.templates import record_template, template, template_from

    given = [
        name for name, value in (("--from", modes), ("--stories", stories), ("--record", record)) if value is not None
    ]
    if len(given) > 1:
        raise InputError(f"give only one of {' and '.join(given)}: either tells what the file is begun from")
    if more and record is None:
        raise InputError(f"{more[0]}: name files after --record, for a record file, or after --from")
    if output is not None and Path(output).exists():
        raise InputError(f"{output} is there already; name a new file, or delete the old one first")
    folder = Path(output).parent if output is not None else Path()
    if record is not None:
        text = record_template([record, *(more or ())], folder)
    else:
        text = template_from(modes, folder) if modes is not None else template(3 if stories is None else stories)
    if output is None:
        sys.stdout.write(text)
    else:
        write_file(output, text)


#: Exit statuses: 2 for a mistake, which other commands refuse; 3 with --strict for a doubt or an unreliable verdict.
MISTAKE_STATUS, DOUBT_STATUS = 2, 3


def check(file: options.File, out: options.JsonOut = None, strict: bool = False) -> None:
    """Tell what looks wrong in a measurement file or a record, before anything is fitted; status 2 for a mistake.

    Example: cvxshear check paper

    Parameters
    ----------
    file
        A measurement file or a record file (TOML), or 'paper' for the example.
    strict
        Status 3 where a doubt is open.
    """
    from cvxshear.screening import Screening

    experiment, tests = measured([file])
    found = Screening.of(experiment, (item for each in tests for item in each.modes.findings))
    deliver(found.to_dict(), out, lambda: terminal.shown(found), title=experiment.report.title or experiment.name)
    if found.refused or (strict and found.doubtful):
        raise typer.Exit(MISTAKE_STATUS if found.refused else DOUBT_STATUS)


def modes(
    records: Annotated[list[str], typer.Argument(metavar="RECORD...", callback=options.input_files)],
    output: options.TomlOut = None,
    method: str | None = None,
    pick: str | None = None,
    each_run: bool = False,
    jobs: int = 1,
    *,
    outputs: options.ResultOptions,
) -> None:
    """Identify natural frequencies, damping and mode shapes from records.

    Of several records, one that fails does not keep the others from being written.

    Example: cvxshear modes bare.toml loaded.toml -o test.toml

    Parameters
    ----------
    records
        Record files (TOML).
    output
        Write a measurement file here, a configuration each.
    method
        era, subspace or ssi; default: the one that suits the record.
    pick : 3.68,11.1,...
        Take the stable poles nearest to these frequencies, Hz; 'list' prints the poles.
    each_run
        Identify each run by itself, such as each of several earthquakes.
    jobs
        Processes that identify records; -1 takes every core.
    """
    from cvxshear.io.modes import identify_modes_many, write_merged
    from cvxshear.records import ModalResult
    from cvxshear.report.from_records import poles_table

    sources = list(dict.fromkeys(records))
    outputs.check(ModalResult)
    with progress("identifying modes", outputs.quiet) as advance:
        found = identify_modes_many(
            sources,
            each_run=each_run,
            jobs=jobs,
            progress=advance,
            functions=bool(outputs.figure) or outputs.report is not None,
            method=method,
            pick=None if pick == options.LIST else numbers(pick, "--pick"),
        )
    errors = [error for error in found if isinstance(error, CvxshearError)]
    complain(*errors)
    tests = _kept(found)
    if tests:
        results, reasons = [test.modes for test in tests], list(map(str, errors))
        failed = [
            {"file": next((file for file in sources if file in said), sources[0]), "reason": said} for said in reasons
        ]
        outputs.deliver(
            results,
            *([] if output is None else [partial(write_merged, output, tests)]),
            said=results[0].to_dict() if len(found) == 1 else {"records": records_in_json(tests), "failed": failed},
            tables=lambda: (
                map(terminal.HouseTable, map(poles_table, results)) if pick == options.LIST else tables_of(tests)
            ),
            failed=reasons,
        )
    if errors:
        raise typer.Exit(2 if any(isinstance(error, InputError) for error in errors) else 1)


def measured(
    names: Sequence[str], *, jobs: int = 1, progress: Progress | None = None
) -> tuple[cvxshear.Experiment, list[IdentifiedRecord]]:
    """Read the experiment from a measurement file, or from record files and their identified modes.

    Raises
    ------
    InputError
        If one of several files is a measurement file, or a record cannot be used.
    NoSolutionError
        If a record has no identified mode.
    """
    from cvxshear.io import modes, toml
    from cvxshear.records import merged

    files = list(dict.fromkeys(names))
    if len(files) == 1 and not toml.is_record_file(files[0]):
        return cvxshear.load(files[0]), []
    for file in files:
        if not toml.is_record_file(file):
            raise InputError(f"{file} is no record file; hand in either records or one measurement file")
    found = modes.identify_modes_many(files, jobs=jobs, progress=progress)
    errors = [error for error in found if isinstance(error, CvxshearError)]
    complain(*errors[:-1])
    if errors:
        raise errors[-1]
    tests = _kept(found)
    return cvxshear.Experiment.from_dict(merged(tests), name=Path(files[0]).stem), tests


def tables_of(tests: Sequence[IdentifiedRecord]) -> Iterable[RenderableType]:
    """Render the identified modes of each record for a terminal, and the findings about the records."""
    from cvxshear.io.modes import UNKNOWN_SCALE, scale_unsaid
    from cvxshear.report.from_records import amplitude_section

    for test in tests:
        yield from terminal.shown(test.modes)
        yield ""
    alike: dict[tuple[object, ...], list[ModalResult]] = {}
    for test in tests:
        alike.setdefault((test.state, *(test.added_mass or ())), []).append(test.modes)
    for results in alike.values():
        if len(results) > 2 and all(result.amplitude for result in results):
            yield from terminal.rendered(amplitude_section(results))
            yield ""
    if tests and scale_unsaid(tests):
        yield f"scale: {UNKNOWN_SCALE}"


def records_in_json(tests: Sequence[IdentifiedRecord]) -> list[Json]:
    """Return the modes of each record with the name of its file, for a result's JSON."""
    return [{"file": test.file, **test.modes.to_dict()} for test in tests]


def _kept(found: Sequence[IdentifiedRecord | CvxshearError]) -> list[IdentifiedRecord]:
    return [test for test in found if not isinstance(test, CvxshearError)]
