"""The command line."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console, RenderableType

from cvxshear.errors import CvxshearError, InputError, NoSolutionError, UnsuitableError
from cvxshear.report.files import write_whole
from cvxshear.typing import Json

if TYPE_CHECKING:
    from cvxshear import Experiment
    from cvxshear.modal import ModalResult

app = typer.Typer(
    name="cvxshear",
    help="Floor masses and story stiffnesses of shear-type frames from measured modes, and what the shear model lacks.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

File = Annotated[
    str, typer.Argument(help="A measurement file (TOML), or 'paper' for the built-in example.", metavar="FILE")
]
JsonOut = Annotated[
    str | None,
    typer.Option("--json", help="Write the result as JSON to this file, '-' for standard output.", metavar="OUT"),
]
FigureOut = Annotated[
    str | None, typer.Option("--figure", help="Draw into this file: .svg, .png or .pdf.", metavar="OUT")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
BackendName = Annotated[
    str, typer.Option("--backend", help="Which solver; 'cvxshear backends FILE' lists them.", metavar="NAME")
]


_typed: list[str] = []
"""What stood on the command line; a report says how it was made."""


def _show_version(asked: bool) -> None:
    if asked:
        from cvxshear import __version__  # noqa: PLC0415

        typer.echo(f"cvxshear {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    pass


def show(parts: Iterable[RenderableType]) -> None:
    """Print tables; plain and unwrapped where the output is not a terminal."""
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=200, no_color=True)
    for part in parts:
        console.print(part)


def deliver(result: Json, out: str | None, tables: Callable[[], Iterable[RenderableType]]) -> None:
    """JSON alone on standard output for '-'; else tables for people, and JSON into a file where one is named."""
    if out == "-":
        typer.echo(to_json(result))
        return
    if out is not None:
        write_whole(out, to_json(result) + "\n")
    show(tables())


def to_json(result: Json) -> str:
    """The result as JSON; nan cannot stand in JSON and has no place in a result."""
    return json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False)


def figures_for(*paths: str | None) -> ModuleType | None:
    """The figures, where one is asked for; a wrong ending or a missing package is told before anything runs."""
    asked = [path for path in paths if path is not None]
    if not asked:
        return None
    try:
        from cvxshear.report import figures  # noqa: PLC0415
        from cvxshear.report.figures.output import kind_of  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f"--figure needs {error.name}: pip install 'cvxshear[plot]'") from error
    for path in asked:
        kind_of(path)
    return figures


@app.command()
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
    from cvxshear import identify as run  # noqa: PLC0415
    from cvxshear import load  # noqa: PLC0415
    from cvxshear.report import terminal  # noqa: PLC0415

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
    if drawing is not None:
        drawing.save(drawing.frame(result), figure)
    deliver(result.to_dict(), out, lambda: terminal.identification(result, beside))


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


@app.command()
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
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper
    """
    from cvxshear import close_loop  # noqa: PLC0415
    from cvxshear.report import loop_terminal  # noqa: PLC0415

    drawing = figures_for(figure)
    if report is not None:
        from cvxshear.report.html import write_report  # noqa: PLC0415
    with progress("closing the loop", quiet):
        experiment, found = _measured(file)
        result = close_loop(
            experiment, effects=_names(effects), assume=_names(assume) or (), backend=backend, jobs=jobs
        )
    said = result.to_dict() if found is None else {**result.to_dict(), "modes": found.to_dict()}
    if report is not None:
        write_report(result, report, shlex.join(["cvxshear", *_typed]))
    if drawing is not None:
        drawing.save(drawing.residual(result), figure)
    deliver(said, out, lambda: [*_modes_of(found), *loop_terminal.closure(result)])


@app.command()
def reproduce(
    backend: BackendName = "auto",
    samples: Annotated[
        int, typer.Option(help="Samples of the larger noise study, beside the paper's 100.", min=2)
    ] = 10_000,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 2023,
    figure: FigureOut = None,
    out: JsonOut = None,
) -> None:
    """Print the paper's figures beside recomputed ones, with the difference.

    Example: cvxshear reproduce
    """
    from cvxshear.paper import reproduce as run  # noqa: PLC0415
    from cvxshear.paper.terminal import render  # noqa: PLC0415

    drawing = figures_for(figure)
    result = run(backend, samples=tuple(sorted({100, samples})), seed=seed)
    if drawing is not None:
        drawing.save(_mass_iteration(drawing), figure)
    deliver(result.to_dict(), out, lambda: [render(result)])


@app.command()
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
    out: JsonOut = None,
) -> None:
    """Identify natural frequencies, damping and mode shapes from a record.

    Example: cvxshear modes record.toml -o test.toml
    """
    from cvxshear.modal import run  # noqa: PLC0415
    from cvxshear.report import modal_terminal  # noqa: PLC0415

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


def _mass_iteration(drawing: ModuleType) -> Any:
    """The paper's Fig. 4: errors of the masses in each iteration, from its two initial masses."""
    from cvxshear import identify as run  # noqa: PLC0415
    from cvxshear.paper import tables  # noqa: PLC0415
    from cvxshear.paper.three_story import ThreeStory  # noqa: PLC0415

    of = ThreeStory("auto")
    found = [run(of.experiment, "two-stage", initial_mass=start) for start in tables.INITIAL_MASS.values()]
    return drawing.convergence(*found, true_mass=of.truth.floor_mass)


study = typer.Typer(help="Many identifications at once.", no_args_is_help=True)
app.add_typer(study, name="study")


@study.command()
def noise(
    samples: Annotated[int, typer.Option(help="Samples of each noise level and method.", min=2)] = 2000,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 2023,
    methods: Annotated[str, typer.Option(help="Methods, commas between.")] = "two-stage,one-shot,efficient",
    figure: FigureOut = None,
    boxes: Annotated[str | None, typer.Option(help="Draw box plots (Fig. 5) into this file.", metavar="OUT")] = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Print the scatter of each method under noise beside the Cramer-Rao bound: Table 3, Figs. 5 and 6, six stories.

    Example: cvxshear study noise --samples 200
    """
    from cvxshear.studies import noise_study, paper_setups, six_story_study  # noqa: PLC0415
    from cvxshear.studies.noise_table import render  # noqa: PLC0415

    drawing = figures_for(figure, boxes)
    with progress("three stories", quiet) as advance:
        three = noise_study(paper_setups(), tuple(_names(methods) or ()), samples, seed, progress=advance)
    with progress("six stories", quiet) as advance:
        six = six_story_study(samples, seed, progress=advance)
    if drawing is not None and figure is not None:
        drawing.save(drawing.noise_variation(three), figure)
    if drawing is not None and boxes is not None:
        drawing.save(drawing.noise_boxes(three), boxes)
    deliver({"three_story": three.to_dict(), "six_story": six.to_dict()}, out, lambda: [render(three), render(six)])


@contextmanager
def progress(title: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on standard error, only where that is a terminal and nobody asked for quiet."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import Progress  # noqa: PLC0415

    with Progress(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def _measured(file: str) -> tuple[Experiment, ModalResult | None]:
    """The experiment of a measurement file, or of the record that a record file names, with its modes."""
    from cvxshear import Experiment, load  # noqa: PLC0415
    from cvxshear.formats.toml import is_record_file  # noqa: PLC0415
    from cvxshear.modal import run  # noqa: PLC0415

    if not is_record_file(file):
        return load(file), None
    found, declared = run(file)
    return Experiment.from_dict(declared, name=Path(file).stem), found


def _modes_of(found: ModalResult | None) -> Iterable[RenderableType]:
    from cvxshear.report import modal_terminal  # noqa: PLC0415

    return () if found is None else (*modal_terminal.modes(found), "")


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


@app.command()
def backends(file: File, figure: FigureOut = None, out: JsonOut = None) -> None:
    """Solve the same programs with every installed backend, and compare them to the closed form.

    Example: cvxshear backends paper
    """
    from cvxshear import compare_backends, load  # noqa: PLC0415
    from cvxshear.report import terminal  # noqa: PLC0415

    drawing = figures_for(figure)
    result = compare_backends(load(file))
    if drawing is not None:
        drawing.save(drawing.backend_differences(result), figure)
    deliver(result.to_dict(), out, lambda: terminal.comparison(result))


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; 0 done, 1 no solution, 2 bad input, and no traceback for either."""
    status: Any = 0
    _typed[:] = sys.argv[1:] if arguments is None else arguments
    try:
        status = app(args=arguments, standalone_mode=False)
    except NoSolutionError as error:
        _complain(error)
        status = 1
    except CvxshearError as error:
        _complain(error)
        status = 2
    except typer.Abort:
        status = 130
    except Exception as error:
        # Typer's own complaints about options know how to show themselves.
        if not hasattr(error, "show") or not hasattr(error, "exit_code"):
            raise
        error.show()
        status = error.exit_code
    sys.exit(status if isinstance(status, int) else 0)


def _complain(error: CvxshearError) -> None:
    sys.stderr.write(f"cvxshear: {error}\n")


if __name__ == "__main__":
    main()
