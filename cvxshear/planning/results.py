"""What planning returns."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from cvxshear.fit.results import plain
from cvxshear.planning.apart import Apart
from cvxshear.planning.criteria import CRITERIA
from cvxshear.planning.model import TestModel
from cvxshear.util.showing import Shown
from cvxshear.util.typing import Floats, Ints, Json

OPEN = 1.0
"""Relative standard deviation from which on a parameter counts as not determined."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """What is expected with sensors on some floors.

    Parameters
    ----------
    floors : ndarray of int, shape (N,)
        1 the lowest.
    objective : float
        The criterion's standard deviation, relative (to the effects' sizes where the plan is for effects).
    bound : float
        What no choice of as many floors can beat in these tests.
    floor_mass_std, story_stiffness_std : ndarray, shape (N,)
        kg and N/m, of the shear model; nan where it stays open.
    """

    floors: Ints
    objective: float
    bound: float
    floor_mass_std: Floats
    story_stiffness_std: Floats

    @property
    def gap(self) -> float:
        """How far the choice is above what none can beat, relative."""
        return self.objective / self.bound - 1.0 if self.bound > 0 else float("inf")

    def to_dict(self) -> Json:
        """The fields by name."""
        return {
            "sensors": self.floors.tolist(),
            "objective": self.objective,
            "std": {"floor_mass": plain(self.floor_mass_std), "story_stiffness": plain(self.story_stiffness_std)},
        }


@dataclass(frozen=True)
class ExpectedMode:
    """A mode before it is measured.

    Parameters
    ----------
    mode : int
        1 the lowest.
    frequency : float
        Hz.
    frequency_std, mode_shape_std : float
        Relative; of an entry, the mode's largest being 1.
    damping_std : float or None
        Relative, of the damping ratio, where the noise follows from a record.
    """

    mode: int
    frequency: float
    frequency_std: float
    mode_shape_std: float
    damping_std: float | None

    def to_dict(self) -> Json:
        """The fields by name."""
        return asdict(self)


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """The result of `plan`.

    Parameters
    ----------
    model : TestModel
        The frame, what the plan is for, the modes and their noise.
    criterion, solver : str
    tests : tuple of ndarray, shape (N,)
        Added mass of each, kg.
    names : tuple of str
        Of the tests.
    chosen : Outlook
        With the sensors of the plan.
    fewer, more : Outlook or None
        With the best choice of one sensor less, and one more.
    everywhere : Outlook
        With every floor measured.
    tests_bound : float or None
        What no tests of the grid can beat with the chosen sensors, where the masses were chosen.
    apart : tuple of Apart
        How far the effects are told apart; empty where the plan is for the frame.
    """

    model: TestModel
    criterion: str
    solver: str
    tests: tuple[Floats, ...]
    names: tuple[str, ...]
    chosen: Outlook
    fewer: Outlook | None
    more: Outlook | None
    everywhere: Outlook
    tests_bound: float | None
    apart: tuple[Apart, ...]

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
        """What no choice of as many floors can beat in these tests."""
        return self.chosen.bound

    @property
    def gap(self) -> float:
        """How far the choice is above the bound, relative."""
        return self.chosen.gap

    @property
    def expected_modes(self) -> tuple[ExpectedMode, ...]:
        """The modes of the first test, and how well they will be known."""
        which, noise = self.model.which, self.model.noise
        first = self.model.expected(self.tests[0])
        frequencies = first.found.frequencies[which]
        damping_std = noise.damping_std(frequencies)
        return tuple(
            ExpectedMode(
                int(mode) + 1,
                float(frequencies[i]),
                float(first.frequency_std[i]),
                float(first.shape_std[i, 0]),
                None if damping_std is None else float(damping_std[i]),
            )
            for i, mode in enumerate(which)
        )

    @property
    def goal(self) -> str:
        """What the plan is for, in words."""
        if self.model.targets:
            return f"telling apart {', '.join(each.placed.label for each in self.model.targets)} and none of them"
        words = {"floor_mass": "floor masses", "story_stiffness": "story stiffnesses"}
        return " and ".join(words[each] for each in self.model.quantities)

    @property
    def measure(self) -> str:
        """What the objective is, in words."""
        return CRITERIA[self.criterion].summary

    def to_dict(self) -> Json:
        """The documented JSON."""
        design = self.model.design
        return {
            "sensors": self.sensors,
            "tests": [
                {"name": name, "added_mass": test.tolist()} for name, test in zip(self.names, self.tests, strict=True)
            ],
            "modes": (self.model.which + 1).tolist(),
            "noise": self.model.noise.describe(),
            "expected_modes": [each.to_dict() for each in self.expected_modes],
            "for": self.goal,
            "criterion": self.criterion,
            "solver": self.solver,
            "objective": self.objective,
            "bound": self.bound,
            "gap": self.gap if np.isfinite(self.gap) else None,
            "tests_bound": self.tests_bound,
            "frame": {
                "floor_mass": design.floor_mass.tolist(),
                "story_stiffness": design.story_stiffness.tolist(),
            },
            "std": self.chosen.to_dict()["std"],
            "one_sensor_less": None if self.fewer is None else self.fewer.to_dict(),
            "one_sensor_more": None if self.more is None else self.more.to_dict(),
            "every_floor": self.everywhere.to_dict(),
            "apart": [each.to_dict() for each in self.apart],
        }
