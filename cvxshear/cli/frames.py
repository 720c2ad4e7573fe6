"""The commands for one test of a frame: its modes, its masses and stiffnesses, what the model lacks."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.output import (
    BackendName,
    FigureOut,
    File,
    JsonOut,
    MeasurementOut,
    Quiet,
    RecordIn,
    ReportOut,
    UniversalOut,
    deliver,
    figures_for,
    names,
    progress,
    typed,
)
from cvxshear.errors import InputError, UnsuitableError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear import Experiment
    from cvxshear.modal import ModalResult


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
    from cvxshear.report import screening_terminal, terminal
    from cvxshear.screening import refuse_mistakes

    drawing = figures_for(figure)
    experiment, start = load(file), _numbers(initial_mass)
    doubts = refuse_mistakes(experiment)
    named = method or ("efficient" if start is None else "two-stage")
    result = run(
        experiment, method=named, backend=backend, initial_mass=start, tolerance=tolerance, accelerate=accelerate
    )
    beside = None
    if method is None and named == "efficient" and out != "-":
        with suppress(UnsuitableError):
            beside = run(experiment, method="two-stage", backend=backend)
    said = {**result.to_dict(), "warnings": [item.to_dict() for item in doubts]}
    files = [] if drawing is None else [lambda: drawing.save(drawing.frame(result), figure)]
    deliver(
        said, out, lambda: [*screening_terminal.warnings(doubts), *terminal.identification(result, beside)], *files
    )


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
    report: ReportOut = None,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper
    """
    from cvxshear import close_loop
    from cvxshear.report import loop_terminal, screening_terminal
    from cvxshear.screening import refuse_mistakes

    drawing = figures_for(figure)
    if report is not None:
        from cvxshear.report.html import write_report
    with progress("closing the loop", quiet):
        experiment, found = measured(file)
        doubts = refuse_mistakes(experiment)
        result = close_loop(experiment, effects=names(effects), assume=names(assume) or (), backend=backend, jobs=jobs)
    said = {**result.to_dict(), "warnings": [item.to_dict() for item in doubts]}
    if found is not None:
        said["modes"] = found.to_dict()
    files: list[Callable[[], None]] = []
    if report is not None:
        files.append(lambda: write_report(result, report, shlex.join(["cvxshear", *typed])))
    if drawing is not None:
        files.append(lambda: drawing.save(drawing.residual(result), figure))
    deliver(
        said,
        out,
        lambda: [*_modes_of(found), *screening_terminal.warnings(doubts), *loop_terminal.closure(result)],
        *files,
    )


def measured(file: str, *, accept_swapped: bool = False) -> tuple[Experiment, ModalResult | None]:
    """The experiment of a measurement file, or of the record that a record file names, with its modes."""
    from cvxshear import Experiment, load
    from cvxshear.formats.modes import modes_from_file
    from cvxshear.formats.reading import named_after
    from cvxshear.formats.toml import is_record_file

    if not is_record_file(file):
        return load(file), None
    found, declared = modes_from_file(file, accept_swapped=accept_swapped)
    return Experiment.from_dict(declared, name=named_after(file)), found


def _modes_of(found: ModalResult | None) -> Iterable[RenderableType]:
    from cvxshear.report import modal_terminal

    return () if found is None else (*modal_terminal.modes(found), "")


def modes(
    record: RecordIn,
    output: MeasurementOut = None,
    uff: UniversalOut = None,
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
    from cvxshear.formats.modes import modes_from_file, write_modes
    from cvxshear.formats.uff import write_uff
    from cvxshear.report import modal_terminal

    with progress("identifying modes", quiet):
        result, declared = modes_from_file(
            record, method=method, count=count, correct_clocks=correct_clocks, accept_swapped=accept_swapped
        )
    files: list[Callable[[], None]] = []
    if output is not None:
        frame, priors, (state,) = declared["frame"], declared.get("prior", ()), declared["configuration"]
        files.append(lambda: write_modes(output, result, frame, priors=priors, added_mass=state.get("added_mass")))
    if uff is not None:
        files.append(lambda: write_uff(uff, result))
    deliver(result.to_dict(), out, lambda: modal_terminal.modes(result), *files)

