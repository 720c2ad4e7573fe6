"""Results of planning: the choice and its expected accuracy, and the planned tests as a file to fill in."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cvxshear.fit.gaussian import log_evidence_of_one
from cvxshear.io.toml import write_measurement
from cvxshear.loop.posterior import ADDED
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.planning.criteria import CRITERIA
from cvxshear.planning.design import MeasuredFrequency
from cvxshear.planning.tested_model import AveragedModel, Target, TestModel
from cvxshear.util.odds import weigh
from cvxshear.util.quantities import SURE, listed
from cvxshear.util.results import InJson, Shown
from cvxshear.util.typing import Floats, Ints, Json

ARBITRARY = 0.01
"""Largest relative difference of best and worst choice that counts as equal; the noise is not known to one percent."""

MISFIT = 0.02
"""Least relative error of the frame's frequencies that a plan reports: ten times the default noise of frequencies."""

SUFFICES = 0.9
"""Least probability of the right verdict of a sufficient test: nine tests in ten."""

NONE = "none of them"
"""Label of the possibility without any effect."""


@dataclass(frozen=True)
class Chance(InJson):
    """Chance of the right verdict for one possibility.

    Parameters
    ----------
    label : str
        The effect at its place, or "none of them".
    size : float or None
        Expected size of the effect.
    unit : str or None
        Unit of the size.
    distance : float or None
        Distance from no effect, in standard deviations, with the frame's parameters unknown.
    nearest : str or None
        The possibility that is hardest to distinguish from this one.
    nearest_distance : float or None
        Distance from the nearest possibility, in standard deviations, for any size of the other effect.
    probability : float
        Probability of the right verdict if this possibility is true.
    """

    label: str
    size: float | None
    unit: str | None
    distance: float | None
    nearest: str | None
    nearest_distance: float | None
    probability: float

    json_keys = (
        "effect=label size unit standard_deviations=distance nearest "
        "nearest_standard_deviations=nearest_distance probability"
    )

    @property
    def suffices(self) -> bool:
        """Whether these tests are sufficient for this possibility."""
        return self.probability >= SUFFICES


def chances(targets: Sequence[Target], information: Floats) -> tuple[Chance, ...]:
    """Compute the chance of the right verdict for each possibility: no effect, or one of the effects.

    In a linear model with Gaussian noise, the data determine the effects by y = G x + e. Here x are the effects' values
    relative to their expected sizes, G is the information about the effects with the frame's masses and stiffnesses
    marginalized, and cov(e) = G. The evidence of each single effect and even prior odds give the probability of each
    effect. If an effect is present, the verdict is right if this effect is certain. If no effect is present, the
    verdict is right if all effects stay below the limit for adding an effect.

    Parameters
    ----------
    targets : sequence of Target
    information : ndarray, shape (q, e, e)
        G for each frame that the design values allow; distances and probabilities are averages over these frames.
    """
    right = np.mean([_right(targets, G) for G in information], axis=0)
    own = np.mean(np.sqrt(np.diagonal(information, axis1=1, axis2=2)), axis=0)
    pairs = np.mean([_distances(targets, G) for G in information], axis=0)
    least = int(np.argmin(own))
    result = [Chance(NONE, None, None, None, targets[least].placed.label, float(own[least]), float(right[0]))]
    for i, each in enumerate(targets):
        near = [(float(own[i]), NONE)]
        near += [(float(pairs[i, j]), other.placed.label) for j, other in enumerate(targets) if j != i]
        distance, nearest = min(near)
        result.append(
            Chance(each.placed.label, each.size, each.unit, float(own[i]), nearest, distance, float(right[i + 1]))
        )
    return tuple(result)


def _distances(targets: Sequence[Target], G: Floats) -> Floats:
    """Compute the distance of each effect (row) from the nearest value of each other effect, shape (e, e).

    Distances are in standard deviations. Only physically possible values count.
    """
    own = np.diag(G)
    allowed = np.array([[G[i, j] * other.side >= 0 for j, other in enumerate(targets)] for i in range(len(targets))])
    return np.asarray(np.sqrt(np.maximum(own[:, None] - np.where(allowed, G**2 / own[None, :], 0.0), 0.0)))


def _right(targets: Sequence[Target], G: Floats, draws: int = 20_000, seed: int = 2014) -> list[float]:
    """Compute the probability of the right verdict without any effect, and with each effect.

    It is the share of simulated outcomes; the standard error of 90 % is 0.2 %. A fixed seed makes plans repeatable.
    """
    noise = np.random.default_rng(seed).standard_normal((draws, len(targets))) @ np.linalg.cholesky(G).T
    result = []
    for truth in range(len(targets) + 1):
        y = noise if truth == 0 else noise + G[:, truth - 1]
        found = [log_evidence_of_one(float(G[i, i]), y[:, i], t.mean, t.std, t.side) for i, t in enumerate(targets)]
        evidence = np.stack([np.zeros(draws), *found], axis=1)
        likely = weigh(evidence)
        right = likely[:, truth] >= SURE if truth else likely[:, 1:].max(axis=1) < ADDED
        result.append(float(np.mean(right)))
    return result


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
    total_mass_std : float
        Relative, of the total mass.
    """

    floors: Ints
    objective: float
    bound: float
    worst: float
    floor_mass_std: Floats
    story_stiffness_std: Floats
    total_mass_std: float

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
        were given.
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
    def typical_std(self) -> tuple[float, float]:
        """Root mean square of the relative standard deviations of floor masses and of story stiffnesses."""
        design = self.model.design
        parts = self.chosen.floor_mass_std / design.floor_mass, self.chosen.story_stiffness_std / design.story_stiffness
        mass, stiffness = (float(np.sqrt(np.mean(part**2))) for part in parts)
        return mass, stiffness

    @property
    def rests_on_total(self) -> bool:
        """Whether the total mass causes more than half of the variance of a floor mass."""
        return 2 * self.chosen.total_mass_std**2 > self.typical_std[0] ** 2

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
