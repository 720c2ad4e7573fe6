"""Plan a test: choose the floors to measure and the masses to add; its expected accuracy, and a file to fill in.

The masses are chosen from a grid of tests. Floors and masses are chosen in turn until they stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.fit.misfit import ExpectedTest
from cvxshear.fit.other_frames import other_frames
from cvxshear.fit.results import OtherFrames
from cvxshear.io.toml import write_measurement
from cvxshear.measurement.experiment import Configuration, Experiment, Measurement
from cvxshear.planning.choice import CRITERIA, KNOWN_EXACTLY, Choice, Criterion, choose, free_changes
from cvxshear.planning.design import UNKNOWN_STD, Design, read_design
from cvxshear.planning.expected_tests import Declared, TestModel
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property, usual_arithmetic
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import listed
from cvxshear.util.results import InJson, Shown
from cvxshear.util.typing import Floats, Ints, Json

#: Goals of a plan, each with the quantities to determine.
GOALS = {"masses": ("floor_mass",), "stiffnesses": ("story_stiffness",), "all": ("floor_mass", "story_stiffness")}

#: Default number of modes of a plan: ambient tests of buildings commonly give four.
USUAL_MODES = 4

#: Added masses of the grid, as fractions of the limit of a floor.
PARTS = (0.5, 1.0)


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy(InJson):
    """Expected accuracy with sensors on some floors.

    Parameters
    ----------
    choice : Choice
        Chosen floors, the criterion's standard deviation for the frame as designed, relative, and bounds on all choices
        of as many floors.
    floor_mass_std, story_stiffness_std : ndarray, shape (N,)
        Averaged over the frames that are possible before the tests, kg and N/m; nan if undetermined.
    """

    choice: Choice
    floor_mass_std: Floats
    story_stiffness_std: Floats

    json_keys = "sensors=floors objective=choice.value std"

    @property
    def floors(self) -> Ints:
        """Floors with sensors, 1 the lowest."""
        return self.choice.chosen + 1

    @property
    def std(self) -> dict[str, Floats]:
        """Standard deviations by quantity, shape (N,)."""
        return {"floor_mass": self.floor_mass_std, "story_stiffness": self.story_stiffness_std}


def typical_std(covariance: Floats) -> tuple[float, float]:
    """Root mean square of the standard deviations of floor masses and of story stiffnesses."""
    mass, stiffness = np.sqrt(np.mean(np.split(np.diag(covariance), 2), axis=1)).tolist()
    return mass, stiffness


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """The result of `plan`.

    Parameters
    ----------
    model : TestModel
        The frame as designed, the goal of the plan, the modes and their noise.
    criterion : str
    tests : tuple of ndarray, shape (N,)
        Added mass of each test, kg.
    names : tuple of str
        Names of the tests.
    chosen : ExpectedAccuracy
        Accuracy with the sensors of the plan.
    fewer, more : ExpectedAccuracy or None
        Accuracy with the best choice of one sensor less, and of one sensor more.
    everywhere : ExpectedAccuracy
        Accuracy with sensors on every floor.
    of_grid : Choice or None
        Chosen tests of the grid of added masses, with bounds on all choices; None without added mass.
    """

    model: TestModel
    criterion: str
    tests: tuple[Floats, ...]
    names: tuple[str, ...]
    chosen: ExpectedAccuracy
    fewer: ExpectedAccuracy | None
    more: ExpectedAccuracy | None
    everywhere: ExpectedAccuracy
    of_grid: Choice | None

    json_keys = (
        "sensors tests=planned_tests modes=model.numbers noise=model.noise.words expected_modes for=goal criterion "
        "objective bound gap floors_arbitrary grid_bound=of_grid.bound masses_arbitrary=of_grid.arbitrary frame "
        "std=chosen.std remedies other_frames=other_frames.frames one_sensor_less=fewer one_sensor_more=more "
        "every_floor=everywhere"
    )

    @property
    def sensors(self) -> list[int]:
        """Floors to measure, 1 the lowest."""
        return [int(floor) for floor in self.chosen.floors]

    @property
    def objective(self) -> float:
        """The criterion's standard deviation."""
        return self.chosen.choice.value

    @property
    def bound(self) -> float:
        """Lower bound on the objective of any choice of the same number of floors."""
        return self.chosen.choice.bound

    @property
    def gap(self) -> float:
        """Relative difference of the objective and the bound."""
        return self.chosen.choice.gap

    @property
    def expected_modes(self) -> list[dict[str, float]]:
        """Number and frequency (Hz) of each mode of the first test."""
        test = self.model.expected(self.tests[0]).test
        pairs = zip(test.modes.tolist(), test.frequencies.tolist(), strict=True)
        return [{"mode": mode, "frequency": frequency} for mode, frequency in pairs]

    @property
    def goal(self) -> str:
        """Goal of the plan in words."""
        words = {"floor_mass": "floor masses", "story_stiffness": "story stiffnesses"}
        return listed([words[each] for each in self.model.quantities])

    @property
    def measure(self) -> str:
        """Objective in words."""
        return CRITERIA[self.criterion].summary

    @property
    def typical_std(self) -> tuple[float, float]:
        """Root mean square of the relative standard deviations of floor masses and of story stiffnesses."""
        std = np.concatenate([self.chosen.floor_mass_std, self.chosen.story_stiffness_std]) / self.model.design.sizes
        return typical_std(np.diag(std**2))

    @cached_property
    def other_frames(self) -> OtherFrames:
        """Other frames that will fit the earlier and the planned tests as well, and the test that tells them apart."""
        backend, experiment = backends.get("auto"), predicted(self)
        if len(self.sensors) == 1:
            # Shapes of free scale at one floor tell nothing.
            bare = [
                Configuration(each.frequencies, name=each.name, added_mass=each.added_mass, modes=each.modes,
                              frequency_std=each.frequency_std)
                if each.name in self.names else each
                for each in experiment.configurations
            ]  # fmt: skip
            experiment = replace(experiment, configurations=tuple(bare))
        return other_frames(efficient(experiment, backend), backend)

    @cached_property
    def remedies(self) -> dict[str, tuple[float, float]]:
        """What would lower the deviations, the cheapest first, each with the typical deviations that it leads to."""
        model, floors = self.model, self.chosen.choice.chosen
        n, noise = model.design.stories, model.noise
        share = model.design.share_of_total
        found: dict[str, tuple[TestModel, Ints, Floats | None]] = {}
        if np.linalg.norm(share @ free_changes(model.fixed)) > KNOWN_EXACTLY:
            found["weigh the frame"] = model, floors, share
        if self.more is not None:
            found["one sensor more"] = model, self.more.choice.chosen, None
        exact = Declared(noise.frequency_std / 2, noise.mode_shape_std / 2)
        found["half the noise: records four times as long"] = replace(model, noise=exact), floors, None
        if free := [mode for mode in range(n) if mode not in model.which]:
            which = np.sort([*model.which, free[0]])
            found[f"mode {free[0] + 1} as well"] = replace(model, which=which), floors, None
        return {
            name: typical_std(each.averaged([each.expected(test) for test in self.tests], at, known))
            for name, (each, at, known) in found.items()
        }

    @property
    def floors_arbitrary(self) -> bool:
        """Whether floors were chosen, and every choice of the same number is equally good."""
        return self.chosen.choice.arbitrary and len(self.sensors) < self.model.design.stories

    @property
    def planned_tests(self) -> list[dict[str, object]]:
        """Name and added mass (kg) of each test."""
        return [{"name": name, "added_mass": mass} for name, mass in zip(self.names, self.tests, strict=True)]

    @property
    def frame(self) -> dict[str, object]:
        """Frame of the plan."""
        return {key: getattr(self.model.design, key) for key in ("floor_mass", "story_stiffness")}


def predicted(plan: Plan) -> Experiment:
    """Simulate the planned tests on the expected frame, without noise.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    Experiment
        The declared frame with the earlier and the planned measurements.

    Raises
    ------
    InputError
        If the tests do not determine the mass scale.
    """
    floors = plan.chosen.floors - 1
    tests = tuple(
        _at_sensors(plan.model.expected(masses).test, name, floors)
        for name, masses in zip(plan.names, plan.tests, strict=True)
    )
    design, before = plan.model.design, plan.model.design.measured
    if before is not None:
        return replace(before, configurations=(*before.configurations, *tests))
    # Without the earlier tests there is no state that is the reference.
    return Experiment(replace(design.frame, reference=None), tests, design.priors, design.name)


def _at_sensors(test: Configuration, name: str, floors: Ints) -> Configuration:
    """Return a planned test as it would be declared with sensors at these floors, each shape's largest entry 1."""
    entries = test.mode_shapes / np.max(np.abs(test.mode_shapes), axis=1, keepdims=True)
    shapes, std = entries[:, floors], test.mode_shape_std
    assert std is not None, "an expected test declares its noise"
    return replace(
        test,
        name=name,
        mode_shapes=shapes,
        measured_floors=floors + 1,
        mass_normalized=False,
        # A file declares the deviation relative to a mode's largest measured entry.
        mode_shape_std=std[:, floors] / np.max(np.abs(shapes), axis=1, keepdims=True),
    )


def write_template(path: str | Path, plan: Plan) -> None:
    """Write a measurement file with the planned tests, with nan for the values to be measured.

    Parameters
    ----------
    path : str or Path
    plan : Plan

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    exact = predicted(plan)
    declared = exact.to_dict()
    declared["configuration"] = [
        _to_fill_in(table) if table["name"] in plan.names else table for table in declared["configuration"]
    ]
    comments = [
        "Planned by cvxshear plan: put what you measure in place of every nan.",
        f"Sensors on floors {', '.join(map(str, plan.sensors))}; {plan.model.noise.words} expected.",
        *(
            f"{each.name}: expected frequencies {', '.join(f'{value:.4g}' for value in each.frequencies)} Hz"
            for each in exact.configurations
            if each.name in plan.names
        ),
    ]
    write_measurement(path, declared, comments)


def _to_fill_in(table: Json) -> Json:
    """Return the table of a planned test without its predictions."""
    shapes = np.full(np.shape(table["mode_shapes"]), np.nan)
    return {**table, "frequencies": np.full(len(table["frequencies"]), np.nan).tolist(), "mode_shapes": shapes.tolist()}


def mass_grid(limit: Floats) -> list[Floats]:
    """List the tests to choose from: nothing, each single floor, all floors, lower and upper half; none twice.

    Parameters
    ----------
    limit : ndarray, shape (N,)
        Largest added mass of each floor, kg; zero if the floor cannot carry added mass.
    """
    n = len(limit)
    half = np.arange(n) < n // 2
    patterns = [np.zeros(n), *np.eye(n), np.ones(n), half, ~half]
    tests = [part * pattern * limit for pattern in patterns for part in PARTS]
    return list({tuple(np.round(test, 9)): test for test in tests}.values())


@usual_arithmetic
def plan(
    source: Measurement | Design,
    sensors: int | None = None,
    tests: int = 1,
    *,
    modes: int | Sequence[int] | None = None,
    noise: Declared | None = None,
    added_mass: float | Sequence[float] | Floats | None = None,
    goal: str = "all",
    criterion: str = "D",
    fresh: bool = False,
) -> Plan:
    """Choose the floors to measure and the masses to add before a test.

    Parameters
    ----------
    source : str, Path, dict, Experiment or Design
        A file of design values, or a measurement file, whose measurements count as known; or the dict of either.
    sensors : int, optional
        Number of floors to measure; all by default.
    tests : int, optional
        Number of tests.
    modes : int or sequence of int, optional
        Number of the lowest modes that will be identified, or the modes' numbers.
    noise : Declared, optional
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
    count = checks.whole(tests, "tests", least=1)
    by = CRITERIA[checks.choice(criterion, list(CRITERIA), "criterion")]
    quantities = GOALS[checks.choice(goal, list(GOALS), "goal")]
    design = source if isinstance(source, Design) else read_design(source, fresh=fresh)
    if noise is not None and not isinstance(noise, Declared):
        raise InputError(f"noise must be a cvxshear.planning.Declared, not {checks.shown(noise)}")
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
    if checks.many(modes):
        return checks.ascending_whole(modes, "modes", most=n) - 1
    return np.arange(checks.whole(modes, "modes", least=1, most=n))


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


def _accuracy(model: TestModel, tests: Sequence[ExpectedTest], number: int, by: Criterion) -> ExpectedAccuracy:
    """Choose this number of floors for these tests, and compute the expected accuracy."""
    choice = choose(model.sensors(tests, number), number, by)
    relative = np.sqrt(np.diag(model.averaged(tests, choice.chosen)))
    std = np.where(relative < UNKNOWN_STD, relative, np.nan) * model.design.sizes
    return ExpectedAccuracy(choice, *np.split(std, 2))


def _finished(model: TestModel, masses: Sequence[Floats], of_grid: Choice | None, number: int, by: Criterion) -> Plan:
    """Make the plan with its expected accuracy, also for one sensor more, one less, and sensors everywhere."""
    n = model.design.stories
    taken = {each.name for each in model.design.declared}
    free = [name for i in range(1, len(masses) + len(taken) + 1) if (name := f"planned test {i}") not in taken]
    expected = [model.expected(test) for test in masses]
    counts = {count for count in (number - 1, number, number + 1, n) if 1 <= count <= n}
    seen = {count: _accuracy(model, expected, count, by) for count in counts}
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
