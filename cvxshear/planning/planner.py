"""Plan a test: which floors to measure, which masses to add."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.planning.apart import apart
from cvxshear.planning.choice import Choice, choose
from cvxshear.planning.criteria import Criterion, criterion_named
from cvxshear.planning.design import Design
from cvxshear.planning.masses import Limits, refined
from cvxshear.planning.model import Expected, TestModel
from cvxshear.planning.noise import Declared, TestNoise
from cvxshear.planning.relaxation import SOLVERS
from cvxshear.planning.results import OPEN, Outlook, Plan
from cvxshear.planning.source import read_design
from cvxshear.planning.targets import target
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

GOALS = {
    "masses": ("floor_mass",),
    "stiffnesses": ("story_stiffness",),
    "all": ("floor_mass", "story_stiffness"),
}

DECLARED = "declared"
"""In place of a number of tests: those that the file declares."""

USUAL_MODES = 4
"""That are planned for where nothing says which."""

MOST_TESTS = 50
TURNS = 3
"""Times that floors and masses are chosen, one given the other."""


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
    solver: str = "clarabel",
) -> Plan:
    """Choose the floors to measure and the masses to add before a test.

    Parameters
    ----------
    source : str, Path, Experiment or Design
        A file of design values; a measurement file or the JSON of an earlier result, which are then known beforehand.
    sensors : int, optional
        How many floors can be measured; all where not given.
    tests : int or str, optional
        How many tests; "declared" for those of the measurement file with their masses, planned as if nothing had been
        measured yet.
    modes : int or sequence of int, optional
        How many of the lowest modes will be identified, or which.
    noise : TestNoise, optional
        0.2 % of frequencies and 1 % of shapes where not given.
    added_mass : float or array_like, shape (N,), optional
        kg that each floor can carry; without it no mass is added.
    added_mass_total : float, optional
        kg that one test can carry in all.
    goal : str, optional
        "masses", "stiffnesses", "all", or effects to tell from one another and from none, commas between, each as
        "NAME", "NAME@PLACE" and with "=SIZE" where it has no usual one.
    criterion : str, optional
        "D", "A", "E" or "worst"; D for the frame and worst for effects where not given.
    fresh : bool, optional
        Count nothing of what the source measured as known.
    solver : str, optional
        "clarabel" or "scs".

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        Naming the option, the value found and what would be right.
    NoSolutionError
        Where the solver finds no solution.
    """
    checks.choice(solver, SOLVERS, "solver")
    declared = tests == DECLARED
    if not declared:
        if isinstance(tests, str):
            raise InputError(f"tests must be a whole number or {DECLARED!r}, not {checks.shown(tests)}")
        checks.whole(tests, "tests", least=1, most=MOST_TESTS)
    design = source if isinstance(source, Design) else read_design(source, fresh=fresh or declared)
    n = design.stories
    number = n if sensors is None else checks.whole(sensors, "sensors", least=1, most=n)
    model = _model(design, goal, modes, noise or Declared())
    by = criterion_named(criterion or ("worst" if model.targets else "D"))
    limits = Limits.of(added_mass, added_mass_total, n)
    if declared:
        masses, names, tests_bound = _declared(design), [each.name for each in design.declared], None
    else:
        masses, tests_bound = _masses(model, number, int(tests), by, limits, solver)
        names = _names(design, len(masses))
    return _finished(model, masses, names, number, by, solver, tests_bound)


def _model(design: Design, goal: str, modes: int | Sequence[int] | None, noise: TestNoise) -> TestModel:
    """The model of the tests, for this goal."""
    which = _which(modes, design)
    if goal in GOALS:
        return TestModel(design, (), GOALS[goal], which, noise)
    names = [part.strip() for part in checks.text(goal, "what the plan is for").split(",") if part.strip()]
    return TestModel(design, tuple(target(name, design.frame, design.scale) for name in names), (), which, noise)


def _which(modes: int | Sequence[int] | None, design: Design) -> Ints:
    """The modes that will be identified, zero-based."""
    n = design.stories
    if modes is None:
        if design.declared:
            return design.declared[0].modes - 1
        return np.arange(min(USUAL_MODES, n))
    if isinstance(modes, int):
        return np.arange(checks.whole(modes, "modes", least=1, most=n))
    return checks.ascending_whole(list(modes), "modes", most=n) - 1


def _declared(design: Design) -> list[Floats]:
    """The masses of the tests that the file declares."""
    if not design.declared:
        raise InputError(f"{design.name} declares no tests; say how many to plan")
    return [each.added_mass for each in design.declared]


def _names(design: Design, count: int) -> list[str]:
    """Names for the planned tests that no test of the file has."""
    taken = {each.name for each in design.declared}
    free = (name for name in (f"planned test {i}" for i in range(1, count + len(taken) + 1)) if name not in taken)
    return [next(free) for _ in range(count)]


def _masses(
    model: TestModel, number: int, count: int, by: Criterion, limits: Limits, solver: str
) -> tuple[list[Floats], float | None]:
    """The masses of so many tests, and the bound of the tests on the grid; floors and masses by turns."""
    n = model.design.stories
    if not limits.any:
        return [np.zeros(n)] * count, None
    grid = limits.grid()
    if count > len(grid):
        raise InputError(f"tests = {count} are more than the {len(grid)} that these added masses give; plan fewer")
    expected = [model.expected(test) for test in grid]
    floors = np.arange(n)
    for _ in range(TURNS):
        found = choose(model.choices(expected, floors, count), count, by, solver)
        if number == n:
            break
        before = floors
        # On the way the choice is wanted, not how far it is from the best.
        of = model.sensors([expected[i] for i in found.chosen], number)
        floors = choose(of, number, by, solver, widths=()).chosen
        if np.array_equal(floors, before):
            break
    tests = refined(model, [grid[i] for i in found.chosen], floors, by, limits)
    return sorted(tests, key=lambda test: float(test.sum())), found.bound


def _finished(
    model: TestModel,
    masses: Sequence[Floats],
    names: Sequence[str],
    number: int,
    by: Criterion,
    solver: str,
    tests_bound: float | None,
) -> Plan:
    """The plan with its outlook: the sensors for these tests, with one more, one less, and with all."""
    n = model.design.stories
    expected = [model.expected(test) for test in masses]
    wanted = [count for count in (number - 1, number, number + 1) if 1 <= count <= n]
    found = {count: choose(model.sensors(expected, count), count, by, solver) for count in {*wanted, n}}
    seen = {count: outlook(model, expected, choice) for count, choice in found.items()}
    return Plan(
        model=model,
        criterion=by.name,
        solver=solver,
        tests=tuple(masses),
        names=tuple(names),
        chosen=seen[number],
        fewer=seen.get(number - 1),
        more=seen.get(number + 1),
        everywhere=seen[n],
        tests_bound=tests_bound,
        apart=apart(model.targets, model.told_of_effects(expected, found[number].chosen)) if model.targets else (),
    )


def outlook(model: TestModel, tests: Sequence[Expected], choice: Choice) -> Outlook:
    """What is expected of the shear model with the chosen floors.

    Parameters
    ----------
    model : TestModel
    tests : sequence of Expected
    choice : Choice
    """
    design = model.design
    n = design.stories
    shear = dataclasses.replace(model, targets=(), quantities=GOALS["all"])
    plain = tests if not model.targets else [_without_effects(test, 2 * n) for test in tests]
    relative = np.sqrt(np.diag(shear.covariance(plain, choice.chosen)))
    std = np.where(relative < OPEN, relative, np.nan) * design.sizes
    return Outlook(choice.chosen + 1, choice.value, choice.bound, std[:n], std[n:])


def _without_effects(test: Expected, first: int) -> Expected:
    """A test with the derivatives by masses and stiffnesses alone: the effects' own come after them."""
    return dataclasses.replace(
        test, frequency_rows=test.frequency_rows[:, :first], shape_rows=test.shape_rows[:, :, :first]
    )
