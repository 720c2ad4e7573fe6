"""Expected results of tests that have not been made: their noise, their information, and the covariance they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from cvxshear.fit import misfit
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration
from cvxshear.planning.choice import Candidates, candidates, free_changes
from cvxshear.planning.design import Design
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats, Ints

#: Prior standard deviation of an unknown parameter, relative to its size. A finite value gives every choice, even of a
#: single sensor, finite standard deviations to compare.
UNKNOWN_STDS = 10.0


@dataclass(frozen=True)
class Declared:
    """Noise that is the same for every mode.

    Parameters
    ----------
    frequency_std, mode_shape_std : float
        Relative deviation of a frequency; deviation of a shape entry if the mode's largest entry is 1.
    """

    frequency_std: float = DEFAULT_FREQUENCY_STD
    mode_shape_std: float = DEFAULT_MODE_SHAPE_STD

    def __post_init__(self) -> None:
        checks.number(self.frequency_std, "frequency_std", above=0.0)
        checks.number(self.mode_shape_std, "mode_shape_std", above=0.0)

    @staticmethod
    def of_tests(tests: Sequence[Configuration]) -> Declared:
        """Return the median of the tests' declared deviations; the default if the tests declare none."""
        if not tests:
            return Declared()
        frequency = np.concatenate([each.log_frequency_std for each in tests])
        # A shape without measured entries has no deviations.
        shapes = [
            (each.entry_std / np.max(np.abs(each.known_shapes), axis=1, keepdims=True))[each.measured]
            for each in tests
            if np.all(np.any(each.measured, axis=1))
        ]
        shape = float(np.median(np.concatenate(shapes))) if shapes else DEFAULT_MODE_SHAPE_STD
        return Declared(float(np.median(frequency)), shape)

    @property
    def words(self) -> str:
        """Description of the noise, as a part of a sentence."""
        return f"frequencies to {100 * self.frequency_std:.3g} %, shapes to {100 * self.mode_shape_std:.3g} %"


@dataclass(frozen=True, eq=False)
class TestModel:
    """The frame as designed, the goal of the plan, and the noise of its tests.

    Parameters
    ----------
    design : Design
    quantities : tuple of str
        "floor_mass", "story_stiffness", or both: the goal of the plan.
    which : ndarray of int, shape (m,)
        Modes that are measured, zero-based.
    noise : Declared
    """

    design: Design
    quantities: tuple[str, ...]
    which: Ints
    noise: Declared

    @property
    def numbers(self) -> Ints:
        """Numbers of the modes that are measured, 1 the lowest; shape (m,)."""
        return self.which + 1

    @cached_property
    def question(self) -> Floats:
        """Rows that select the parameters of the plan's goal, shape (s, 2N)."""
        every = np.eye(2 * self.design.stories)
        picked = np.concatenate([every[self.design.place(each)] for each in self.quantities])
        # A parameter that is known exactly is not part of the goal.
        return np.asarray(picked[np.linalg.norm(picked @ free_changes(self.fixed), axis=1) > 1e-9])

    @cached_property
    def fixed(self) -> Floats:
        """Rows whose product with every allowed relative change is zero, shape (e, 2N)."""
        return self.design.fixed()

    @cached_property
    def known(self) -> Floats:
        """Prior information as rows in standard deviations, with a weak prior of every parameter, shape (k, 2N)."""
        return np.concatenate([self.design.known(), np.eye(2 * self.design.stories) / UNKNOWN_STDS])

    def expected(self, added_mass: Floats) -> misfit.ExpectedTest:
        """Predict a test with these added masses; derivatives are relative to the parameters' sizes."""
        blank = self.design.blank(added_mass, self.numbers)
        model = misfit.tested_model(self.design.shell(), blank, (), self.design.sizes)
        frequencies, shapes = misfit.predicted_modes(blank, model)
        frequency_std = np.full(len(frequencies), self.noise.frequency_std)
        shape_std = np.full(shapes.shape, self.noise.mode_shape_std)
        test = misfit.expected_configuration(blank, frequencies, shapes, frequency_std, shape_std)
        rows = misfit.data_rows(test, model).J * self.design.sizes
        return misfit.ExpectedTest(test, rows, test.measured)

    def sensors(self, tests: Sequence[misfit.ExpectedTest], number: int) -> Candidates:
        """Return the floors as candidates; each floor is measured in all of these tests."""
        m, n, scales = len(self.which), self.design.stories, len(self.which) * len(tests)
        rows = np.zeros((n, scales, 2 * n + scales))
        for t, test in enumerate(tests):
            own = np.arange(t * m, (t + 1) * m)
            rows[:, own, : 2 * n] = test.shape_rows.swapaxes(0, 1)
            rows[:, own, 2 * n + own] = test.entries.T
        known = linalg.block_diag(
            np.concatenate([self.known, *(test.frequency_rows for test in tests)]), np.eye(scales) / UNKNOWN_STDS
        )
        wide = [np.hstack([part, np.zeros((len(part), scales))]) for part in (self.fixed, self.question)]
        return candidates(known, wide[0], rows, wide[1], number / n)

    def choices(self, tests: Sequence[misfit.ExpectedTest], floors: Ints, number: int) -> Candidates:
        """Return the tests as candidates; each test is measured at these floors."""
        rows = np.array([test.at(floors) for test in tests])
        return candidates(self.known, self.fixed, rows, self.question, number / len(tests))

    def covariance(self, tests: Sequence[misfit.ExpectedTest], floors: Ints, exact: Floats | None = None) -> Floats:
        """Relative covariance of masses and stiffnesses after these tests at these floors, shape (2N, 2N).

        `exact` has rows, shape (e, 2N), whose product with the relative changes is known to be zero.
        """
        rows = np.concatenate([self.known, *(test.at(floors) for test in tests)])
        free = free_changes(self.fixed if exact is None else np.concatenate([self.fixed, exact]))
        half = free @ np.linalg.inv(np.linalg.qr(rows @ free, mode="r"))
        return np.asarray(half @ half.T)

    def averaged(self, tests: Sequence[misfit.ExpectedTest], floors: Ints, exact: Floats | None = None) -> Floats:
        """Average the covariance over the frames that are possible before the tests, shape (2N, 2N).

        The frames are drawn from the prior information, in 16 pairs on either side of the design values. No value is
        drawn with a standard deviation above 30 %. The covariance is relative to the values of each frame.
        """
        values, axes = np.linalg.eigh(self.covariance([], np.zeros(0, dtype=int)))
        # The symmetric root does not depend on the choice of axes.
        root = (axes * np.sqrt(np.clip(values, 0.0, 0.3**2))) @ axes.T
        drawn = np.random.default_rng(1).standard_normal((16, len(root))) @ root
        found = []
        for change in np.concatenate([drawn, -drawn]):
            mass, stiffness = np.split(self.design.sizes * np.exp(change), 2)
            design = replace(self.design, floor_mass=mass, story_stiffness=stiffness)
            model = replace(self, design=design)
            found.append(model.covariance([model.expected(each.test.added_mass) for each in tests], floors, exact))
        return np.asarray(np.mean(found, axis=0))
