"""Commands for a frame: identify it, find the missing physical effects, predict and reconstruct its motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import cvxshear
from cvxshear.cli import options
from cvxshear.cli.modes_and_check import DOUBT_STATUS, MISTAKE_STATUS, measured, records_in_json, tables_of
from cvxshear.cli.output import doubts_of, names, numbers, progress, show, used
from cvxshear.report import terminal
from cvxshear.util.errors import NoScaleError, UnsuitableError
from cvxshear.util.results import as_json

if TYPE_CHECKING:
    from cvxshear.response import Models, Reconstruction, RecordPrediction
    from cvxshear.screening import FileFinding


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
        # A record has no declared mode numbers: the loop compares possible numbers together with the effects.
        result = screening.close_loop(
            experiment,
            effects=names(effects),
            assume=names(assume) or (),
            backend=backend,
            weighed=[each.name for each in experiment.configurations if found],
        )
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

    def screened(self) -> tuple[Models, Sequence[FileFinding]]:
        """Close the loop on a measurement; return its models and warnings."""
        from cvxshear import response, screening
        from cvxshear.response.sources import load_unscaled

        try:
            experiment, found = measured([self.file])
        except NoScaleError:
            # Only forces need the scale of the masses; the result leaves forces out.
            experiment, found = load_unscaled(self.file), []
        # A record has no declared mode numbers: the loop compares possible numbers together with the effects.
        weighed = [each.name for each in experiment.configurations if found]
        assumed = names(self.assume) or ()
        result = screening.close_loop(experiment, assume=assumed, backend=self.backend, weighed=weighed)
        return response.models_of_loop(result), result.warnings

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
        source, doubts = motion.screened()
        result = response.predict(source, motion.record, **motion.model)
    outputs.deliver(result, *motion.written(result), doubts=doubts)


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
        source, doubts = motion.screened()
        result = response.reconstruct(
            source, motion.record, fit=fit, leave_out=leave_out, progress=advance, **motion.model
        )
    outputs.deliver(result, *motion.written(result), doubts=doubts)


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
