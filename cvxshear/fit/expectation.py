"""What is expected before anything is measured: of the effects' parameters, and, vaguely, of the frame itself.

Sets of effects are compared by the probability that they give to the data, which needs a proper prior of all that
they leave open. Effects have theirs from their classes: Student's t about the null value, or, for an effect of many
parameters with one common size, normal with that size, which is estimated with the rest (`fit/noise.py`). The frame
has the same in every set: the logarithm of each floor mass and of each story stiffness is normal about those of a
typical floor and story, so wide that it moves an estimate of a few percent by less than a hundredth of its standard
deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear.effects import Placed, Scale
from cvxshear.util.typing import Floats

MASS_WIDTH = 1.0
STIFFNESS_WIDTH = 2.0
"""Standard deviations of the logarithms of a floor mass and of a story stiffness about those of a typical one: floors
of one frame seldom differ by more than a factor e; stories do, where one stands on rails or bearings."""

SLOPE_AT_ZERO = 1e-6
"""Deviation, in standard sizes, below which the slope of Student's residual is that at zero, to rounding."""

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
        """Return the standard deviations of an effect's parameters about null, shape (p,); infinite where even."""
        assert self.scale is not None, "without a scale nothing is expected of an effect"
        std = self.stds.get(placed)
        return placed.effect.expected_sizes(self.scale) if std is None else std

    def residuals(
        self, theta: Floats, effects: Sequence[Placed], factors: Mapping[str, float]
    ) -> tuple[Rows, list[str], Rows]:
        """Rows about the effects' parameters, and rows about the frame, each with residuals and derivatives.

        Parameters
        ----------
        theta : ndarray, shape (P,)
        effects : sequence of Placed
        factors : mapping of str to float
            Factor on the expected size of an effect of one common, unknown size, by the effect's label.

        Returns
        -------
        about_effects : tuple of ndarray
        keys : list of str
            For each of these rows the label of the effect whose common size is unknown; empty for the others.
        about_frame : tuple of ndarray
        """
        size = len(theta)
        if self.scale is None:
            none = np.zeros(0), np.zeros((0, size))
            return none, [], none
        n = len(self.scale.heights)
        r, slope, keys = np.zeros(size), np.zeros(size), [""] * size
        at = 2 * n
        for placed in effects:
            own = slice(at, at := at + len(placed.effect.parameters))
            if placed.fixed:
                continue
            null = np.array([item.null for item in placed.effect.parameters])
            common = placed.effect.common_size
            std = self.of(placed) * (factors.get(placed.label, 1.0) if common else 1.0)
            r[own], unit_slope = tailed((theta[own] - null) / std, np.inf if common else placed.effect.tail)
            slope[own] = unit_slope / std
            keys[own] = [placed.label if common else ""] * (own.stop - own.start)
        about = np.flatnonzero(slope)
        return (r[about], np.diag(slope)[about]), [keys[i] for i in about], self._frame(theta, n)

    def _frame(self, theta: Floats, n: int) -> Rows:
        """Compute the logarithms of masses and stiffnesses over their widths."""
        assert self.scale is not None
        typical = np.repeat([self.scale.floor_mass, self.scale.story_stiffness], n)
        width = np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], n)
        own = theta[: 2 * n]
        return np.log(own / typical) / width, np.hstack(
            [np.diag(1.0 / (width * own)), np.zeros((2 * n, len(theta) - 2 * n))]
        )


def tailed(z: Floats, tail: float) -> tuple[Floats, Floats]:
    """Residuals whose squares are -2 log of Student's t over its largest value, and their derivatives.

    A normal distribution whose variance is itself unknown is Student's t: sizes that practice meets now and then far
    out stay possible. With v degrees of freedom r = sign(z) sqrt((v + 1) log(1 + z^2 / v)).

    Parameters
    ----------
    z : ndarray
        Deviations in standard sizes.
    tail : float
        v; infinite for a normal distribution, whose residual is z.

    Returns
    -------
    r, slope : ndarray
    """
    if np.isinf(tail):
        return z, np.ones_like(z)
    r = np.sign(z) * np.sqrt((tail + 1.0) * np.log1p(z**2 / tail))
    near = np.abs(z) < SLOPE_AT_ZERO
    slope = (tail + 1.0) * z / (tail + z**2) / np.where(near, 1.0, r)
    return r, np.where(near, np.sqrt((tail + 1.0) / tail), slope)
