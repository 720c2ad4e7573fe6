"""Commands for studies: plan a test, recompute the paper, run the noise study, compare the backends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

import cvxshear
from cvxshear.cli import options
from cvxshear.cli.output import deliver, numbers, progress
from cvxshear.cli.output import names as listed_names
from cvxshear.report import terminal
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.backends import Solver

Samples = Annotated[int, typer.Option(min=2)]


def plan(
    file: options.File,
    sensors: int | None = None,
    tests: int = 1,
    added_mass: str | None = None,
    modes: str | None = None,
    frequency_std: float | None = None,
    mode_shape_std: float | None = None,
    goal: str = "all",
    criterion: str = "D",
    fresh: bool = False,
    output: options.TomlOut = None,
    *,
    outputs: options.ResultOptions,
) -> None:
    """Choose the floors to measure and the masses to add, before a test.

    Example: cvxshear plan paper --fresh --tests 2 --added-mass 41

    Parameters
    ----------
    file
        Design values (a frame and nominal priors in TOML), a measurement file, or 'paper'.
    sensors
        How many floors can be measured; default: all.
    tests
        How many tests.
    added_mass
        kg that each floor can carry: one number, or one a floor with commas between.
    modes
        How many of the lowest modes will be identified, or which: 1,2,4.
    frequency_std
        Expected relative standard deviation of frequencies; default: the value in FILE's tests, or 0.002.
    mode_shape_std
        Expected standard deviation of shape entries over the largest; default: the value in FILE's tests, or 0.01.
    goal
        masses, stiffnesses or all.
    criterion
        D, A or E: geometric mean, root mean square, or worst combination.
    fresh
        Count nothing that FILE measured as known.
    output
        Write a measurement file to fill in.
    """
    from cvxshear import planning, screening

    outputs.check(planning.Plan)
    stds = {"frequency_std": frequency_std, "mode_shape_std": mode_shape_std}
    given = {name: value for name, value in stds.items() if value is not None}
    noise = planning.Declared(**given) if given else None
    wanted = numbers(modes, "--modes", "a number of modes such as 3, or which, such as 1,2,4", int)
    masses = numbers(added_mass, "--added-mass", "kg, such as 40, or one a floor, such as 0,20,40")
    measured = planning.measurement_of(file)
    doubts = None if measured is None else screening.refuse_mistakes(measured)
    with progress("planning", outputs.quiet):
        result = planning.plan(
            measured or file, sensors, tests, modes=_one_or_many(wanted), noise=noise,
            added_mass=_one_or_many(masses), goal=goal, criterion=criterion, fresh=fresh,
        )  # fmt: skip
    files = [] if output is None else [partial(planning.write_template, output, result)]
    outputs.deliver(result, *files, doubts=doubts)


def _one_or_many(found: list[Any] | None) -> Any:
    """Return the only number of a list with one entry, else the list."""
    return found[0] if found is not None and len(found) == 1 else found


def reproduce(
    backend: options.BackendName = "auto",
    samples: Samples = 10_000,
    seed: int = 2023,
    quiet: options.Quiet = False,
    out: options.JsonOut = None,
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
    from cvxshear.paper import reproduce as run

    with progress("reproducing the paper", quiet):
        result = run(backend, samples=tuple(sorted({100, samples})), seed=seed)
    deliver(result.to_dict(), out, lambda: terminal.shown(result))


def noise(
    samples: Samples = 2000,
    seed: int = 2023,
    methods: str = "two-stage,one-shot,efficient",
    jobs: int = 1,
    *,
    outputs: options.ResultOptions,
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
    """
    from cvxshear.paper import NoiseStudy, noise_study, paper_setups, six_story_study

    outputs.check(NoiseStudy)
    with progress("three stories", outputs.quiet) as advance:
        of_methods = tuple(listed_names(methods) or ())
        three = noise_study(paper_setups(), of_methods, samples, seed, jobs=jobs, progress=advance)
    with progress("six stories", outputs.quiet) as advance:
        six = six_story_study(samples, seed, jobs=jobs, progress=advance)
    said = {"three_story": three.to_dict(), "six_story": six.to_dict()}
    outputs.deliver(three, said=said, tables=lambda: [*terminal.shown(three), *terminal.shown(six)])


def backends(
    file: Annotated[str | None, typer.Argument(callback=options.input_files)] = None,
    names: str | None = None,
    repeats: int = 3,
    tolerance: float | None = None,
    quiet: options.Quiet = False,
    out: options.JsonOut = None,
) -> None:
    """List the backends; with a file, solve its programs with every one and compare them to the closed form.

    Example: cvxshear backends paper --repeats 10

    Parameters
    ----------
    file
        A measurement file (TOML), or 'paper'; default: list the installed backends.
    names
        Names of backends, separated by commas; default: all installed ones.
    repeats
        How often each program is solved; the shortest time counts.
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
    experiment = cvxshear.load(file)
    with progress("comparing backends", quiet):
        result = cvxshear.compare_backends(experiment, listed_names(names), repeats=repeats, tolerance=tolerance)
    title = experiment.report.title or experiment.name
    deliver(result.to_dict(), out, lambda: terminal.shown(result), title=title)


def _listed(backends: Sequence[Solver]) -> Iterator[RenderableType]:
    """Tabulate the installed backends with the version of their solver, and the way to install the others."""
    there = [(x.name, x.package or "this library", x.version or "–", x.through or "–") for x in backends if x.installed]
    yield terminal.plain_table("installed", "backend", "solver", "version", "called by", rows=there)
    if missing := [(each.name, each.how_to_get) for each in backends if not each.installed]:
        yield ""
        yield terminal.plain_table("not installed", "backend", "how to get it", words=(0, 1), rows=missing)
