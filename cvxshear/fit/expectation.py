"""Prior distributions of the effects' parameters and, wide, of the frame.

The evidence of a set of effects needs a proper prior of every parameter. Effects have theirs from their classes:
Student's t about the null value, or, for an effect with many parameters of one common size, normal with this size,
which is estimated with the rest (`fit/noise.py`). The frame has the same prior in every set: the logarithm of each
floor mass and story stiffness is normal about a typical value. It is so wide that it moves an estimate of a few percent
by less than a hundredth of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear.effects import LocatedEffect, Scale
from cvxshear.util.typing import Floats

MASS_WIDTH = 1.0
STIFFNESS_WIDTH = 2.0
"""Standard deviations of the logarithms of floor masses and of story stiffnesses about typical ones. Floors of one
frame seldom differ by more than a factor e; stories do, if one stands on rails or bearings."""

Rows = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class EffectPrior:
    """Prior distributions of the parameters.

    Parameters
    ----------
    scale : Scale, optional
        Of a typical floor and story. Default: no prior.
    stds : dict, optional
        Standard deviations of the parameters of effects that the experiment declares, in place of the catalogue's.
    """

    scale: Scale | None = None
    stds: dict[LocatedEffect, Floats] = field(default_factory=dict)

    def of(self, placed: LocatedEffect) -> Floats:
        """Return the standard deviations of an effect's parameters about null, shape (p,); infinite if uniform."""
        assert self.scale is not None, "without a scale an effect has no prior"
        std = self.stds.get(placed)
        return placed.effect.expected_sizes(self.scale) if std is None else std

    def residuals(
        self, theta: Floats, effects: Sequence[LocatedEffect], factors: Mapping[str, float]
    ) -> tuple[Rows, list[str], Rows]:
        """Compute the rows of the effects' parameters and the rows of the frame, with residuals and derivatives.

        Parameters
        ----------
        theta : ndarray, shape (P,)
        effects : sequence of LocatedEffect
        factors : mapping of str to float
            Factor on the expected size of an effect of one common, unknown size, by the effect's label.

        Returns
        -------
        about_effects : tuple of ndarray
        keys : list of str
            For each of these rows the label of the effect with an unknown common size; empty for the others.
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
        """Compute the logarithms of masses and stiffnesses over their widths, those of stiffnesses about their mean.

        The level of the stiffness has no prior: a first fit of a shear frame to a frame with a wall is several times
        too stiff, and a prior about its level would favor every effect that makes the stories appear stiffer.
        """
        assert self.scale is not None
        typical = np.repeat([self.scale.floor_mass, self.scale.story_stiffness], n)
        width = np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], n)
        own = theta[: 2 * n]
        r, slope = np.log(own / typical) / width, np.diag(1.0 / (width * own))
        r[n:] -= np.mean(r[n:])
        slope[n:] -= np.mean(slope[n:], axis=0)
        return r, np.hstack([slope, np.zeros((2 * n, len(theta) - 2 * n))])


def tailed(z: Floats, tail: float) -> tuple[Floats, Floats]:
    """Compute residuals with the squares -2 log of Student's t over its largest value, and their derivatives.

    A normal distribution with an uncertain variance is Student's t; large sizes, which occur now and then, stay
    possible. With v degrees of freedom r = sign(z) sqrt((v + 1) log(1 + z^2 / v)).

    Parameters
    ----------
    z : ndarray
        Deviations in standard sizes.
    tail : float
        v; infinite for a normal distribution, with the residual z.

    Returns
    -------
    r, slope : ndarray
    """
    if np.isinf(tail):
        return z, np.ones_like(z)
    r = np.sign(z) * np.sqrt((tail + 1.0) * np.log1p(z**2 / tail))
    # Near zero r is proportional to z to rounding.
    near = np.abs(z) < 1e-6
    slope = (tail + 1.0) * z / (tail + z**2) / np.where(near, 1.0, r)
    return r, np.where(near, np.sqrt((tail + 1.0) / tail), slope)
