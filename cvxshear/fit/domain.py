"""Domain and prior of the parameters of a fit.

The domain has positivity, declared masses, exact priors, and the limits of the effects. The prior makes the evidence of
a set of effects proper. Effects have theirs from their classes: Student's t about the null value, or, for an effect
with many parameters of one common size, normal with this size, which is estimated with the rest (`fit/gaussian.py`).
The frame has the same prior in every set: the logarithm of each floor mass is normal about a typical value, that of
each story stiffness about their mean. It is so wide that it moves an estimate of a few percent by less than a hundredth
of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear.effects import LocatedEffect, Scale
from cvxshear.effects.composition import slices
from cvxshear.effects.state import heights_of
from cvxshear.fit.gaussian import tailed
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints, exact_frame, statements
from cvxshear.util.typing import Floats, Ints

SMALLEST_VALUE = 1e-3
"""Smallest positive mass or stiffness, relative to the mean declared floor mass or to the median at the start."""

PART_OF_START = 0.1
"""The same relative to the smallest value at the start, if that is below half of it: stiffnesses can differ by 1e6."""

FARTHEST = 1e5
"""Largest mass or stiffness relative to its start. A less determined value is practically infinite, and larger values
would cost the digits of the others."""


MASS_WIDTH = 1.0
STIFFNESS_WIDTH = 2.0
"""Standard deviations of the logarithms of floor masses and of story stiffnesses about typical ones. Floors of one
frame seldom differ by more than a factor e; stories do, if one stands on rails or bearings."""

Rows = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Domain:
    """Constraints and scales of the parameters of a fit.

    Parameters
    ----------
    statements : sequence of NamedConstraints
        Exact statements about theta.
    scale : ndarray, shape (P,)
        Size of each parameter: its start, or the expected size of an effect if that is larger.
    interval_std : ndarray, shape (P,)
        Standard deviation of a uniform distribution over a parameter's physical interval; infinite without interval.
    farthest : ndarray, shape (P,), optional
        Largest value of each parameter that a step may reach. Default: no limit.
    """

    statements: Sequence[NamedConstraints]
    scale: Floats
    interval_std: Floats
    farthest: Floats | None = None


def spread(
    on_mass: Sequence[NamedConstraints], on_stiffness: Sequence[NamedConstraints], n: int, size: int
) -> list[NamedConstraints]:
    """Write statements about masses and about stiffnesses as statements about all parameters."""
    return [
        NamedConstraints(part.name, embedded(part.constraints, at, size))
        for parts, at in ((on_mass, slice(0, n)), (on_stiffness, slice(n, 2 * n)))
        for part in parts
    ]


def domain_of(experiment: Experiment, effects: Sequence[LocatedEffect], theta: Floats) -> Domain:
    """Build the domain of the parameters of a fit with these effects."""
    n, size = experiment.stories, len(theta)
    known = experiment.frame.known_total
    mass = _least(theta[:n], float(np.median(theta[:n])) if known is None else known / n)
    stiffness = _least(theta[n : 2 * n], float(np.median(theta[n : 2 * n])))
    released = any("total_mass" in placed.effect.releases for placed in effects)
    frame = exact_frame(experiment.frame, total_released=released)
    gone = {placed.place.prior for placed in effects if "prior" in placed.effect.releases}
    priors = [prior for words, prior in experiment.stated.items() if words not in gone]
    parts = spread(
        statements(priors, "floor_mass", n, frame, least=mass),
        statements(priors, "story_stiffness", n, least=stiffness),
        n,
        size,
    )
    interval_std, scale = np.full(size, np.inf), np.abs(theta)
    typical = Scale(float(np.median(theta[:n])), float(np.median(theta[n : 2 * n])), heights_of(experiment))
    for placed, own in slices(effects, 2 * n):
        parameters = placed.effect.parameters
        if placed.fixed:
            exact = Constraints(A=np.eye(len(parameters)), b=np.array(placed.fixed))
            parts.append(NamedConstraints(f"{placed.label} as assumed", embedded(exact, own, size)))
            continue
        bounds = Constraints(
            lower=np.array([item.lower for item in parameters]), upper=np.array([item.upper for item in parameters])
        )
        interval_std[own] = [(item.upper - item.lower) / np.sqrt(12) for item in parameters]
        expected = placed.effect.expected_sizes(typical)
        scale[own] = np.maximum(np.abs(theta[own]), np.where(np.isfinite(expected), expected, 0.0))
        parts.append(NamedConstraints(f"bounds of {placed.label}", embedded(bounds, own, size)))
        limits = placed.effect.limits(experiment, placed.place)
        columns = np.concatenate([np.arange(2 * n), np.arange(own.start, own.stop)])
        parts.append(NamedConstraints(f"what {placed.label} can be", embedded(limits, columns, size)))
    scale = np.where(scale == 0, 1.0, scale)
    return Domain(parts, scale, interval_std, np.where(np.arange(size) < 2 * n, FARTHEST * scale, np.inf))


def _least(start: Floats, typical: float) -> float:
    """Return the least mass, or the least stiffness, that counts as positive."""
    least, smallest = SMALLEST_VALUE * typical, float(start.min())
    return PART_OF_START * smallest if smallest < 0.5 * least else least


def embedded(said: Constraints, at: slice | Ints, size: int) -> Constraints:
    """Write statements about some of the parameters as statements about all of them."""

    def wide(rows: Floats | None) -> Floats | None:
        if rows is None:
            return None
        full = np.zeros((len(rows), size))
        full[:, at] = rows
        return full

    def padded(bound: Floats | None, fill: float) -> Floats | None:
        if bound is None:
            return None
        full = np.full(size, fill)
        full[at] = bound
        return full

    return Constraints(
        padded(said.lower, -np.inf), padded(said.upper, np.inf), wide(said.G), said.h, wide(said.A), said.b
    )


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
