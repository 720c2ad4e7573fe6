"""Which masses to add: the best of a grid of tests, then what is between the grid's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint

from cvxshear.planning.criteria import Criterion
from cvxshear.planning.descent import descended
from cvxshear.planning.model import Expected, TestModel
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

PARTS = (0.5, 1.0)
"""Of what a floor can carry, that the grid's tests put on it."""

MOST_REFINED = 60
"""Masses of all tests together up to which they are refined between the points of the grid."""

ROUNDS = 15
"""Of the refinement; its gradient takes a test's modes for each mass."""

STEP = 1e-3
"""Of the limit: the step of the gradient's differences."""

DIGITS = 2
"""Decimals, of the limit in percent, that a refined mass is given with: nobody weighs finer."""


@dataclass(frozen=True, eq=False)
class Limits:
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
    def of(floor: object, total: object, stories: int) -> Limits:
        """The limits that options declare: one number or one a floor, and a number or nothing for all together."""
        if floor is None:
            if total is not None:
                raise InputError("a limit of the added mass in all needs one of each floor: give added_mass as well")
            return Limits(np.zeros(stories), 0.0)
        each = checks.one_or_many(floor, "added_mass", stories, of=", one a floor", least=0.0)
        whole = float(each.sum()) if total is None else checks.number(total, "added_mass_total", least=0.0)
        return Limits(each, min(whole, float(each.sum())))

    @property
    def any(self) -> bool:
        """Whether anything can be added."""
        return self.total > 0

    def grid(self) -> list[Floats]:
        """Tests to choose from: nothing, each floor alone, all floors, the lower and the upper half; none twice."""
        n = len(self.floor)
        patterns = [np.zeros(n), *np.eye(n), np.ones(n)]
        if n > 2:
            half = np.arange(n) < n // 2
            patterns += [half.astype(float), (~half).astype(float)]
        tests = [self._within(part * pattern * self.floor) for pattern in patterns for part in PARTS]
        return list({tuple(np.round(test, 9)): test for test in tests}.values())

    def _within(self, test: Floats) -> Floats:
        """The test, made smaller where it is too heavy in all."""
        result: Floats = test * min(1.0, self.total / max(float(test.sum()), 1e-300))
        return result

    def practical(self, test: Floats) -> Floats:
        """The masses as one would weigh them, within the limits."""
        largest = float(self.floor.max())
        result: Floats = np.minimum(np.round(test / largest, DIGITS) * largest, self.floor)
        return self._within(result)


def value_of(model: TestModel, tests: Sequence[Expected], floors: Ints, by: Criterion) -> float:
    """The criterion of these tests at these floors."""
    of = model.choices(tests, floors, len(tests))
    return float(by.value(of, of.information(np.ones(len(tests)))))


def refined(model: TestModel, tests: Sequence[Floats], floors: Ints, by: Criterion, limits: Limits) -> list[Floats]:
    """The tests with masses between the grid's points, where these are better.

    Parameters
    ----------
    model : TestModel
    tests : sequence of ndarray, shape (N,)
        kg.
    floors : ndarray of int
        Measured, zero-based.
    by : Criterion
    limits : Limits
    """
    free = np.flatnonzero(limits.floor > 0)
    count, size = len(tests), len(free)
    if not size or count * size > MOST_REFINED:
        return list(tests)
    scale = limits.floor[free]

    def masses(x: Floats) -> list[Floats]:
        result = np.zeros((count, len(limits.floor)))
        result[:, free] = np.clip(x.reshape(count, size), 0.0, 1.0) * scale
        return list(result)

    def value(expected: Sequence[Expected]) -> float:
        return float(np.log(value_of(model, expected, floors, by)))

    def both(x: Floats) -> tuple[float, Floats]:
        here = [model.expected(test) for test in masses(x)]
        now, slope = value(here), np.zeros(len(x))
        for place in range(len(x)):
            # Into the interior, so that no mass becomes negative or too large.
            step = STEP if x[place] < 0.5 else -STEP
            moved, test = x.copy(), place // size
            moved[place] += step
            there = [*here[:test], model.expected(masses(moved)[test]), *here[test + 1 :]]
            slope[place] = (value(there) - now) / step
        return now, slope

    start = np.concatenate([test[free] / scale for test in tests])
    heavy = np.kron(np.eye(count), scale)
    within = LinearConstraint(heavy, -np.inf, limits.total)
    found = descended(both, start, within, ROUNDS, tolerance=1e-4)
    better = [limits.practical(test) for test in masses(found)]
    before, after = ([model.expected(test) for test in some] for some in (tests, better))
    return better if value(after) < value(before) else list(tests)
