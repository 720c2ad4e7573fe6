"""Results of planning: the choice and its expected accuracy, and the planned tests as a file to fill in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cvxshear.io.toml import write_measurement
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.planning.chances import Chance
from cvxshear.planning.choice import choose
from cvxshear.planning.criteria import CRITERIA, criterion_named
from cvxshear.planning.design import MeasuredFrequency
from cvxshear.planning.tested_model import AveragedModel, TestModel
from cvxshear.util.quantities import listed
from cvxshear.util.results import InJson, Shown
from cvxshear.util.typing import Floats, Ints, Json

ARBITRARY = 0.01
"""Largest relative difference of best and worst choice that counts as equal; the noise is not known to one percent."""

MISFIT = 0.02
"""Least relative error of the frame's frequencies that a plan reports: ten times the default noise of frequencies."""

MOST_POINTS = 10
"""Largest number of points in the curve of accuracy."""


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy(InJson):
    """Expected accuracy with sensors on some floors.

    Parameters
    ----------
    floors : ndarray of int, shape (N,)
        1 the lowest.
    objective : float
        The criterion's standard deviation, relative; for effects, relative to their sizes.
    bound : float
        Lower bound on all choices of the same number of floors in these tests.
    worst : float
        Upper bound on all choices of the same number of floors.
    floor_mass_std, story_stiffness_std : ndarray, shape (N,)
        kg and N/m, of the shear model; nan if undetermined.
    """

    floors: Ints
    objective: float
    bound: float
    worst: float
    floor_mass_std: Floats
    story_stiffness_std: Floats

    json_keys = "sensors=floors objective std"

    @property
    def gap(self) -> float:
        """Relative difference of the objective and the bound."""
        return self.objective / self.bound - 1.0 if self.bound > 0 else float("inf")

    @property
    def arbitrary(self) -> bool:
        """Whether every choice of the same number of floors is equally good."""
        return self.worst <= (1 + ARBITRARY) * self.bound

    @property
    def std(self) -> dict[str, Floats]:
        """Standard deviations by quantity, shape (N,)."""
        return {"floor_mass": self.floor_mass_std, "story_stiffness": self.story_stiffness_std}


@dataclass(frozen=True)
class ExpectedMode(InJson):
    """Expected properties of a mode.

    Parameters
    ----------
    mode : int
        1 the lowest.
    frequency : float
        Hz.
    frequency_std, mode_shape_std : float
        Relative deviation of the frequency; deviation of a shape entry if the mode's largest entry is 1.
    damping_std : float or None
        Relative deviation of the damping ratio, if the noise is computed from a record.
    """

    mode: int
    frequency: float
    frequency_std: float
    mode_shape_std: float
    damping_std: float | None


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """The result of `plan`.

    Parameters
    ----------
    averaged : AveragedModel
        Frames that the design values allow; objective and standard deviations are averages over these frames.
    criterion, backend : str
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
    grid_bound, grid_worst : float or None
        Lower and upper bound on all tests of the grid of added masses, with the chosen sensors; None if the masses
        were given. The planned masses may lie between the grid's points and be below the lower bound.
    apart : tuple of Chance
        Chance of the right verdict for each effect; empty without effects.
    """

    averaged: AveragedModel
    criterion: str
    backend: str
    tests: tuple[Floats, ...]
    names: tuple[str, ...]
    chosen: ExpectedAccuracy
    fewer: ExpectedAccuracy | None
    more: ExpectedAccuracy | None
    everywhere: ExpectedAccuracy
    grid_bound: float | None
    grid_worst: float | None
    apart: tuple[Chance, ...]

    json_keys = (
        "sensors tests=planned_tests modes=model.numbers noise=model.noise.words expected_modes for=goal criterion "
        "solver=backend objective bound gap floors_arbitrary grid_bound masses_arbitrary=arbitrary_masses "
        "averaged_over=frames frame std=chosen.std one_sensor_less=fewer one_sensor_more=more every_floor=everywhere "
        "apart"
    )

    @property
    def model(self) -> TestModel:
        """The frame as designed, the goal of the plan, the modes and their noise."""
        return self.averaged.frames[0]

    @property
    def frames(self) -> int:
        """Number of frames in the plan's average; 1 if the design values are certain."""
        return len(self.averaged.frames)

    @property
    def arbitrary_masses(self) -> bool:
        """Whether all tests of the grid of added masses are equally good."""
        return self.grid_bound is not None and (self.grid_worst or 0.0) <= (1 + ARBITRARY) * self.grid_bound

    @property
    def misfit(self) -> MeasuredFrequency | None:
        """The measured frequency with the largest error of the plan's frame, if the error exceeds `MISFIT`."""
        worst = max(self.model.design.measured_frequencies(), key=lambda each: abs(each.error), default=None)
        return None if worst is None or abs(worst.error) <= MISFIT else worst

    @property
    def sensors(self) -> list[int]:
        """Floors to measure, 1 the lowest."""
        return [int(floor) for floor in self.chosen.floors]

    @property
    def objective(self) -> float:
        """The criterion's standard deviation."""
        return self.chosen.objective

    @property
    def bound(self) -> float:
        """Lower bound on the objective of any choice of the same number of floors."""
        return self.chosen.bound

    @property
    def gap(self) -> float:
        """Relative difference of the objective and the bound."""
        return self.chosen.gap

    @property
    def expected_modes(self) -> tuple[ExpectedMode, ...]:
        """Modes of the first test, and their expected standard deviations."""
        test = self.model.expected(self.tests[0]).test
        damping_std = self.model.noise.damping_std(test.frequencies)
        of_damping = [None] * len(test.modes) if damping_std is None else damping_std.tolist()
        assert test.mode_shape_std is not None, "an expected test declares its noise"
        stds = test.log_frequency_std.tolist(), test.mode_shape_std[:, 0].tolist()
        columns = zip(test.modes.tolist(), test.frequencies.tolist(), *stds, of_damping, strict=True)
        return tuple(ExpectedMode(*each) for each in columns)

    @property
    def goal(self) -> str:
        """Goal of the plan in words."""
        if self.model.targets:
            return f"telling apart {', '.join(each.placed.label for each in self.model.targets)} and none of them"
        words = {"floor_mass": "floor masses", "story_stiffness": "story stiffnesses"}
        return listed([words[each] for each in self.model.quantities])

    @property
    def measure(self) -> str:
        """Objective in words."""
        return CRITERIA[self.criterion].summary

    @property
    def floors_arbitrary(self) -> bool:
        """Whether floors were chosen, and every choice of the same number is equally good."""
        return self.chosen.arbitrary and len(self.sensors) < self.model.design.stories

    @property
    def planned_tests(self) -> list[dict[str, object]]:
        """Name and added mass (kg) of each test."""
        return [{"name": name, "added_mass": mass} for name, mass in zip(self.names, self.tests, strict=True)]

    @property
    def frame(self) -> dict[str, object]:
        """Frame of the plan."""
        return {key: getattr(self.model.design, key) for key in ("floor_mass", "story_stiffness", "effects", "state")}


def accuracy_curve(plan: Plan) -> list[tuple[int, float, float]]:
    """List numbers of sensors (ascending), the criterion of the best choice found, and its lower bound.

    Parameters
    ----------
    plan : Plan
    """
    by, n = criterion_named(plan.criterion), plan.model.design.stories
    tests = [plan.averaged.expected(masses) for masses in plan.tests]
    spread = np.unique(np.linspace(1, n, min(n, MOST_POINTS)).round().astype(int))
    points = []
    for count in sorted({*spread.tolist(), len(plan.sensors)}):
        found = choose(plan.averaged.sensors(tests, count), count, by, plan.backend)
        points.append((count, found.value, found.bound))
    return points


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
    design = plan.model.design
    before = design.measured.configurations if design.measured is not None else ()
    return Experiment(design.frame, (*before, *tests), design.priors, design.name)


def _at_sensors(test: Configuration, name: str, floors: Ints) -> Configuration:
    """Return a planned test as it would be declared with sensors at these floors, each shape's largest entry 1."""
    entries = test.mode_shapes / np.max(np.abs(test.mode_shapes), axis=1, keepdims=True)
    shapes, std = entries[:, floors], test.mode_shape_std
    assert std is not None, "an expected test declares its noise"
    return dataclasses.replace(
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
