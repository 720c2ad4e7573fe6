"""The commands for one test of a frame: its modes, its masses and stiffnesses, what the model lacks, the backends."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType

from cvxshear.cli.output import (
    BackendName,
    FigureOut,
    File,
    JsonOut,
    Quiet,
    deliver,
    figures_for,
    names,
    progress,
    typed,
)
from cvxshear.errors import InputError, UnsuitableError

if TYPE_CHECKING:
    from cvxshear import Experiment
    from cvxshear.modal import ModalResult
    from cvxshear.response import IdentifiedDamping


def identify(
    file: File,
    method: Annotated[
        str | None, typer.Option(help="efficient (where none is named), two-stage, one-shot, berman or qi.")
    ] = None,
    backend: BackendName = "auto",
    initial_mass: Annotated[
        str | None,
        typer.Option(help="Where the mass iteration starts, kg, such as 9.5,7.5,5.5; means two-stage by itself."),
    ] = None,
    tolerance: Annotated[float, typer.Option(help="At which relative correction the mass iteration stops.")] = 1e-6,
    accelerate: Annotated[
        bool, typer.Option("--accelerate", help="Reach the end of the mass iteration in a few steps (two-stage).")
    ] = False,
    figure: FigureOut = None,
    out: JsonOut = None,
) -> None:
    """Identify floor masses and story stiffnesses.

    Where no method is named the efficient one answers, and the paper's is printed beside it if it can use the data.

    Example: cvxshear identify paper --method two-stage
    """
    # The solvers load slowly, and help needs none of them.
    from cvxshear import identify as run
    from cvxshear import load
    from cvxshear.report import terminal
    from cvxshear.response import Fitted, damping_of

    drawing = figures_for(figure)
    experiment, start = load(file), _numbers(initial_mass)
    named = method or ("efficient" if start is None else "two-stage")
    result = run(
        experiment, method=named, backend=backend, initial_mass=start, tolerance=tolerance, accelerate=accelerate
    )
    beside = None
    if method is None and named == "efficient" and out != "-":
        with suppress(UnsuitableError):
            beside = run(experiment, method="two-stage", backend=backend)
    fitted = Fitted.of_identification(result)
    damping = None if fitted is None else damping_of(experiment, fitted, backend)
    if drawing is not None:
        drawing.save(drawing.frame(result), figure)
    said = {**result.to_dict(), "damping": None if damping is None else damping.to_dict()}
    deliver(said, out, lambda: [*terminal.identification(result, beside), *_damping_of(damping)])


def _numbers(text: str | None) -> list[float] | None:
    """The numbers of a comma-separated option."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(
            f"--initial-mass must be numbers with commas between, such as 9.5,7.5,5.5, not {text!r}"
        ) from None


def loop(
    file: File,
    effects: Annotated[
        str | None, typer.Option(help="Which effects to look for, commas between; all where not given.")
    ] = None,
    assume: Annotated[
        str | None, typer.Option(help="Effects that are in the model from the start, such as gravity.")
    ] = None,
    backend: BackendName = "auto",
    jobs: Annotated[int, typer.Option(help="Processes that fit candidates; -1 takes every core.")] = 1,
    report: Annotated[
        str | None, typer.Option("--report", help="Write a report, one HTML file.", metavar="OUT.html")
    ] = None,
    validate: Annotated[
        str | None,
        typer.Option(help="A record file: predict it by the models before and after.", metavar="RECORD"),
    ] = None,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper
    """
    from cvxshear import close_loop
    from cvxshear.report import loop_terminal, response_terminal
    from cvxshear.response import damping_of, models_of_loop, predict

    drawing = figures_for(figure)
    if report is not None:
        from cvxshear.report.html import write_report
    with progress("closing the loop", quiet):
        experiment, found = _measured(file)
        result = close_loop(experiment, effects=names(effects), assume=names(assume) or (), backend=backend, jobs=jobs)
        models = models_of_loop(result, mass_known=not _needs_mass(found))
        damping = damping_of(experiment, models.after, backend)
        tried = None if validate is None else predict(models, validate, backend)
    said = result.to_dict() if found is None else {**result.to_dict(), "modes": found.to_dict()}
    said |= {"damping": None if damping is None else damping.to_dict(), "model": models.to_dict()}
    if tried is not None:
        said["validation"] = tried.to_dict()
    if report is not None:
        write_report(result, report, shlex.join(["cvxshear", *typed]))
    if drawing is not None:
        drawing.save(drawing.residual(result), figure)
    rest = () if tried is None else ("", *response_terminal.prediction(tried))
    tables = (*loop_terminal.closure(result), *(() if tried is not None else _damping_of(damping)), *rest)
    deliver(said, out, lambda: [*_modes_of(found), *tables])


def _measured(file: str) -> tuple[Experiment, ModalResult | None]:
    """The experiment of a measurement file, or of the record that a record file names, with its modes."""
    from cvxshear import Experiment, load
    from cvxshear.formats.toml import is_record_file
    from cvxshear.modal import run

    if not is_record_file(file):
        return load(file), None
    found, declared = run(file)
    return Experiment.from_dict(declared, name=Path(file).stem), found


def _modes_of(found: ModalResult | None) -> Iterable[RenderableType]:
    from cvxshear.report import modal_terminal

    return () if found is None else (*modal_terminal.modes(found), "")


def _needs_mass(found: ModalResult | None) -> bool:
    """Whether a total mass of 1 kg stands for one that nobody gave."""
    return found is not None and any(finding.kind == "scale" for finding in found.findings)


def _damping_of(found: IdentifiedDamping | None) -> Iterable[RenderableType]:
    from cvxshear.report import response_terminal

    return () if found is None else ("", *response_terminal.damping(found))


def modes(
    record: Annotated[str, typer.Argument(help="A record file (TOML).", metavar="RECORD")],
    output: Annotated[
        str | None, typer.Option("--output", "-o", help="Write a measurement file here.", metavar="TOML")
    ] = None,
    uff: Annotated[str | None, typer.Option(help="Write the modes as a universal file here.", metavar="UFF")] = None,
    method: Annotated[
        str | None, typer.Option(help="era, okid, subspace or ssi; what suits the record where none is named.")
    ] = None,
    count: Annotated[int | None, typer.Option(help="How many modes; as many as stories where not given.")] = None,
    correct_clocks: Annotated[bool, typer.Option(help="Take clock offsets between the channels out.")] = False,
    accept_swapped: Annotated[bool, typer.Option(help="Go on where two channels look swapped.")] = False,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Identify natural frequencies, damping and mode shapes from a record.

    Example: cvxshear modes record.toml -o test.toml
    """
    from cvxshear.modal import run
    from cvxshear.report import modal_terminal

    with progress("identifying modes", quiet):
        result, _ = run(
            record,
            method=method,
            count=count,
            correct_clocks=correct_clocks,
            accept_swapped=accept_swapped,
            output=output,
            uff=uff,
        )
    deliver(result.to_dict(), out, lambda: modal_terminal.modes(result))


def backends(file: File, figure: FigureOut = None, quiet: Quiet = False, out: JsonOut = None) -> None:
    """Solve the same programs with every installed backend, and compare them to the closed form.

    Example: cvxshear backends paper
    """
    from cvxshear import compare_backends, load
    from cvxshear.report import terminal

    drawing = figures_for(figure)
    with progress("comparing backends", quiet):
        result = compare_backends(load(file))
    if drawing is not None:
        drawing.save(drawing.backend_differences(result), figure)
    deliver(result.to_dict(), out, lambda: terminal.comparison(result))
