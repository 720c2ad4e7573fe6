"""What no datum tells: effects whose place in a model another effect can take without any change of the data.

Two effects are twins where the derivatives of the data by the one lie in the span of those by the frame and by the
other, to rounding: a direction in which nothing that was measured changes. Where all floor masses of a state grow by
a factor, for one, every frequency falls as if all its stories were softer. That is a property of the model and of what
was measured, not of the sets that a search happened to visit.

Frequencies alone have another frame, too. A chain of N stories k_i and floors m_i has the eigenvalues of the chain with
stories 1 / m_(N+1-i) and floors 1 / k_(N+1-i), up to scale: every set of effects has a dual that fits as well, in which
a loss in story j is a mass on floor N+1-j (`Effect.dual`). With added mass in some tests the dual fits worse, or
better, and is near a minimum of its own, to which no fit from the other frame leads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.evidence import free_basis
from cvxshear.loop.linear import Linearised
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats

EXACT = 1e-5
"""Share of an effect's derivatives that nothing else can make, below which that is rounding."""

BEYOND_FRAME = 1e-3
"""Share that must be left without the twin: what the frame alone can make has no need of a twin."""


@dataclass(frozen=True)
class Invariances:
    """The derivatives of all data at a fit, as far as twins need them.

    Parameters
    ----------
    estimate : Estimate
    free : ndarray, shape (d, f)
        Derivatives by the directions that the declarations leave free.
    owner : tuple of (Placed or None)
        The effect that each of these directions belongs to; None for the frame.
    lacking : dict
        Derivatives by the parameters of each effect that the model lacks, shape (d, p).
    """

    estimate: Estimate
    free: Floats
    owner: tuple[Placed | None, ...]
    lacking: dict[Placed, Floats]

    def twins(self, placed: Placed) -> list[Placed]:
        """List the effects that can take the place of one in the model, whatever was measured."""
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

    def untold(self, placed: Placed, others: Sequence[Placed]) -> bool:
        """Whether what an effect of its expected size does is less than a standard deviation of all data together.

        What the frame, the effects there are, and those others can do in its place does not count.
        """
        columns = self.lacking[placed] * placed.effect.expected_sizes(self.estimate.scale)
        if not columns.shape[1]:
            return False
        more = [self.lacking[other] for other in others if other is not placed]
        left = _without(_basis(np.hstack([self.free, *more])), columns)
        return bool(np.all(np.linalg.norm(left, axis=0) < 1.0))


def invariances(linear: Linearised) -> Invariances:
    """Take the derivatives of all data, soft priors among them, from the linearised model at a fit."""
    estimate = linear.base
    measured = estimate.fit.at.measured
    basis = free_basis(estimate, linear.expectation)
    n2 = 2 * estimate.experiment.stories
    free_effects = [
        placed for placed, own in slices(estimate.effects, n2) if not placed.fixed for _ in range(own.start, own.stop)
    ]
    frame: list[Placed | None] = [None] * (basis.shape[1] - len(free_effects))
    return Invariances(
        estimate,
        estimate.fit.at.J[:measured] @ basis,
        (*frame, *free_effects),
        {placed: linear.columns(placed)[:measured] for placed in linear.lacking},
    )


def _basis(columns: Floats) -> Floats:
    """Orthonormal columns that span others, up to what is rounding among them."""
    lengths = np.linalg.norm(columns, axis=0)
    unit = columns[:, lengths > 0] / lengths[lengths > 0]
    left, values, _ = np.linalg.svd(unit, full_matrices=False)
    return left[:, values > EXACT * values[0]] if len(values) else left


def _without(basis: Floats, columns: Floats) -> Floats:
    """Return what a basis cannot make of some columns; zero where that is rounding."""
    left: Floats = columns - basis @ (basis.T @ columns)
    rounding = np.linalg.norm(left, axis=0) <= EXACT * np.linalg.norm(columns, axis=0)
    return np.where(rounding, 0.0, left)


def _beyond(columns: Floats, wanted: Floats) -> float:
    """Return the largest share of a wanted column that a combination of others cannot make."""
    size = np.linalg.norm(wanted, axis=0)
    if columns.shape[1] == 1 and np.any(columns):
        unit = columns / np.linalg.norm(columns)
        left = wanted - unit @ (unit.T @ wanted)
    else:
        left = _without(_basis(columns), wanted)
    return float(np.max(np.linalg.norm(left, axis=0) / np.where(size > 0, size, 1.0), initial=0.0))


def few_floors_seen(experiment: Experiment) -> bool:
    """Whether no test shows more than half of the floors: frames far from each other may fit such data as well."""
    return not any(2 * each.measured.any(axis=0).sum() > experiment.stories for each in experiment.configurations)


def dual_fits_as_well(experiment: Experiment) -> bool:
    """Whether nothing but frequencies was measured, and no mass added: data that do not tell a frame from its dual."""
    return not experiment.static and not any(
        each.measured.any() or np.any(each.added_mass) for each in experiment.configurations
    )


def dual_frame(frame: Floats) -> Floats:
    """Masses and stiffnesses of the dual frame of the same total mass, shape (2N,).

    Parameters
    ----------
    frame : ndarray, shape (2N,)
        Floor masses and story stiffnesses, kg and N/m.
    """
    floor_mass, story_stiffness = np.split(frame, 2)
    scale = floor_mass.sum() / np.sum(1.0 / story_stiffness)
    dual: Floats = scale * np.concatenate([1.0 / story_stiffness[::-1], 1.0 / floor_mass[::-1]])
    return dual


def dual_set(effects: frozenset[Placed], known: Sequence[Placed], stories: int) -> frozenset[Placed] | None:
    """Find the effects of the dual frame that have the same frequencies; None where one of them has no dual.

    Parameters
    ----------
    effects : frozenset of Placed
    known : sequence of Placed
        All that are looked for.
    stories : int
    """
    by_place = {(placed.effect.name, placed.place): placed for placed in known}
    found = [placed.effect.dual(placed.place, stories) for placed in effects]
    duals = [by_place.get(each) if each is not None else None for each in found]
    return frozenset(each for each in duals if each is not None) if None not in duals else None
