"""Plan a test: which floors to measure, which masses to add.

Masses are the best of a grid of tests, then what is between the grid's points; floors and masses are chosen by turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import LinearConstraint

from cvxshear.measurement.experiment import Experiment
from cvxshear.planning.chances import chances, target
from cvxshear.planning.choice import SOLVERS, Choice, choose, descended
from cvxshear.planning.criteria import Criterion, criterion_named
from cvxshear.planning.design import UNKNOWN_STD, Design, read_design
from cvxshear.planning.expected_noise import Declared, TestNoise
from cvxshear.planning.results import ExpectedAccuracy, Plan
from cvxshear.planning.tested_model import AveragedModel, Test, TestModel
from cvxshear.util import checks
from cvxshear.util.arithmetic import usual_arithmetic
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

GOALS = {"masses": ("floor_mass",), "stiffnesses": ("story_stiffness",), "all": ("floor_mass", "story_stiffness")}
"""What a plan can be for besides effects, with the quantities that it is to determine."""

DECLARED = "declared"
"""In place of a number of tests: those that the file declares."""

USUAL_MODES = 4
"""Modes that are planned for where nothing says which: as many as ambient tests of buildings commonly give."""

MOST_TESTS = 50
"""Tests at most: nobody makes more, and the program's time grows with them."""

TURNS = 3
"""Times that floors and masses are chosen, one given the other; the third turn seldom changes anything."""

PARTS = (0.5, 1.0)
"""Parts of what a floor can carry that the grid's tests put on it."""

MOST_REFINED = 60
"""Masses of all tests together up to which they are refined between the points of the grid."""

DESCENT_STEPS = 15
"""Steps of the refinement at most; its gradient takes a test's modes for each mass."""

MASS_STEP = 1e-3
"""Part of a floor's limit by which the differences of that gradient move a mass."""

MASS_DIGITS = 2
"""Decimals, of the limit in percent, that a refined mass is given with: nobody weighs finer."""


@dataclass(frozen=True, eq=False)
class MassLimits:
    """What can be added to the frame.

    Parameters
    ----------
    floor : ndarray, shape (N,)
        kg on each floor; zero where nothing can be put.
    total : float
        kg in one test.
    """

    floor: Floats
    total: float

    @staticmethod
    def of(floor: object, total: object, stories: int) -> MassLimits:
        """Read the limits that options declare: one number or one a floor, and a number or nothing for all together."""
        if floor is None:
            if total is not None:
                raise InputError("a limit of the added mass in all needs one of each floor: give added_mass as well")
            return MassLimits(np.zeros(stories), 0.0)
        each = checks.one_or_many(floor, "added_mass", stories, each=", one a floor", least=0.0)
        whole = float(each.sum()) if total is None else checks.number(total, "added_mass_total", least=0.0)
        return MassLimits(each, min(whole, float(each.sum())))

    @property
    def any(self) -> bool:
        """Whether anything can be added."""
        return self.total > 0

    def grid(self) -> list[Floats]:
        """List the tests to choose from: nothing, each floor alone, all floors, lower and upper half; none twice."""
        n = len(self.floor)
        patterns = [np.zeros(n), *np.eye(n), np.ones(n)]
        if n > 2:
            half = np.arange(n) < n // 2
            patterns += [half.astype(float), (~half).astype(float)]
        tests = [self._within(part * pattern * self.floor) for pattern in patterns for part in PARTS]
        return list({tuple(np.round(test, 9)): test for test in tests}.values())

    def _within(self, test: Floats) -> Floats:
        """Make the test smaller where it is too heavy in all."""
        return np.asarray(test * min(1.0, self.total / max(float(test.sum()), 1e-300)))

    def practical(self, test: Floats) -> Floats:
        """Round the masses as one would weigh them, within the limits."""
        largest = float(self.floor.max())
        result: Floats = np.minimum(np.round(test / largest, MASS_DIGITS) * largest, self.floor)
        return self._within(result)


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
        A file of design values; a measurement file or the JSON of an earlier result, which are then known beforehand.
    sensors : int, optional
        How many floors can be measured; all where not given.
    tests : int or str, optional
        How many tests; "declared" for those of the measurement file with their masses, planned as if nothing had been
        measured yet.
    modes : int or sequence of int, optional
        How many of the lowest modes will be identified, or which.
    noise : TestNoise, optional
        What the source's tests state where not given; 0.2 % of frequencies and 1 % of shapes where they state nothing.
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
    loop : bool, optional
        Close the loop on what the source measured, and plan for the frame with the effects that it finds; the shear
        frame that fits best where not.
    configuration : str, optional
        Test or state of the source that is tested again; its first configuration if None.
    backend : str, optional
        "clarabel" or "scs".

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        Naming the option, the value found and what would be right.
    NoSolutionError
        Where the backend finds no solution.
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
    """Build the model of the tests, for this goal."""
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
    """Names for the planned tests that no test of the file has."""
    taken = {each.name for each in design.declared}
    free = (name for name in (f"planned test {i}" for i in range(1, count + len(taken) + 1)) if name not in taken)
    return [next(free) for _ in range(count)]


def _masses(
    model: AveragedModel, number: int, count: int, by: Criterion, limits: MassLimits, backend: str
) -> list[Floats]:
    """Choose the masses of so many tests, kg, the lightest first; floors and masses chosen by turns."""
    n = len(limits.floor)
    grid = limits.grid()
    if count > len(grid):
        raise InputError(f"tests = {count} are more than the {len(grid)} that these added masses give; plan fewer")
    expected = [model.expected(test) for test in grid]
    floors = np.arange(n)
    for _ in range(TURNS):
        found = choose(model.choices(expected, floors, count), count, by, backend)
        if number == n:
            break
        before = floors
        # On the way the choice is wanted, not how far it is from the best.
        problem = model.sensors([expected[i] for i in found.chosen], number)
        floors = choose(problem, number, by, backend, widths=()).chosen
        if np.array_equal(floors, before):
            break
    tests = refined(model, [grid[i] for i in found.chosen], floors, by, limits)
    return sorted(tests, key=lambda test: float(test.sum()))


def value_of(model: AveragedModel, tests: Sequence[Test], floors: Ints, by: Criterion) -> float:
    """Evaluate the criterion of these tests at these floors."""
    problem = model.choices(tests, floors, len(tests))
    return float(by.value(problem, problem.information(np.ones(len(tests)))))


def refined(
    model: AveragedModel, tests: Sequence[Floats], floors: Ints, by: Criterion, limits: MassLimits
) -> list[Floats]:
    """Move the masses of the tests between the grid's points, where that is better.

    The masses are looked for on the frame as designed, and judged on all that the design values allow.

    Parameters
    ----------
    model : AveragedModel
    tests : sequence of ndarray, shape (N,)
        kg.
    floors : ndarray of int
        Measured, zero-based.
    by : Criterion
    limits : MassLimits
    """
    free = np.flatnonzero(limits.floor > 0)
    count, size = len(tests), len(free)
    if not size or count * size > MOST_REFINED:
        return list(tests)
    scale = limits.floor[free]
    designed = AveragedModel(model.frames[:1])

    def masses(x: Floats) -> list[Floats]:
        result = np.zeros((count, len(limits.floor)))
        result[:, free] = np.clip(x.reshape(count, size), 0.0, 1.0) * scale
        return list(result)

    def value(expected: Sequence[Test]) -> float:
        return float(np.log(value_of(designed, expected, floors, by)))

    def both(x: Floats) -> tuple[float, Floats]:
        here = [designed.expected(test) for test in masses(x)]
        now, slope = value(here), np.zeros(len(x))
        for place in range(len(x)):
            # Into the interior, so that no mass becomes negative or too large.
            step = MASS_STEP if x[place] < 0.5 else -MASS_STEP
            moved, test = x.copy(), place // size
            moved[place] += step
            there = [*here[:test], designed.expected(masses(moved)[test]), *here[test + 1 :]]
            slope[place] = (value(there) - now) / step
        return now, slope

    start = np.concatenate([test[free] / scale for test in tests])
    within = LinearConstraint(np.kron(np.eye(count), scale), -np.inf, limits.total)
    better = [limits.practical(test) for test in masses(descended(both, start, within, DESCENT_STEPS, tolerance=1e-4))]
    before, after = ([model.expected(test) for test in some] for some in (tests, better))
    return better if value_of(model, after, floors, by) < value_of(model, before, floors, by) else list(tests)


def _finished(
    model: AveragedModel,
    masses: Sequence[Floats],
    names: Sequence[str],
    number: int,
    by: Criterion,
    backend: str,
    limits: MassLimits | None,
) -> Plan:
    """Make the plan with the accuracy expected of it, of one sensor more, of one less, and of sensors everywhere."""
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
    """State what is expected of the shear model with the chosen floors.

    Parameters
    ----------
    model : AveragedModel
    tests : sequence of Test
    choice : Choice
    """
    design = model.frames[0].design
    relative = model.shear_std(tests, choice.chosen)
    std = np.where(relative < UNKNOWN_STD, relative, np.nan) * design.sizes
    n = design.stories
    return ExpectedAccuracy(choice.chosen + 1, choice.value, choice.bound, choice.worst, std[:n], std[n:])
