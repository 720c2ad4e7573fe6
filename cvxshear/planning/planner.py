"""Plan a test: choose the floors to measure and the masses to add.

The masses are chosen from a grid of tests. Floors and masses are chosen in turn until they stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.planning.choice import SOLVERS, Choice, choose
from cvxshear.planning.criteria import Criterion, criterion_named
from cvxshear.planning.design import UNKNOWN_STD, Design, read_design
from cvxshear.planning.expected_noise import Declared, TestNoise
from cvxshear.planning.results import ExpectedAccuracy, Plan, chances
from cvxshear.planning.tested_model import AveragedModel, Test, TestModel, target
from cvxshear.util import checks
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

GOALS = {"masses": ("floor_mass",), "stiffnesses": ("story_stiffness",), "all": ("floor_mass", "story_stiffness")}
"""Goals of a plan other than effects, each with the quantities to determine."""

DECLARED = "declared"
"""Value of `tests` for the tests that the file declares, instead of a number."""

USUAL_MODES = 4
"""Default number of modes of a plan: ambient tests of buildings commonly give four."""

MOST_TESTS = 50
"""Largest number of tests; the time of the program grows with it."""

PARTS = (0.5, 1.0)
"""Added masses of the grid, as fractions of the limit of a floor."""


@dataclass(frozen=True, eq=False)
class MassLimits:
    """Limits of the added masses.

    Parameters
    ----------
    floor : ndarray, shape (N,)
        Limit of each floor, kg; zero if the floor cannot carry added mass.
    total : float
        Limit of one test, kg.
    """

    floor: Floats
    total: float

    @staticmethod
    def of(floor: object, total: object, stories: int) -> MassLimits:
        """Read the limits from options: one number or one per floor, and a number or None for the total."""
        if floor is None:
            if total is not None:
                raise InputError("a limit of the added mass in all needs one of each floor: give added_mass as well")
            return MassLimits(np.zeros(stories), 0.0)
        each = checks.one_or_many(floor, "added_mass", stories, each=", one a floor", least=0.0)
        whole = float(each.sum()) if total is None else checks.number(total, "added_mass_total", least=0.0)
        return MassLimits(each, min(whole, float(each.sum())))

    @property
    def any(self) -> bool:
        """Whether any mass can be added."""
        return self.total > 0

    def grid(self) -> list[Floats]:
        """List the tests to choose from: nothing, each single floor, all floors, lower and upper half; none twice."""
        n = len(self.floor)
        patterns = [np.zeros(n), *np.eye(n), np.ones(n)]
        if n > 2:
            half = np.arange(n) < n // 2
            patterns += [half.astype(float), (~half).astype(float)]
        tests = [self._within(part * pattern * self.floor) for pattern in patterns for part in PARTS]
        return list({tuple(np.round(test, 9)): test for test in tests}.values())

    def _within(self, test: Floats) -> Floats:
        """Scale the test down if its total exceeds the limit."""
        return np.asarray(test * min(1.0, self.total / max(float(test.sum()), 1e-300)))


@usual_arithmetic
def plan(
    source: str | Path | Experiment | Design,
    sensors: int | None = None,
    tests: int | str = 1,
    *,
    modes: int | Sequence[int] | None = None,
    noise: TestNoise | None = None,
    added_mass: float | Sequence[float] | Floats | None = None,
    added_mass_total: float | None = None,
    goal: str = "all",
    criterion: str | None = None,
    fresh: bool = False,
    loop: bool = False,
    configuration: str | None = None,
    backend: str = "clarabel",
) -> Plan:
    """Choose the floors to measure and the masses to add before a test.

    Parameters
    ----------
    source : str, Path, Experiment or Design
        A file of design values, a measurement file or the JSON of an earlier result; earlier results count as known.
    sensors : int, optional
        Number of floors to measure; all by default.
    tests : int or str, optional
        Number of tests; "declared" for the tests of the measurement file with their masses, without their
        measurements.
    modes : int or sequence of int, optional
        Number of the lowest modes that will be identified, or the modes' numbers.
    noise : TestNoise, optional
        By default, the noise that the source's tests declare; without it, 0.2 % of frequencies and 1 % of shapes.
    added_mass : float or array_like, shape (N,), optional
        Largest added mass of each floor, kg; by default no mass is added.
    added_mass_total : float, optional
        Largest total of added masses in one test, kg.
    goal : str, optional
        "masses", "stiffnesses", "all", or effects to distinguish from each other and from no effect, separated by
        commas. Each effect is "NAME" or "NAME@PLACE", with "=SIZE" if it has no usual size.
    criterion : str, optional
        "D", "A", "E" or "worst"; by default, D for the frame and worst for effects.
    fresh : bool, optional
        Do not count the source's measurements as known.
    loop : bool, optional
        Close the loop on the source's measurements, and plan for the frame with the effects found; by default, plan
        for the shear frame with the best fit.
    configuration : str, optional
        Test or state of the source that is tested again; the first configuration if None.
    backend : str, optional
        "clarabel" or "scs".

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an option is not valid; the message names the option, its value and the remedy.
    NoSolutionError
        If the backend finds no solution.
    """
    checks.choice(backend, SOLVERS, "backend")
    declared = tests == DECLARED
    if not declared:
        if isinstance(tests, str):
            raise InputError(f"tests must be a whole number or {DECLARED!r}, not {checks.shown(tests)}")
        checks.whole(tests, "tests", least=1, most=MOST_TESTS)
    design = source
    if not isinstance(design, Design):
        design = read_design(design, fresh=fresh or declared, loop=loop, configuration=configuration)
    n = design.stories
    number = n if sensors is None else checks.whole(sensors, "sensors", least=1, most=n)
    model = AveragedModel.around(_model(design, goal, modes, noise or Declared.of_tests(design.declared)))
    by = criterion_named(criterion or ("worst" if model.frames[0].targets else "D"))
    limits = MassLimits.of(added_mass, added_mass_total, n)
    if declared:
        if not design.declared:
            raise InputError(f"{design.name} declares no tests; say how many to plan")
        masses = [each.added_mass for each in design.declared]
        return _finished(model, masses, [each.name for each in design.declared], number, by, backend, None)
    names = _names(design, int(tests))
    if not limits.any:
        return _finished(model, [np.zeros(n)] * int(tests), names, number, by, backend, None)
    return _finished(model, _masses(model, number, int(tests), by, limits, backend), names, number, by, backend, limits)


def _model(design: Design, goal: str, modes: int | Sequence[int] | None, noise: TestNoise) -> TestModel:
    """Build the model of the tests for this goal."""
    which = _which(modes, design)
    if goal in GOALS:
        return TestModel(design, (), GOALS[goal], which, noise)
    names = [part.strip() for part in checks.text(goal, "what the plan is for").split(",") if part.strip()]
    return TestModel(design, tuple(target(name, design.frame, design.scale) for name in names), (), which, noise)


def _which(modes: int | Sequence[int] | None, design: Design) -> Ints:
    """Return the modes that will be identified, zero-based."""
    n = design.stories
    if modes is None:
        if design.declared:
            return design.declared[0].modes - 1
        return np.arange(min(USUAL_MODES, n))
    if isinstance(modes, int):
        return np.arange(checks.whole(modes, "modes", least=1, most=n))
    return checks.ascending_whole(list(modes), "modes", most=n) - 1


def _names(design: Design, count: int) -> list[str]:
    """Make names for the planned tests that differ from the names of the file's tests."""
    taken = {each.name for each in design.declared}
    free = (name for name in (f"planned test {i}" for i in range(1, count + len(taken) + 1)) if name not in taken)
    return [next(free) for _ in range(count)]


def _masses(
    model: AveragedModel, number: int, count: int, by: Criterion, limits: MassLimits, backend: str
) -> list[Floats]:
    """Choose the masses of `number` tests, kg, the lightest first; choose floors and masses in turn."""
    n = len(limits.floor)
    grid = limits.grid()
    if count > len(grid):
        raise InputError(f"tests = {count} are more than the {len(grid)} that these added masses give; plan fewer")
    expected = [model.expected(test) for test in grid]
    floors = np.arange(n)
    tried: list[tuple[int, ...]] = []
    while number < n and tuple(floors) not in tried:
        tried.append(tuple(floors))
        found = choose(model.choices(expected, floors, count), count, by, backend)
        floors = choose(model.sensors([expected[i] for i in found.chosen], number), number, by, backend).chosen
    found = choose(model.choices(expected, floors, count), count, by, backend)
    return sorted((grid[i] for i in found.chosen), key=lambda test: float(test.sum()))


def _finished(
    model: AveragedModel,
    masses: Sequence[Floats],
    names: Sequence[str],
    number: int,
    by: Criterion,
    backend: str,
    limits: MassLimits | None,
) -> Plan:
    """Make the plan with its expected accuracy, also for one sensor more, one less, and sensors everywhere."""
    designed = model.frames[0]
    n = designed.design.stories
    expected = [model.expected(test) for test in masses]
    wanted = [count for count in (number - 1, number, number + 1) if 1 <= count <= n]
    found = {count: choose(model.sensors(expected, count), count, by, backend) for count in {*wanted, n}}
    seen = {count: expected_accuracy(model, expected, choice) for count, choice in found.items()}
    grid = None
    if limits is not None:
        tests = [model.expected(test) for test in limits.grid()]
        grid = choose(model.choices(tests, found[number].chosen, len(masses)), len(masses), by, backend)
    information = model.of_targets(expected, found[number].chosen) if designed.targets else None
    return Plan(
        criterion=by.name,
        backend=backend,
        tests=tuple(masses),
        names=tuple(names),
        chosen=seen[number],
        fewer=seen.get(number - 1),
        more=seen.get(number + 1),
        everywhere=seen[n],
        grid_bound=None if grid is None else grid.bound,
        grid_worst=None if grid is None else grid.worst,
        apart=() if information is None else chances(designed.targets, information),
        averaged=model,
    )


def expected_accuracy(model: AveragedModel, tests: Sequence[Test], choice: Choice) -> ExpectedAccuracy:
    """Compute the expected accuracy of the shear model with the chosen floors.

    Parameters
    ----------
    model : AveragedModel
    tests : sequence of Test
    choice : Choice
    """
    design = model.frames[0].design
    covariance, n = model.shear_covariance(tests, choice.chosen), design.stories
    relative = np.sqrt(np.diag(covariance))
    std = np.where(relative < UNKNOWN_STD, relative, np.nan) * design.sizes
    share = design.floor_mass / design.floor_mass.sum()
    total = float(np.sqrt(max(share @ covariance[:n, :n] @ share, 0.0)))
    return ExpectedAccuracy(choice.chosen + 1, choice.value, choice.bound, choice.worst, std[:n], std[n:], total)
