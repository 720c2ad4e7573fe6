"""The command that looks for mistakes before anything is fitted."""

from __future__ import annotations

from typing import Annotated

import typer

from cvxshear.cli.checked import input_files
from cvxshear.cli.output import JsonOut, deliver
from cvxshear.cli.records import measured

MISTAKEN = 2


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
        raise typer.Exit(MISTAKEN)
