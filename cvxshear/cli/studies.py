"""Commands for studies: recompute the paper's tables, run the noise study, compare all backends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.options import FIGURES, BackendName, FigureOut, JsonOut, Quiet, input_files, writes
from cvxshear.cli.output import deliver, progress
from cvxshear.cli.output import names as listed_names
from cvxshear.cli.written import Pictures
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.backends import Solver

Samples = Annotated[int, typer.Option(min=2)]


def reproduce(
    backend: BackendName = "auto",
    samples: Samples = 10_000,
    seed: int = 2023,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Print the paper's figures beside recomputed ones, with the difference.

    Example: cvxshear reproduce

    Parameters
    ----------
    samples
        Samples of the larger noise study, beside the paper's 100.
    seed
        Seed of the noise.
    """
    from cvxshear import Identification, identify
    from cvxshear.paper import reproduce as run
    from cvxshear.paper.reproduction import exact_modes
    from cvxshear.paper.setups import three_story
    from cvxshear.paper.tables import PRINTED
    from cvxshear.report import terminal

    pictures = Pictures.named(Identification, convergence=figure)
    with progress("reproducing the paper", quiet):
        result = run(backend, samples=tuple(sorted({100, samples})), seed=seed)
    files = []
    if pictures:
        # The paper's Fig. 4: errors of the masses in each iteration, from its two initial masses.
        found = [identify(exact_modes(), "two-stage", initial_mass=start) for start in PRINTED["initial_mass"].values()]
        files = pictures.of(*found, true_mass=three_story(0.01).floor_mass)
    deliver(result.to_dict(), out, lambda: terminal.shown(result), *files)


def noise(
    samples: Samples = 2000,
    seed: int = 2023,
    methods: str = "two-stage,one-shot,efficient",
    jobs: int = 1,
    figure: FigureOut = None,
    boxes: Annotated[str | None, writes("--boxes", endings=FIGURES)] = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Print the scatter of each method under noise beside the Cramer-Rao bound: Table 3, Figs. 5 and 6, six stories.

    Example: cvxshear study noise --samples 200

    Parameters
    ----------
    samples
        Samples of each noise level and method.
    seed
        Seed of the noise.
    methods
        Methods, commas between.
    jobs
        Processes; -1 takes every core.
    boxes
        Draw box plots (Fig. 5) into this file.
    """
    from cvxshear.paper import NoiseStudy, noise_study, paper_setups, six_story_study
    from cvxshear.report import terminal

    pictures = Pictures.named(NoiseStudy, variation=figure, boxes=boxes)
    with progress("three stories", quiet) as advance:
        of_methods = tuple(listed_names(methods) or ())
        three = noise_study(paper_setups(), of_methods, samples, seed, jobs=jobs, progress=advance)
    with progress("six stories", quiet) as advance:
        six = six_story_study(samples, seed, jobs=jobs, progress=advance)
    said = {"three_story": three.to_dict(), "six_story": six.to_dict()}
    deliver(said, out, lambda: [*terminal.shown(three), *terminal.shown(six)], *pictures.of(three))


def backends(
    file: Annotated[str | None, typer.Argument(callback=input_files)] = None,
    names: str | None = None,
    repeats: int = 3,
    tolerance: float | None = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """List the backends; with a file, solve its programs with every one and compare them to the closed form.

    Example: cvxshear backends paper --repeats 10

    Parameters
    ----------
    file
        A measurement file (TOML), or 'paper'; without one: what is installed.
    names
        Which backends, commas between; all that are installed where not given.
    repeats
        Solves of each program of which the fastest counts.
    tolerance
        Accuracy asked of the solvers, in place of their settings here.
    """
    if file is None:
        given = {"--names": names, "--tolerance": tolerance}
        for option, value in given.items():
            if value is not None:
                raise InputError(f"{option} needs programs: name a measurement file, or 'paper'")
        from cvxshear.backends import listed

        there = listed()
        deliver({"backends": [each.to_dict() for each in there]}, out, lambda: _listed(there))
        return
    from cvxshear import compare_backends, load
    from cvxshear.report import terminal

    experiment = load(file)
    with progress("comparing backends", quiet):
        result = compare_backends(experiment, listed_names(names), repeats=repeats, tolerance=tolerance)
    title = experiment.report.title or experiment.name
    deliver(result.to_dict(), out, lambda: terminal.shown(result), title=title)


def _listed(backends: Sequence[Solver]) -> Iterator[RenderableType]:
    """Tabulate the installed backends with the version of their solver, and the way to install the others."""
    from cvxshear.report.terminal import plain_table

    there = [(x.name, x.package or "this library", x.version or "–", x.through or "–") for x in backends if x.installed]
    yield plain_table("installed", "backend", "solver", "version", "called by", rows=there)
    if missing := [(each.name, each.how_to_get) for each in backends if not each.installed]:
        yield ""
        yield plain_table("not installed", "backend", "how to get it", words=(0, 1), rows=missing)
