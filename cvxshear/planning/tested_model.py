"""Expected results of tests that have not been made, and their derivatives by the parameters of the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.effects import LocatedEffect, Place, Scale, named
from cvxshear.fit.gaussian import separation
from cvxshear.fit.misfit import ExpectedTest, data_rows, expected_configuration, predicted_modes, tested_model
from cvxshear.measurement.experiment import Frame
from cvxshear.planning.criteria import Candidates, candidates, free_changes
from cvxshear.planning.design import UNKNOWN_STD, Design
from cvxshear.planning.expected_noise import TestNoise
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

FIRM = 0.1
"""Largest relative standard deviation of the design values for a plan at these values alone. The information of a test
depends on the frame: if the stiffnesses have a standard deviation of 30 %, the average expected deviations are 14 %
larger than at the design values, and twice as large in some stories. The difference grows with the square."""

UNKNOWN_STDS = 10.0
"""Prior standard deviation of an unknown parameter, relative to its size. A finite value gives every choice, even of a
single sensor, finite standard deviations to compare."""


@dataclass(frozen=True)
class Target:
    """An effect with one parameter at a place, and its assumed size.

    Parameters
    ----------
    placed : LocatedEffect
    size : float
        Assumed distance of the parameter from its null value, in the parameter's unit.
    unit : str
    """

    placed: LocatedEffect
    size: float
    unit: str = ""

    @property
    def null(self) -> float:
        """Value without an effect."""
        return self.placed.effect.parameters[0].null

    @property
    def mean(self) -> float:
        """Expected value of a present effect, in sizes: 1 if physics confines the value to an interval without 0."""
        return 1.0 if self._confined else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of the value of a present effect, in sizes."""
        item = self.placed.effect.parameters[0]
        return (item.upper - item.lower) / np.sqrt(12) / self.size if self._confined else 1.0

    @property
    def side(self) -> int:
        """1 or -1 if physics allows only values above or only values below the null value; else 0."""
        item = self.placed.effect.parameters[0]
        return 0 if self._confined else int(item.lower == item.null) - int(item.upper == item.null)

    @property
    def _confined(self) -> bool:
        item = self.placed.effect.parameters[0]
        return bool(np.isfinite(item.upper - item.lower)) and not item.lower <= item.null <= item.upper


def target(text: str, frame: Frame, scale: Scale) -> Target:
    """Parse an effect from "NAME" or "NAME@PLACE", optionally followed by "=SIZE".

    Parameters
    ----------
    text : str
        PLACE is a floor or a story, SIZE a change of the effect's parameter in its unit.
    frame : Frame
        Frame with its number of stories.
    scale : Scale
        Scale of the frame, for the expected sizes of effects.

    Raises
    ------
    InputError
        If the effect is unknown, has another kind of place, needs undeclared data, or has no expected size.
    """
    head, _, size = text.partition("=")
    name, _, where = head.strip().partition("@")
    (effect,) = named([name.strip()])
    if "state" in effect.sits_at or len(effect.parameters) != 1:
        raise InputError(
            f"effect {effect.name} sits in a single state of the frame, and no plan is made for it; plan for effects "
            "that are there in every test, such as gravity or joint_rotation"
        )
    if "heights" in effect.needs and frame.story_heights is None:
        raise InputError(f"effect {effect.name} needs frame: story_heights, which is not declared")
    place = _place(effect.name, effect.sits_at, effect.lowest_floor, where.strip(), frame.stories)
    item = effect.parameters[0]
    expected = float(effect.expected_sizes(scale)[0])
    usual = expected if np.isfinite(expected) else abs(item.start - item.null)
    try:
        value = float(size) if size else usual
    except ValueError:
        raise InputError(f"the size in {text!r} must be a number, not {size!r}") from None
    unit = item.unit if frame.story_heights is not None else item.unit_in_stories or item.unit
    return Target(LocatedEffect(effect, place), checks.number(value, f"size of {head.strip()}", above=0.0), unit)


def _place(name: str, sits_at: tuple[str, ...], lowest: int, where: str, stories: int) -> Place:
    """Parse the place after the @."""
    if not sits_at:
        if where:
            raise InputError(f"effect {name} has no place of its own; write {name} alone, not {name}@{where}")
        return Place()
    kind = sits_at[0]
    if not where.isdigit():
        raise InputError(f"effect {name} sits at a {kind}; write which, such as {name}@{max(lowest, 2)}")
    number = checks.whole(int(where), f"{kind} of effect {name}", least=lowest if kind == "floor" else 1, most=stories)
    return Place(floor=number) if kind == "floor" else Place(story=number)


@dataclass(frozen=True, eq=False)
class TestModel:
    """One frame, the goal of the plan, and the noise of its tests.

    Parameters
    ----------
    design : Design
    targets : tuple of Target
        Effects that the plan shall distinguish; without targets, the goal is the frame's parameters.
    quantities : tuple of str
        "floor_mass", "story_stiffness", or both: the goal of a plan without targets.
    which : ndarray of int, shape (m,)
        Modes that are measured, zero-based.
    noise : TestNoise
    """

    design: Design
    targets: tuple[Target, ...]
    quantities: tuple[str, ...]
    which: Ints
    noise: TestNoise

    @property
    def numbers(self) -> Ints:
        """Numbers of the modes that are measured, 1 the lowest; shape (m,)."""
        return self.which + 1

    @property
    def effects(self) -> tuple[LocatedEffect, ...]:
        """Effects of the model: the effects found before, then the targets."""
        return (*self.design.effects, *(each.placed for each in self.targets))

    @property
    def certain(self) -> int:
        """Number of parameters before the targets' parameters: masses, stiffnesses, values of the effects found."""
        return len(self.design.theta)

    @property
    def theta(self) -> Floats:
        """Parameters: floor masses, story stiffnesses, the effects' values, the targets' null values; shape (P,)."""
        return np.concatenate([self.design.theta, [each.null for each in self.targets]])

    @property
    def units(self) -> Floats:
        """Size of each parameter, shape (P,)."""
        return np.concatenate([self.design.units, [each.size for each in self.targets]])

    @cached_property
    def question(self) -> Floats:
        """Rows that select the parameters of the plan's goal, shape (s, P)."""
        n, P = self.design.stories, len(self.units)
        if self.targets:
            return np.eye(P)[self.certain :]
        at = {"floor_mass": slice(0, n), "story_stiffness": slice(n, 2 * n)}
        picked = np.concatenate([np.eye(P)[at[each]] for each in self.quantities])
        # A parameter that is known exactly is not part of the goal.
        return np.asarray(picked[np.linalg.norm(picked @ free_changes(self.fixed), axis=1) > 1e-9])

    @cached_property
    def fixed(self) -> Floats:
        """Rows whose product with every allowed change is zero, shape (e, P)."""
        rows = self.design.fixed()
        return np.hstack([rows, np.zeros((len(rows), len(self.units) - rows.shape[1]))])

    @cached_property
    def learned(self) -> Floats:
        """Prior information as rows divided by their standard deviations, shape (k, P)."""
        rows = self.design.known([each.placed for each in self.targets], [each.null for each in self.targets])
        return np.asarray(rows * np.concatenate([np.ones(self.certain), [each.size for each in self.targets]]))

    @cached_property
    def known(self) -> Floats:
        """Rows of `learned`, and a weak prior of every parameter (`UNKNOWN_STDS`), shape (k + P, P)."""
        return np.concatenate([self.learned, np.eye(len(self.units)) / UNKNOWN_STDS])

    def expected(self, added_mass: Floats) -> ExpectedTest:
        """Predict a test with these added masses; derivatives are relative to the parameters' sizes."""
        blank = self.design.blank(added_mass, self.numbers)
        model = tested_model(self.design.shell(), blank, self.effects, self.theta)
        stds = self.noise.of(model.modes, np.diag(model.state.system.M), model.paired)
        frequencies, shapes = predicted_modes(blank, model)
        shape_std = np.repeat(stds[1][:, None], shapes.shape[1], axis=1)
        test = expected_configuration(blank, frequencies, shapes, stds[0], shape_std)
        return ExpectedTest(test, data_rows(test, model).J * self.units, test.measured)

    def sensors(self, tests: Sequence[ExpectedTest], number: int) -> Candidates:
        """Return the floors as candidates; each floor is measured in all of these tests."""
        m, scales, P = len(self.which), len(self.which) * len(tests), len(self.units)
        n = self.design.stories
        rows = np.zeros((n, scales, P + scales))
        for t, test in enumerate(tests):
            own = slice(t * m, (t + 1) * m)
            rows[:, own, :P] = test.shape_rows.swapaxes(0, 1)
            rows[:, np.arange(own.start, own.stop), P + np.arange(own.start, own.stop)] = test.entries.T
        known = linalg.block_diag(
            np.concatenate([self.known, *(test.frequency_rows for test in tests)]), np.eye(scales) / UNKNOWN_STDS
        )
        wide = [np.hstack([part, np.zeros((len(part), scales))]) for part in (self.fixed, self.question)]
        return candidates(known, wide[0], rows, wide[1], number / n)

    def choices(self, tests: Sequence[ExpectedTest], floors: Ints, number: int) -> Candidates:
        """Return the tests as candidates; each test is measured at these floors."""
        rows = np.array([test.at(floors) for test in tests])
        return candidates(self.known, self.fixed, rows, self.question, number / len(tests))

    def covariance(self, tests: Sequence[ExpectedTest], floors: Ints) -> Floats:
        """Covariance of all parameters, relative to their sizes, after these tests at these floors, shape (P, P)."""
        rows = np.concatenate([self.known, *(test.at(floors) for test in tests)])
        free = free_changes(self.fixed)
        half = free @ np.linalg.inv(np.linalg.qr(rows @ free, mode="r"))
        return np.asarray(half @ half.T)

    def of_targets(self, tests: Sequence[ExpectedTest], floors: Ints) -> Floats:
        """Compute the information about the targets after these tests at these floors, shape (e, e).

        The frame's parameters are unknown, too. For a single target, the information is the square of its size in
        standard deviations.
        """
        rows = np.concatenate([self.learned, *(test.at(floors) for test in tests)])
        first = self.certain
        frame = UNKNOWN_STDS * rows[:, :first] @ free_changes(self.fixed[:, :first])
        found = separation(rows[:, first:], frame)
        return found + np.eye(len(found)) / UNKNOWN_STDS**2


Test = tuple[ExpectedTest, ...]
"""Expected results of one test, for each frame that the design values allow."""


@dataclass(frozen=True, eq=False)
class AveragedModel:
    """Frames that the design values allow; the expected deviations of a plan are averages over them.

    Parameters
    ----------
    frames : tuple of TestModel
        The frame as designed comes first. No other frame follows if the design values are certain to `FIRM`.
    """

    frames: tuple[TestModel, ...]

    @staticmethod
    def around(model: TestModel) -> AveragedModel:
        """Return the frames that the design values of a model allow."""
        return AveragedModel(tuple(dataclasses.replace(model, design=each) for each in possible(model.design)))

    def expected(self, added_mass: Floats) -> Test:
        """Predict the modes of a test with these added masses, for each frame."""
        return tuple(each.expected(added_mass) for each in self.frames)

    def sensors(self, tests: Sequence[Test], number: int) -> Candidates:
        """Return the floors as candidates; each floor is measured in all of these tests."""
        return Candidates.averaged([each.sensors(own, number) for each, own in self._by_frame(tests)])

    def choices(self, tests: Sequence[Test], floors: Ints, number: int) -> Candidates:
        """Return the tests as candidates; each test is measured at these floors."""
        return Candidates.averaged([each.choices(own, floors, number) for each, own in self._by_frame(tests)])

    def shear_covariance(self, tests: Sequence[Test], floors: Ints) -> Floats:
        """Return the relative covariance of masses and stiffnesses without the targets, shape (2N, 2N): a mean."""
        found = []
        for each, own in self._by_frame(tests):
            shear = dataclasses.replace(each, targets=(), quantities=())
            bare = [dataclasses.replace(test, rows=test.rows[:, : each.certain]) for test in own]
            n = 2 * each.design.stories
            found.append(shear.covariance(bare, floors)[:n, :n])
        return np.asarray(np.mean(found, axis=0))

    def of_targets(self, tests: Sequence[Test], floors: Ints) -> Floats:
        """Compute the information about the targets on each frame, shape (q, e, e)."""
        return np.array([each.of_targets(own, floors) for each, own in self._by_frame(tests)])

    def _by_frame(self, tests: Sequence[Test]) -> list[tuple[TestModel, list[ExpectedTest]]]:
        return [(each, [test[place] for test in tests]) for place, each in enumerate(self.frames)]


def possible(
    design: Design, fewest: int = 4, most: int = 16, stories: int = 160, seed: int = 2024
) -> tuple[Design, ...]:
    """Return the frame as designed, then other frames that its design values allow; none if the values are certain.

    Masses and stiffnesses are drawn from the prior in pairs symmetric to the design values. Mean and variance of each
    parameter agree with the prior. Parameters without prior information keep their design values.

    Parameters
    ----------
    design : Design
    fewest, most : int, optional
        Number of pairs. With 16 pairs and stiffnesses known to 30 %, expected deviations are on average within 2 % of
        the mean over 200 frames (`python -m tests.studies planning vague`).
    stories : int, optional
        Number of stories in all pairs together: each pair of a tall frame takes longer and draws more stories.
    seed : int, optional
        A fixed seed makes plans repeatable.
    """
    free = free_changes(design.fixed())
    known = design.known()[:, : len(design.sizes)] @ free
    information, axes = np.linalg.eigh(known.T @ known)
    somewhat = information > UNKNOWN_STD**-2
    root = free @ (axes[:, somewhat] / np.sqrt(information[somewhat]))
    if np.max(np.linalg.norm(root, axis=1), initial=0.0) <= FIRM * (1 + 1e-9):
        return (design,)
    pairs = int(np.clip(stories // design.stories, fewest, most))
    z = np.random.default_rng(seed).standard_normal((pairs, root.shape[1]))
    # The designed frame is one of the sample: without this factor the sample's variance would be too small.
    z *= np.sqrt((2 * pairs + 1) / (2 * np.sum(z**2, axis=0)))
    return (design, *(_moved(design, root @ each) for each in (*z, *-z)))


def _moved(design: Design, change: Floats) -> Design:
    """Change masses and stiffnesses by these relative amounts; an exactly known total mass stays as declared."""
    # Below -0.5 the logarithm is changed instead, which keeps every value positive.
    factor = np.where(change > -0.5, 1 + change, 0.5 * np.exp(2 * np.minimum(change, 0.0) + 1))
    mass, stiffness = np.split(design.sizes * factor, 2)
    frame = design.frame
    if frame.total_mass is not None and frame.floor_masses is None and frame.total_mass_std is None:
        mass *= design.floor_mass.sum() / mass.sum()
    return dataclasses.replace(design, floor_mass=mass, story_stiffness=stiffness)
