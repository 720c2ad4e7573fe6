"""Plan a test: choose the floors to measure and the masses to add.

The masses are chosen from a grid of tests. Floors and masses are chosen in turn until they stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.planning.choice import CRITERIA, Choice, Criterion, choose
from cvxshear.planning.design import Design, read_design
from cvxshear.planning.results import Plan, expected_accuracy
from cvxshear.planning.tested_model import Declared, TestModel, TestNoise
from cvxshear.util import checks
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

GOALS = {"masses": ("floor_mass",), "stiffnesses": ("story_stiffness",), "all": ("floor_mass", "story_stiffness")}
"""Goals of a plan, each with the quantities to determine."""

USUAL_MODES = 4
"""Default number of modes of a plan: ambient tests of buildings commonly give four."""

MOST_TESTS = 50
"""Largest number of tests; the time of the program grows with it."""

PARTS = (0.5, 1.0)
"""Added masses of the grid, as fractions of the limit of a floor."""


def mass_grid(limit: Floats) -> list[Floats]:
    """List the tests to choose from: nothing, each single floor, all floors, lower and upper half; none twice.

    Parameters
    ----------
    limit : ndarray, shape (N,)
        Largest added mass of each floor, kg; zero if the floor cannot carry added mass.
    """
    n = len(limit)
    patterns = [np.zeros(n), *np.eye(n), np.ones(n)]
    if n > 2:
        half = np.arange(n) < n // 2
        patterns += [half.astype(float), (~half).astype(float)]
    tests = [part * pattern * limit for pattern in patterns for part in PARTS]
    return list({tuple(np.round(test, 9)): test for test in tests}.values())


@usual_arithmetic
def plan(
    source: str | Path | Experiment | Design,
    sensors: int | None = None,
    tests: int = 1,
    *,
    modes: int | Sequence[int] | None = None,
    noise: TestNoise | None = None,
    added_mass: float | Sequence[float] | Floats | None = None,
    goal: str = "all",
    criterion: str = "D",
    fresh: bool = False,
) -> Plan:
    """Choose the floors to measure and the masses to add before a test.

    Parameters
    ----------
    source : str, Path, Experiment or Design
        A file of design values, or a measurement file, whose measurements count as known.
    sensors : int, optional
        Number of floors to measure; all by default.
    tests : int, optional
        Number of tests.
    modes : int or sequence of int, optional
        Number of the lowest modes that will be identified, or the modes' numbers.
    noise : TestNoise, optional
        By default, the noise that the source's tests declare; without it, 0.2 % of frequencies and 1 % of shapes.
    added_mass : float or array_like, shape (N,), optional
        Largest added mass of each floor, kg; by default no mass is added.
    goal : str, optional
        "masses", "stiffnesses" or "all".
    criterion : str, optional
        "D", "A" or "E".
    fresh : bool, optional
        Do not count the source's measurements as known.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If an option is not valid; the message names the option, its value and the remedy.
    """
    count = checks.whole(tests, "tests", least=1, most=MOST_TESTS)
    by = CRITERIA[checks.choice(criterion, list(CRITERIA), "criterion")]
    quantities = GOALS[checks.choice(goal, list(GOALS), "goal")]
    design = source if isinstance(source, Design) else read_design(source, fresh=fresh)
    n = design.stories
    number = n if sensors is None else checks.whole(sensors, "sensors", least=1, most=n)
    model = TestModel(design, quantities, _which(modes, design), noise or Declared.of_tests(design.declared))
    if added_mass is None:
        return _finished(model, [np.zeros(n)] * count, None, number, by)
    limit = checks.one_or_many(added_mass, "added_mass", n, each=", one a floor", least=0.0)
    grid = mass_grid(limit)
    chosen = _masses(model, grid, count, number, by)
    masses = sorted((grid[i] for i in chosen.chosen), key=lambda test: float(test.sum()))
    return _finished(model, masses, chosen, number, by)


def _which(modes: int | Sequence[int] | None, design: Design) -> Ints:
    """Return the modes that will be identified, zero-based."""
    n = design.stories
    if modes is None:
        return design.declared[0].modes - 1 if design.declared else np.arange(min(USUAL_MODES, n))
    if isinstance(modes, int):
        return np.arange(checks.whole(modes, "modes", least=1, most=n))
    return checks.ascending_whole(list(modes), "modes", most=n) - 1


def _masses(model: TestModel, grid: Sequence[Floats], count: int, number: int, by: Criterion) -> Choice:
    """Choose tests of the grid; choose floors and tests in turn until they stay."""
    n = model.design.stories
    if count > len(grid):
        raise InputError(f"tests = {count} are more than the {len(grid)} that these added masses give; plan fewer")
    expected = [model.expected(test) for test in grid]
    floors = np.arange(n)
    tried: list[tuple[int, ...]] = []
    while number < n and tuple(floors) not in tried:
        tried.append(tuple(floors))
        found = choose(model.choices(expected, floors, count), count, by)
        floors = choose(model.sensors([expected[i] for i in found.chosen], number), number, by).chosen
    return choose(model.choices(expected, floors, count), count, by)


def _finished(model: TestModel, masses: Sequence[Floats], of_grid: Choice | None, number: int, by: Criterion) -> Plan:
    """Make the plan with its expected accuracy, also for one sensor more, one less, and sensors everywhere."""
    n = model.design.stories
    taken = {each.name for each in model.design.declared}
    free = [name for i in range(1, len(masses) + len(taken) + 1) if (name := f"planned test {i}") not in taken]
    expected = [model.expected(test) for test in masses]
    counts = {count for count in (number - 1, number, number + 1, n) if 1 <= count <= n}
    seen = {count: expected_accuracy(model, expected, count, by) for count in counts}
    return Plan(
        model=model,
        criterion=by.name,
        tests=tuple(masses),
        names=tuple(free[: len(masses)]),
        chosen=seen[number],
        fewer=seen.get(number - 1),
        more=seen.get(number + 1),
        everywhere=seen[n],
        of_grid=of_grid,
    )
