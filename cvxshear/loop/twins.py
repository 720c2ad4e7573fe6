"""What no datum tells: effects whose place in a model another effect can take without any change of the data.

Two effects are twins where the derivatives of the data by the one lie in the span of those by the frame and by the
other, to rounding: a direction in which nothing that was measured changes. Where all floor masses of a state grow by
a factor, for one, every frequency falls as if all its stories were softer. That is a property of the model and of what
was measured, not of the sets that a search happened to visit.
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
        """Whether what an effect does could be done by the frame, the effects there are, and those others."""
        columns = self.lacking[placed]
        if not columns.shape[1]:
            return False
        more = [self.lacking[other] for other in others if other is not placed]
        return _beyond(np.hstack([self.free, *more]), columns) < EXACT


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
