"""Twins: effects that can replace each other in a model without any change of the data.

Effect A has the twin B if the derivatives of the data by A lie in the span of the derivatives by the frame and by B, to
rounding. For example, if all floor masses of a state grow by one factor, every frequency falls in the same way as if
all its stories were softer. Twins depend on the model and the measured quantities, not on the sets that a search
visited.

Frequencies alone also admit a second frame. A chain of N stories k_i and floors m_i has the eigenvalues of the chain
with stories 1 / m_(N+1-i) and floors 1 / k_(N+1-i), up to scale. So every set of effects has a dual that fits equally
well, in which a loss in story j is a mass on floor N+1-j (`Effect.dual`). With added mass in some tests the dual fits
worse or better, and lies near its own minimum. No fit from the first frame reaches this minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import LocatedEffect
from cvxshear.effects.composition import slices
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.evidence import free_basis
from cvxshear.loop.linear import Linearised
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats

EXACT = 1e-5
"""Rounding: share of an effect's derivatives outside the span of the others that counts as zero."""

BEYOND_FRAME = 1e-3
"""Smallest share of an effect's derivatives outside the span of the frame. An effect with less is redundant and needs
no twin."""


@dataclass(frozen=True)
class Invariances:
    """Derivatives of all data at a fit, for the search for twins.

    Parameters
    ----------
    estimate : Estimate
    free : ndarray, shape (d, f)
        Derivatives by the directions that the declarations do not fix.
    owner : tuple of (LocatedEffect or None)
        Effect of each direction; None for the frame.
    lacking : dict
        Derivatives by the parameters of each effect that the model lacks, shape (d, p).
    """

    estimate: Estimate
    free: Floats
    owner: tuple[LocatedEffect | None, ...]
    lacking: dict[LocatedEffect, Floats]

    def twins(self, placed: LocatedEffect) -> list[LocatedEffect]:
        """List the effects that can replace an effect in the model without any change of the data."""
        own = np.array([owner is placed for owner in self.owner])
        if not own.any():
            return []
        basis = _basis(self.free[:, ~own])
        wanted = _without(basis, self.free[:, own])
        size = np.linalg.norm(self.free[:, own], axis=0)
        if np.max(np.linalg.norm(wanted, axis=0) / np.where(size > 0, size, 1.0)) <= BEYOND_FRAME:
            return []
        return [
            other
            for other, columns in self.lacking.items()
            if 0 < columns.shape[1] <= int(own.sum()) and _beyond(_without(basis, columns), wanted) < EXACT
        ]

    def untold(self, placed: LocatedEffect, others: Sequence[LocatedEffect]) -> bool:
        """Whether an effect of its expected size changes all data together by less than one standard deviation.

        Changes that the frame, the effects of the model, or the given others can also make do not count.
        """
        columns = self.lacking[placed] * placed.effect.expected_sizes(self.estimate.scale)
        if not columns.shape[1]:
            return False
        more = [self.lacking[other] for other in others if other is not placed]
        left = _without(_basis(np.hstack([self.free, *more])), columns)
        return bool(np.all(np.linalg.norm(left, axis=0) < 1.0))


def invariances(linear: Linearised) -> Invariances:
    """Collect the derivatives of all data, with the soft priors, from the linearised model at a fit."""
    estimate = linear.base
    measured = estimate.fit.at.measured
    basis = free_basis(estimate, linear.expectation)
    n2 = 2 * estimate.experiment.stories
    free_effects = [
        placed for placed, own in slices(estimate.effects, n2) if not placed.fixed for _ in range(own.start, own.stop)
    ]
    frame: list[LocatedEffect | None] = [None] * (basis.shape[1] - len(free_effects))
    return Invariances(
        estimate,
        estimate.fit.at.J[:measured] @ basis,
        (*frame, *free_effects),
        {placed: linear.columns(placed)[:measured] for placed in linear.lacking},
    )


def _basis(columns: Floats) -> Floats:
    """Return orthonormal columns that span the given columns, to rounding."""
    lengths = np.linalg.norm(columns, axis=0)
    unit = columns[:, lengths > 0] / lengths[lengths > 0]
    left, values, _ = np.linalg.svd(unit, full_matrices=False)
    return left[:, values > EXACT * values[0]] if len(values) else left


def _without(basis: Floats, columns: Floats) -> Floats:
    """Return the part of each column outside the span of a basis; zero if that part is rounding."""
    left: Floats = columns - basis @ (basis.T @ columns)
    rounding = np.linalg.norm(left, axis=0) <= EXACT * np.linalg.norm(columns, axis=0)
    return np.where(rounding, 0.0, left)


def _beyond(columns: Floats, wanted: Floats) -> float:
    """Return the largest share of a wanted column outside the span of the given columns."""
    size = np.linalg.norm(wanted, axis=0)
    if columns.shape[1] == 1 and np.any(columns):
        unit = columns / np.linalg.norm(columns)
        left = wanted - unit @ (unit.T @ wanted)
    else:
        left = _without(_basis(columns), wanted)
    return float(np.max(np.linalg.norm(left, axis=0) / np.where(size > 0, size, 1.0), initial=0.0))


def few_floors_seen(experiment: Experiment) -> bool:
    """Whether no test measured more than half of the floors: very different frames may fit such data equally well."""
    return not any(2 * each.measured.any(axis=0).sum() > experiment.stories for each in experiment.configurations)


def dual_fits_as_well(experiment: Experiment) -> bool:
    """Whether only frequencies were measured, without added mass.

    Such data do not distinguish a frame from its dual.
    """
    return not experiment.static and not any(
        each.measured.any() or np.any(each.added_mass) for each in experiment.configurations
    )


def dual_frame(frame: Floats) -> Floats:
    """Return the masses and stiffnesses of the dual frame of the same total mass, shape (2N,).

    Parameters
    ----------
    frame : ndarray, shape (2N,)
        Floor masses and story stiffnesses, kg and N/m.
    """
    floor_mass, story_stiffness = np.split(frame, 2)
    scale = floor_mass.sum() / np.sum(1.0 / story_stiffness)
    dual: Floats = scale * np.concatenate([1.0 / story_stiffness[::-1], 1.0 / floor_mass[::-1]])
    return dual


def dual_set(
    effects: frozenset[LocatedEffect], known: Sequence[LocatedEffect], stories: int
) -> frozenset[LocatedEffect] | None:
    """Find the effects of the dual frame that give the same frequencies; None if an effect has no dual.

    Parameters
    ----------
    effects : frozenset of LocatedEffect
    known : sequence of LocatedEffect
        All effects that are looked for.
    stories : int
    """
    by_place = {(placed.effect.name, placed.place): placed for placed in known}
    found = [placed.effect.dual(placed.place, stories) for placed in effects]
    duals = [by_place.get(each) if each is not None else None for each in found]
    return frozenset(each for each in duals if each is not None) if None not in duals else None
