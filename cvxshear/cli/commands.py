"""Commands for a frame and for studies.

They identify a frame, find the missing physical effects, predict and reconstruct motion, plan a test, recompute the
paper, run the noise study and compare the backends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import cvxshear
from cvxshear.cli import options, output
from cvxshear.cli.modes_and_check import DOUBT_STATUS, MISTAKE_STATUS, measured, records_in_json, tables_of
from cvxshear.cli.output import deliver, doubts_of, names, numbers, progress, show, used
from cvxshear.report import terminal
from cvxshear.util.errors import InputError, UnsuitableError
from cvxshear.util.results import as_json

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.backends import Solver
    from cvxshear.response import Models, Reconstruction, RecordPrediction


def identify(
    file: options.File,
    method: str | None = None,
    backend: options.BackendName = "auto",
    initial_mass: str | None = None,
    tolerance: float = 1e-6,
    *,
    outputs: options.ResultOptions,
) -> None:
    """Identify floor masses and story stiffnesses.

    Example: cvxshear identify paper --method two-stage

    Parameters
    ----------
    file
        A measurement file (TOML), or 'paper' for the built-in example.
    method
        efficient (the default), two-stage, one-shot, berman or qi. Floors that turn take efficient and one-shot.
    initial_mass
        Where the mass iteration starts, kg, such as 9.5,7.5,5.5; means two-stage by itself.
    tolerance
        At which relative correction the mass iteration stops.
    """
    # The solvers load slowly, and the help does not need them.
    from cvxshear import screening

    outputs.check(cvxshear.Identification)
    experiment, start = cvxshear.load(file), numbers(initial_mass, "--initial-mass")
    doubts = screening.refuse_mistakes(experiment)
    method = method or (None if start is None else "two-stage")
    result = cvxshear.identify(experiment, method=method, backend=backend, initial_mass=start, tolerance=tolerance)
    outputs.deliver(result, doubts=doubts)


def loop(
    sources: options.Files,
    effects: str | None = None,
    assume: str | None = None,
    backend: options.BackendName = "auto",
    jobs: int = 1,
    strict: bool = False,
    *,
    outputs: options.ResultOptions,
) -> None:
    """Find the physical effect that the shear model lacks, and report the error before and after.

    Example: cvxshear loop paper

    Parameters
    ----------
    sources
        A measurement file (TOML), 'paper' for the built-in example, or record files and patterns of them.
    effects
        Which effects to look for, commas between; default: all. 'list' prints them.
    assume
        Effects that are in the model from the start, such as gravity.
    jobs
        Processes that identify the modes of records; -1 takes every core.
    strict
        Status 3 where the verdict is not one to rely on, such as ambiguous.
    """
    from cvxshear import effects as known
    from cvxshear import response, screening
    from cvxshear.loop.results import VERDICTS

    if effects == options.LIST:
        rows = ((effect.name, effect.summary) for effect in known.catalogue())
        show([terminal.plain_table("Effects", "name", "what it is", words=(0, 1), rows=rows)])
        raise typer.Exit
    outputs.check(cvxshear.LoopResult)
    with progress("closing the loop", outputs.quiet) as advance:
        experiment, found = measured(sources, jobs=jobs, progress=advance)
        # A record has no declared mode numbers: the loop weighs the possible ones with the effects.
        recorded = [each.name for each in experiment.configurations if found]
        result = screening.close_loop(experiment, names(effects), names(assume) or (), backend, weighed=recorded)
        models = response.models_of_loop(result)
        damping, without = None, []
        try:
            damping = response.damping_of(experiment, models.after, backend)
        except UnsuitableError as error:
            # The verdict is valid without the damping.
            without = [f"without its damping and response: {error}"]
    said = {
        **result.to_dict(),
        "information": [*result.information, *without],
        **({"modes": found[0].modes.to_dict()} if len(found) == 1 else {}),
        **({"records": records_in_json(found)} if len(found) > 1 else {}),
        "damping": as_json(damping),
    }
    outputs.deliver(
        result,
        said=said,
        tables=lambda: [
            *tables_of(found),
            *doubts_of(result.warnings),
            *terminal.shown(result),
            *([] if damping is None else ["", *terminal.shown(damping)]),
            *without,
        ],
    )
    if strict and not VERDICTS[result.verdict].certain:
        raise typer.Exit(DOUBT_STATUS)


@dataclass(frozen=True)
class Motion:
    """Options of commands that model the motion of a frame in a record.

    Parameters
    ----------
    file
        What the model is made of: a measurement file or a record file.
    damping
        modal, story or rayleigh; default: the kind that FILE declares.
    configuration
        Which test or state; default: the one with the record's added mass.
    assume : NAME,...
        Effects in the model from the start.
    detrend
        Take the straight line through each recorded acceleration off.
    series
        Write the time series here: .csv, .mat or .npz.
    """

    file: options.File
    record: Annotated[str, typer.Option("--record", callback=options.input_files)]
    backend: options.BackendName = "auto"
    damping: str | None = None
    configuration: str | None = None
    assume: str | None = None
    detrend: bool = True
    series: options.SeriesOut = None

    def written(self, result: RecordPrediction | Reconstruction) -> Iterator[options.Writer]:
        """Yield the function that writes the requested time series of a result."""
        from cvxshear.report.responses import write_series

        if self.series is not None:
            yield partial(write_series, self.series, result)

    def closed(self) -> Models:
        """Close the loop on a measurement; return its models."""
        from cvxshear.backends import get
        from cvxshear.response.sources import models_of

        return models_of(self.file, get(self.backend), names(self.assume) or ())

    @property
    def model(self) -> dict[str, Any]:
        """Keywords of `predict` and `reconstruct`."""
        shared = ("backend", "damping", "configuration", "detrend")
        return {name: getattr(self, name) for name in shared}


def predict(*, motion: Motion, outputs: options.ResultOptions) -> None:
    """Predict how every floor answers to a record, beside what was measured.

    Example: cvxshear predict frame.toml --record earthquake.toml

    Parameters
    ----------
    record
        A record file: the base motion or force, and responses to compare with.
    """
    from cvxshear import response

    outputs.check(response.RecordPrediction)
    with progress("predicting", outputs.quiet):
        models = motion.closed()
        result = response.predict(models, motion.record, **motion.model)
    outputs.deliver(result, *motion.written(result), doubts=models.warnings)


def reconstruct(*, motion: Motion, fit: bool = True, leave_out: bool = True, outputs: options.ResultOptions) -> None:
    """Find how every floor moved, from the floors that carry sensors: drifts, forces, and whether a story changed.

    Example: cvxshear reconstruct frame.toml --record earthquake.toml --report drifts.html

    Parameters
    ----------
    record
        A record file: floors that carry sensors, with gaps or not, and the base motion.
    fit
        Fit the frame to the record; otherwise it stays as identified.
    leave_out
        Leave each sensor out in turn and predict it from the others.
    """
    from cvxshear import response

    outputs.check(response.Reconstruction)
    with progress("reconstructing", outputs.quiet) as advance:
        models = motion.closed()
        result = response.reconstruct(
            models, motion.record, fit=fit, leave_out=leave_out, progress=advance, **motion.model
        )
    outputs.deliver(result, *motion.written(result), doubts=models.warnings)


def history(
    folder: Annotated[str, typer.Argument(metavar="FOLDER")],
    backend: options.BackendName = "auto",
    *,
    outputs: options.ResultOptions,
) -> None:
    """Find the changes of stiffness over many tests of one frame: steps, slopes, temperature and amplitude.

    A file that cannot be used does not keep the others from being read; the status is 2 then.

    Example: cvxshear history monitoring --report history.html

    Parameters
    ----------
    folder
        Measurement files (TOML) of one frame; each configuration is a test with its date, temperature and amplitude.
    """
    from cvxshear import screening

    outputs.check(screening.History)
    used.extend(map(str, sorted(Path(folder).glob("*.toml"))))
    with progress("reading the tests", outputs.quiet):
        result = cvxshear.history(folder, backend)
    outputs.deliver(result)
    if result.skipped:
        raise typer.Exit(MISTAKE_STATUS)


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
        of_methods = tuple(names(methods) or ())
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
        chosen = output.names(names) or None
        result = cvxshear.compare_backends(experiment, chosen, repeats=repeats, tolerance=tolerance)
    title = experiment.report.title or experiment.name
    deliver(result.to_dict(), out, lambda: terminal.shown(result), title=title)


def _listed(backends: Sequence[Solver]) -> Iterator[RenderableType]:
    """Tabulate the installed backends with the version of their solver, and the way to install the others."""
    there = [(x.name, x.package or "this library", x.version or "–", x.through or "–") for x in backends if x.installed]
    yield terminal.plain_table("installed", "backend", "solver", "version", "called by", rows=there)
    if missing := [(each.name, each.how_to_get) for each in backends if not each.installed]:
        yield ""
        yield terminal.plain_table("not installed", "backend", "how to get it", words=(0, 1), rows=missing)
