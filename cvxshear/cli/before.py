"""The commands before anything is fitted: to begin a file, and to look for mistakes in one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cvxshear.cli.checked import input_files
from cvxshear.cli.output import JsonOut, deliver, printing, writes
from cvxshear.cli.records import measured
from cvxshear.files.formats import endings_of
from cvxshear.util.errors import InputError
from cvxshear.util.writing import write_file


def new(
    output: Annotated[
        str | None,
        writes("--output", "-o", what="Write it here; printed where not given.", metavar="TOML", endings=(".toml",)),
    ] = None,
    stories: Annotated[int | None, typer.Option(help="How many stories the frame has; 3 where not given.")] = None,
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
    """
    from cvxshear.files.to_fill_in import record_template, template, template_from

    given = [
        name for name, value in (("--from", modes), ("--stories", stories), ("--record", record)) if value is not None
    ]
    if len(given) > 1:
        raise InputError(f"give only one of {' and '.join(given)}: either tells what the file is begun from")
    if output is not None and Path(output).exists():
        raise InputError(f"{output} is there already; name a new file, or delete the old one first")
    folder = Path(output).parent if output is not None else Path()
    if record is not None:
        text = record_template(record, folder)
    else:
        text = template_from(modes, folder) if modes is not None else template(3 if stories is None else stories)
    if output is None:
        with printing():
            sys.stdout.write(text)
    else:
        write_file(output, text)


MISTAKE_STATUS = 2


def check(
    file: Annotated[
        str,
        typer.Argument(
            help="A measurement file or a record file (TOML), or 'paper' for the example.",
            metavar="FILE",
            callback=input_files,
        ),
    ],
    out: JsonOut = None,
) -> None:
    """Tell what looks wrong in a measurement file or a record, before anything is fitted; status 2 for a mistake.

    Example: cvxshear check paper
    """
    from cvxshear.report import terminal
    from cvxshear.screening import Screening

    experiment, tests = measured([file], accept_swapped=True)
    found = Screening.of(experiment, (item for each in tests for item in each.modes.findings))
    deliver(found.to_dict(), out, lambda: terminal.shown(found), title=experiment.report.title or experiment.name)
    if found.refused:
        raise typer.Exit(MISTAKE_STATUS)
