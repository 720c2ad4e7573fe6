"""What is expected before anything is measured: of the effects' parameters, and, vaguely, of the frame itself.

Sets of effects are compared by the probability that they give to the data, which needs a proper prior of all that
they leave open. Effects have theirs from their classes. The frame has the same in every set: the logarithm of each
floor mass and of each story stiffness is normal about those of a typical floor and story, so wide that it moves an
estimate of a few percent by less than a hundredth of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear.effects import Placed, Scale
from cvxshear.util.typing import Floats

MASS_WIDTH = 1.0
STIFFNESS_WIDTH = 2.0
"""Standard deviations of the logarithms of a floor mass and of a story stiffness about those of a typical one: floors
of one frame seldom differ by more than a factor e; stories do, where one stands on rails or bearings."""

Rows = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected parameters.

    Parameters
    ----------
    scale : Scale, optional
        Of a typical floor and story; nothing is expected where it is not given.
    stds : dict, optional
        Standard deviations of the parameters of effects at places where the experiment knows better.
    """

    scale: Scale | None = None
    stds: dict[Placed, Floats] = field(default_factory=dict)

    def of(self, placed: Placed) -> Floats:
        """Standard deviations of an effect's parameters about their null values, shape (p,); infinite where even."""
        assert self.scale is not None, "without a scale nothing is expected of an effect"
        return self.stds[placed] if placed in self.stds else placed.effect.expected_sizes(self.scale)

    def residuals(self, theta: Floats, effects: Sequence[Placed]) -> tuple[Rows, Rows]:
        """Rows about the effects' parameters, and rows about the frame, each with residuals and derivatives."""
        size = len(theta)
        if self.scale is None:
            none = np.zeros(0), np.zeros((0, size))
            return none, none
        n = len(self.scale.heights)
        free = [placed for placed in effects if not placed.fixed]
        inverse = np.zeros(size)
        nulls = np.zeros(size)
        at = 2 * n
        for placed in effects:
            count = len(placed.effect.parameters)
            if placed in free:
                inverse[at : at + count] = 1.0 / self.of(placed)
                nulls[at : at + count] = [item.null for item in placed.effect.parameters]
            at += count
        rows = np.diag(inverse)[inverse > 0]
        return (rows @ (theta - nulls), rows), self._frame(theta, n)

    def _frame(self, theta: Floats, n: int) -> Rows:
        """The logarithms of masses and stiffnesses over their widths."""
        assert self.scale is not None
        typical = np.repeat([self.scale.floor_mass, self.scale.story_stiffness], n)
        width = np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], n)
        own = theta[: 2 * n]
        return np.log(own / typical) / width, np.hstack(
            [np.diag(1.0 / (width * own)), np.zeros((2 * n, len(theta) - 2 * n))]
        )
