"""The command that tells which backends there are, and compares them."""

from __future__ import annotations

from typing import Annotated

import typer

from cvxshear.cli.checked import input_files
from cvxshear.cli.output import FigureOut, JsonOut, Quiet, deliver, figures_for, names, progress
from cvxshear.util.errors import InputError

OptionalFile = Annotated[
    str | None,
    typer.Argument(help="A measurement file (TOML), or 'paper'; without one: what is installed.", callback=input_files),
]


def backends(
    file: OptionalFile = None,
    only: Annotated[
        str | None, typer.Option(help="Which backends, commas between; all that are installed where not given.")
    ] = None,
    repeat: Annotated[int, typer.Option(help="Solves of each program of which the fastest counts.")] = 3,
    tolerance: Annotated[
        float | None, typer.Option(help="Accuracy asked of the solvers, in place of their settings here.")
    ] = None,
    export: Annotated[
        str | None,
        typer.Option(help="Write the programs into this new folder, as NPZ and for qpbenchmark.", metavar="DIR"),
    ] = None,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """List the backends; with a file, solve its programs with every one and compare them to the closed form.

    Example: cvxshear backends paper --repeat 10
    """
    if file is None:
        given = {"--only": only, "--tolerance": tolerance, "--export": export, "--figure": figure}
        for option, value in given.items():
            if value is not None:
                raise InputError(f"{option} needs programs: name a measurement file, or 'paper'")
        _list(out)
        return
    from cvxshear import compare_backends, load
    from cvxshear.report import terminal

    drawing = figures_for(figure)
    experiment = load(file)
    if export is not None:
        from cvxshear.backends.export import export as write
        from cvxshear.methods import programs_of

        write(programs_of(experiment)[0], export)
    with progress("comparing backends", quiet):
        result = compare_backends(experiment, names(only), repeats=repeat, tolerance=tolerance)
    if drawing is not None:
        drawing.save(drawing.backend_differences(result), figure)
    deliver(result.to_dict(), out, lambda: terminal.shown(result), title=experiment.report.title or experiment.name)


def _list(out: str | None) -> None:
    from cvxshear.backends import listed
    from cvxshear.report import terminal

    found = listed()
    deliver({"backends": [each.to_dict() for each in found]}, out, lambda: terminal.listed_backends(found))
