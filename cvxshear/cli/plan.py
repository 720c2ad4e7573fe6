"""The command that plans a test."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from cvxshear.cli.checked import input_files
from cvxshear.cli.output import FigureOut, JsonOut, Quiet, UnitsOption, deliver, figures_for, progress, writes
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from cvxshear.planning import TestNoise

Number = TypeVar("Number")


def plan(
    file: Annotated[
        str,
        typer.Argument(
            help="Design values (a frame and nominal priors in TOML), a measurement file, a result's JSON, or 'paper'.",
            metavar="FILE",
            callback=input_files,
        ),
    ],
    sensors: Annotated[int | None, typer.Option(help="How many floors can be measured; all where not given.")] = None,
    tests: Annotated[
        str, typer.Option(help="How many tests, or 'declared' for those of FILE as if they were still to come.")
    ] = "1",
    added_mass: Annotated[
        str | None, typer.Option(help="kg that each floor can carry: one number, or one a floor with commas between.")
    ] = None,
    added_mass_total: Annotated[float | None, typer.Option(help="kg that one test can carry in all.")] = None,
    modes: Annotated[
        str | None, typer.Option(help="How many of the lowest modes will be identified, or which: 1,2,4.")
    ] = None,
    frequency_std: Annotated[
        float | None, typer.Option(help="Expected relative standard deviation of frequencies; 0.002 where not given.")
    ] = None,
    mode_shape_std: Annotated[
        float | None, typer.Option(help="Of shape entries, the largest being 1; 0.01 where not given.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Seconds recorded in each test, from which the noise follows instead.")
    ] = None,
    excitation: Annotated[str | None, typer.Option(help="ambient, shaker or hammer; with --duration.")] = None,
    damping: Annotated[float | None, typer.Option(help="Fraction of critical; with --duration.")] = None,
    sensor_noise: Annotated[
        float | None, typer.Option(help="Noise of a channel over its standard deviation; with --duration.")
    ] = None,
    goal: Annotated[
        str,
        typer.Option(
            "--for",
            help="masses, stiffnesses, all, or effects to distinguish: gravity,ground_spring@4=2000 (floor, size).",
        ),
    ] = "all",
    criterion: Annotated[
        str | None, typer.Option(help="D (where the plan is for the frame), A, E or worst (where it is for effects).")
    ] = None,
    solver: Annotated[str, typer.Option(help="clarabel or scs.")] = "clarabel",
    fresh: Annotated[bool, typer.Option("--fresh", help="Count nothing that FILE measured as known.")] = False,
    loop: Annotated[
        bool, typer.Option("--loop", help="Plan for the frame with the effects that the loop finds in FILE.")
    ] = False,
    state: Annotated[
        str | None, typer.Option(help="State of the frame in FILE that is to be tested; its first where not given.")
    ] = None,
    output: Annotated[
        str | None,
        writes("--output", "-o", what="Write a measurement file to fill in.", metavar="TOML", endings=(".toml",)),
    ] = None,
    units: UnitsOption = None,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Choose the floors to measure and the masses to add, before a test.

    Example: cvxshear plan paper --fresh --tests 2 --added-mass 41 --for gravity
    """
    from cvxshear.planning import measurement_of, write_template
    from cvxshear.planning import plan as run
    from cvxshear.report import terminal
    from cvxshear.screening import in_json, refuse_mistakes
    from cvxshear.util.quantities import Units

    drawing, display = figures_for(figure), Units.parse(units)
    noise = _noise((frequency_std, mode_shape_std), duration, (excitation, damping, sensor_noise))
    measured = measurement_of(file)
    doubts = None if measured is None else refuse_mistakes(measured)
    with progress("planning", quiet):
        result = run(
            measured or file, sensors, _count(tests), modes=_modes(modes), noise=noise, added_mass=_masses(added_mass),
            added_mass_total=added_mass_total, goal=goal, criterion=criterion, fresh=fresh, loop=loop, state=state,
            solver=solver,
        )  # fmt: skip
    files: list[Callable[[], None]] = []
    if output is not None:
        files.append(lambda: write_template(output, result))
    if drawing is not None:
        files.append(lambda: drawing.save(drawing.plan(result), figure))
    said = {**result.to_dict(), **in_json(doubts)}
    deliver(said, out, lambda: [*terminal.doubts(doubts or ()), *terminal.shown(result, display)], *files)


def _noise(
    declared: tuple[float | None, float | None],
    duration: float | None,
    record: tuple[str | None, float | None, float | None],
) -> TestNoise:
    """Make the noise that the options stand for."""
    from cvxshear.planning import Declared, Recorded

    stds = zip(("frequency_std", "mode_shape_std"), declared, strict=True)
    given = {name: value for name, value in stds if value is not None}
    parts = zip(("kind", "damping", "noise"), record, strict=True)
    of_record = {name: value for name, value in parts if value is not None}
    if duration is None:
        if of_record:
            raise InputError("--excitation, --damping and --sensor-noise need --duration, the seconds recorded")
        return Declared(**given)
    if given:
        raise InputError("give --duration, from which the noise follows, or --frequency-std and --mode-shape-std")
    # The options go by the names of its fields, and it checks their values; mypy cannot know which is which.
    return Recorded(**{"kind": "ambient", "duration": duration, **of_record})  # type: ignore[arg-type]


def _count(text: str) -> int | str:
    return int(text) if text.strip().lstrip("-").isdigit() else text


def _modes(text: str | None) -> int | list[int] | None:
    """How many modes, or which."""
    if text is None:
        return None
    found = _numbers(text, "--modes", int, "a number of modes such as 3, or which, such as 1,2,4")
    return found[0] if "," not in text else found


def _masses(text: str | None) -> float | list[float] | None:
    """Say what each floor can carry."""
    if text is None:
        return None
    found = _numbers(text, "--added-mass", float, "kg, such as 40, or one a floor, such as 0,20,40")
    return found[0] if "," not in text else found


def _numbers(text: str, option: str, kind: Callable[[str], Number], right: str) -> list[Number]:
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} must be {right}, not {text!r}") from None
