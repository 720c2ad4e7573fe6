"""The tests of a frame before they are made: what each would tell, by the model's own derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from cvxshear.effects import Placed, compose
from cvxshear.fit.separation import told
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import Modes, mode_derivatives, modes
from cvxshear.planning.candidates import Candidates, candidates
from cvxshear.planning.design import Design
from cvxshear.planning.noise import TestNoise
from cvxshear.planning.targets import Target
from cvxshear.util.typing import Floats, Ints

VAGUE = 10.0
"""Standard deviation, in its own size, of a parameter of which nothing is known: everything is known a little, so that
every choice, of a single sensor too, has finite standard deviations to compare."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What a test is expected to show, and its derivatives by all P parameters, each in its own size.

    Parameters
    ----------
    found : Modes
        Of the frame with the test's masses.
    frequency_std : ndarray, shape (m,)
        Relative.
    shapes, shape_std : ndarray, shape (m, N)
        Measured modes at every floor, largest entry 1, and the entries' standard deviations.
    frequency_rows : ndarray, shape (m, P)
        In standard deviations.
    shape_rows : ndarray, shape (N, m, P)
        The same, a block a floor.
    """

    found: Modes
    frequency_std: Floats
    shapes: Floats
    shape_std: Floats
    frequency_rows: Floats
    shape_rows: Floats

    @property
    def entries(self) -> Floats:
        """Derivatives of the entries by the logarithm of their mode's scale, in standard deviations, shape (N, m)."""
        result: Floats = (self.shapes / self.shape_std).T
        return result

    def at(self, floors: Ints) -> Floats:
        """What is measured at these floors (zero-based), each shape's scale eliminated, shape (m + m n, P)."""
        rows, entries = self.shape_rows[floors], self.entries[floors]
        length = np.linalg.norm(entries, axis=0)
        unit = entries / np.where(length > 0, length, 1.0)
        own = rows - unit[:, :, None] * np.einsum("jm,jmp->mp", unit, rows)
        return np.concatenate([self.frequency_rows, own.reshape(-1, rows.shape[2])])


@dataclass(frozen=True, eq=False)
class TestModel:
    """A frame, what the plan is for, and how its tests are measured.

    Parameters
    ----------
    design : Design
    targets : tuple of Target
        Effects to tell apart; where there are none the plan is for the frame.
    quantities : tuple of str
        Of "floor_mass", "story_stiffness": what the plan is for without targets.
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
    def effects(self) -> tuple[Placed, ...]:
        """The effects of the model, free to be there or not."""
        return tuple(each.placed for each in self.targets)

    @property
    def theta(self) -> Floats:
        """The parameters: floor masses, story stiffnesses, the effects' null values; shape (P,)."""
        return np.concatenate([self.design.sizes, [each.null for each in self.targets]])

    @property
    def units(self) -> Floats:
        """The size of each parameter, shape (P,)."""
        return np.concatenate([self.design.sizes, [each.size for each in self.targets]])

    @cached_property
    def question(self) -> Floats:
        """Rows that pick what the plan is for, shape (s, P)."""
        n, P = self.design.stories, len(self.units)
        if self.targets:
            return np.eye(P)[2 * n :]
        at = {"floor_mass": slice(0, n), "story_stiffness": slice(n, 2 * n)}
        picked = np.concatenate([np.eye(P)[at[each]] for each in self.quantities])
        # What is known exactly is no part of the question.
        fixed = self.fixed
        free = linalg.null_space(fixed, rcond=1e-12) if len(fixed) else np.eye(P)
        result: Floats = picked[np.linalg.norm(picked @ free, axis=1) > 1e-9]
        return result

    @cached_property
    def fixed(self) -> Floats:
        """Rows on which every change is zero, shape (e, P)."""
        rows = self.design.fixed()
        return np.hstack([rows, np.zeros((len(rows), len(self.targets)))])

    @cached_property
    def learned(self) -> Floats:
        """What is known before the test, rows in standard deviations, shape (k, P)."""
        e = len(self.targets)
        values = np.array([each.null for each in self.targets])
        rows = self.design.known(self.effects, values)
        if e:
            rows = np.hstack([rows[:, :-e], rows[:, -e:] * self.units[-e:]])
        return rows

    @cached_property
    def known(self) -> Floats:
        """The same, and that everything is known a little."""
        return np.concatenate([self.learned, np.eye(len(self.units)) / VAGUE])

    def expected(self, added_mass: Floats) -> Expected:
        """What a test with these masses would show."""
        blank = blank_test(added_mass, "planned test")
        state = compose(_shell(self.design), blank, self.effects, self.theta)
        found = modes(state.system.M, state.system.K)
        dlam, dphi = mode_derivatives(found, state.system, self.which)
        mass = self.design.floor_mass + added_mass
        frequency_std, mode_std = self.noise.of(found, mass, self.which)
        psi = state.observation.shown(found.shapes[self.which])
        dpsi = state.observation.shown_slopes(found.shapes[self.which], dphi, slice(None))
        largest = np.max(np.abs(psi), axis=1, keepdims=True)
        std = np.repeat(mode_std[:, None], psi.shape[1], axis=1)
        frequency = dlam * self.units[:, None] / (2 * found.eigenvalues[self.which]) / frequency_std
        shape = dpsi * self.units[:, None, None] / largest / std
        return Expected(found, frequency_std, psi / largest, std, frequency.T, shape.transpose(2, 1, 0))

    def sensors(self, tests: Sequence[Expected], number: int) -> Candidates:
        """The floors as candidates, measured in every one of these tests."""
        m, scales, P = len(self.which), len(self.which) * len(tests), len(self.units)
        n = self.design.stories
        rows = np.zeros((n, scales, P + scales))
        for t, test in enumerate(tests):
            own = slice(t * m, (t + 1) * m)
            rows[:, own, :P] = test.shape_rows
            rows[:, np.arange(own.start, own.stop), P + np.arange(own.start, own.stop)] = test.entries
        known = linalg.block_diag(
            np.concatenate([self.known, *(test.frequency_rows for test in tests)]), np.eye(scales) / VAGUE
        )
        wide = [np.hstack([part, np.zeros((len(part), scales))]) for part in (self.fixed, self.question)]
        return candidates(known, wide[0], rows, wide[1], number / n)

    def choices(self, tests: Sequence[Expected], floors: Ints, number: int) -> Candidates:
        """Tests as candidates, each measured at these floors."""
        rows = np.array([test.at(floors) for test in tests])
        return candidates(self.known, self.fixed, rows, self.question, number / len(tests))

    def covariance(self, tests: Sequence[Expected], floors: Ints) -> Floats:
        """Covariance of all parameters, each in its own size, after these tests at these floors, shape (P, P)."""
        rows = np.concatenate([self.known, *(test.at(floors) for test in tests)])
        free = linalg.null_space(self.fixed, rcond=1e-12) if len(self.fixed) else np.eye(rows.shape[1])
        root = np.linalg.inv(np.linalg.qr(rows @ free, mode="r"))
        half = free @ root
        result: Floats = half @ half.T
        return result

    def told_of_effects(self, tests: Sequence[Expected], floors: Ints) -> Floats:
        """Information about the effects' values after these tests at these floors, the frame following, shape (e, e).

        Of a single effect, of its size: the square of how many standard deviations it is from none.
        """
        rows = np.concatenate([self.learned, *(test.at(floors) for test in tests)])
        frame = 2 * self.design.stories
        fixed = self.fixed[:, :frame]
        free = linalg.null_space(fixed, rcond=1e-12) if len(fixed) else np.eye(frame)
        found = told(rows[:, frame:], VAGUE * rows[:, :frame] @ free)
        return found + np.eye(len(found)) / VAGUE**2


def blank_test(added_mass: Floats, name: str) -> Configuration:
    """A configuration with these masses that nothing was measured on yet."""
    n = len(added_mass)
    return Configuration(
        frequencies=np.array([1.0]), mode_shapes=np.full((1, n), np.nan), added_mass=np.array(added_mass), name=name
    )


def _shell(design: Design) -> Experiment:
    """An experiment that holds the frame's dimensions for the forward model; its masses are those expected."""
    frame = dataclasses.replace(design.frame, floor_masses=design.floor_mass, total_mass=None)
    return Experiment(frame, (blank_test(np.zeros(design.stories), "none"),))
