"""The command that plans a test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cvxshear.cli.options import FigureOut, File, JsonOut, Quiet, TomlOut, UnitsOption
from cvxshear.cli.output import deliver, doubts_of, numbers, progress
from cvxshear.cli.written import Pictures
from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    from cvxshear.planning import TestNoise


def plan(
    file: File,
    sensors: int | None = None,
    tests: str = "1",
    added_mass: str | None = None,
    added_mass_total: float | None = None,
    modes: str | None = None,
    frequency_std: float | None = None,
    mode_shape_std: float | None = None,
    duration: float | None = None,
    excitation: str | None = None,
    damping: float | None = None,
    sensor_noise: float | None = None,
    goal: str = "all",
    criterion: str | None = None,
    backend: str = "clarabel",
    fresh: bool = False,
    loop: bool = False,
    configuration: str | None = None,
    output: TomlOut = None,
    units: UnitsOption = None,
    figure: FigureOut = None,
    quiet: Quiet = False,
    out: JsonOut = None,
) -> None:
    """Choose the floors to measure and the masses to add, before a test.

    Example: cvxshear plan paper --fresh --tests 2 --added-mass 41 --goal gravity

    Parameters
    ----------
    file
        Design values (a frame and nominal priors in TOML), a measurement file, a result's JSON, or 'paper'.
    sensors
        How many floors can be measured; all where not given.
    tests
        How many tests, or 'declared' for those of FILE as if they were still to come.
    added_mass
        kg that each floor can carry: one number, or one a floor with commas between.
    added_mass_total
        kg that one test can carry in all.
    modes
        How many of the lowest modes will be identified, or which: 1,2,4.
    frequency_std
        Expected relative standard deviation of frequencies; where neither this nor the next is given that of FILE's
        tests, and 0.002 where they state none.
    mode_shape_std
        Of shape entries, the largest being 1; where neither is given that of the tests as well, and 0.01 where they
        state none.
    duration
        Seconds recorded in each test, from which the noise follows instead.
    excitation
        ambient, shaker or hammer; with --duration.
    damping
        Fraction of critical; with --duration.
    sensor_noise
        Noise of a channel over its standard deviation; with --duration.
    goal
        masses, stiffnesses, all, or effects to distinguish: gravity,ground_spring@4=2000 (floor, size).
    criterion
        D (where the plan is for the frame), A, E or worst (where it is for effects).
    backend
        clarabel or scs.
    fresh
        Count nothing that FILE measured as known.
    loop
        Plan for the frame with the effects that the loop finds in FILE.
    configuration
        Test or state of FILE that is to be tested; its first configuration where not given.
    output
        Write a measurement file to fill in.
    """
    from cvxshear.planning import Plan, measurement_of, write_template
    from cvxshear.planning import plan as run
    from cvxshear.report import terminal
    from cvxshear.screening import in_json, refuse_mistakes
    from cvxshear.util.quantities import Units

    pictures, display = Pictures.named(Plan, plan=figure), Units.parse(units)
    noise = _noise((frequency_std, mode_shape_std), duration, (excitation, damping, sensor_noise))
    wanted = numbers(modes, "--modes", "a number of modes such as 3, or which, such as 1,2,4", int)
    masses = numbers(added_mass, "--added-mass", "kg, such as 40, or one a floor, such as 0,20,40")
    measured = measurement_of(file)
    doubts = None if measured is None else refuse_mistakes(measured)
    count = int(tests) if tests.strip().lstrip("-").isdigit() else tests
    with progress("planning", quiet):
        result = run(
            measured or file, sensors, count, modes=_one_or_many(wanted), noise=noise,
            added_mass=_one_or_many(masses),
            added_mass_total=added_mass_total, goal=goal, criterion=criterion, fresh=fresh, loop=loop,
            configuration=configuration, backend=backend,
        )  # fmt: skip
    files = pictures.of(result)
    if output is not None:
        files.append(lambda: write_template(output, result))
    said = {**result.to_dict(), **in_json(doubts)}
    deliver(said, out, lambda: [*doubts_of(doubts), *terminal.shown(result, display)], *files)


def _noise(
    declared: tuple[float | None, float | None],
    duration: float | None,
    record: tuple[str | None, float | None, float | None],
) -> TestNoise | None:
    """Make the expected noise from the options; None if no option concerns the noise."""
    from cvxshear.planning import Declared, Recorded

    stds = zip(("frequency_std", "mode_shape_std"), declared, strict=True)
    given = {name: value for name, value in stds if value is not None}
    parts = zip(("excitation", "damping", "sensor_noise"), record, strict=True)
    of_record = {name: value for name, value in parts if value is not None}
    if duration is None:
        if of_record:
            raise InputError("--excitation, --damping and --sensor-noise need --duration, the seconds recorded")
        return Declared(**given) if given else None
    if given:
        raise InputError("give --duration, from which the noise follows, or --frequency-std and --mode-shape-std")
    # The options have the names of the fields of `Recorded`, which checks the values; mypy cannot match their types.
    return Recorded(**{"excitation": "ambient", "duration": duration, **of_record})  # type: ignore[arg-type]


def _one_or_many(found: list[Any] | None) -> Any:
    """Return the only number of a list with one entry, else the list."""
    return found[0] if found is not None and len(found) == 1 else found
