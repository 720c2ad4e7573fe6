"""A model class: the shear frame with a set of effects, fitted, and how probable the data make it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.numbering import Changes
from cvxshear.util.errors import CvxshearError

SAME_OPTIMUM = 0.3
"""Largest difference of two fits of a set, in standard deviations of any datum or prior, that is none: fits of the
search end within a tenth of their optimum, and another optimum is many away."""


@dataclass(frozen=True, eq=False)
class ModelClass:
    """A set of effects with its fit.

    Parameters
    ----------
    effects : frozenset of Placed
        Those beyond what was assumed from the start.
    estimate : Estimate or None
        None where no fit was found.
    log_evidence : float
    log_prior : float
        Sum of the logarithms of the prior odds, of the effects and of the numbers of the modes.
    failure : CvxshearError or None
        Why there is no fit.
    changes : tuple
        Configurations whose modes are numbered otherwise than given (`Numbering.changes`).
    """

    effects: frozenset[Placed]
    estimate: Estimate | None
    log_evidence: float
    log_prior: float
    failure: CvxshearError | None = None
    changes: Changes = ()

    @property
    def score(self) -> float:
        """Logarithm of its probability, up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def improbable(self) -> bool:
        """Whether its residual, or the noise that it asks for, is improbable."""
        return self.estimate is not None and self.estimate.improbable

    def same_optimum(self, other: ModelClass) -> bool:
        """Whether another fit of this set ended at the same frame, as far as any datum or prior could tell."""
        mine, theirs = self.estimate, other.estimate
        if mine is None or theirs is None:
            return False
        n2 = 2 * mine.experiment.stories
        values = {placed: theirs.theta[own] for placed, own in slices(theirs.effects, n2)}
        there = np.concatenate([theirs.theta[:n2], *(values[placed] for placed in mine.effects)])
        return bool(np.all(np.abs(mine.fit.at.J @ (there - mine.theta)) < SAME_OPTIMUM))
