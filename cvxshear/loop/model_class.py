"""A model class: the shear frame with a set of effects, fitted, and how probable the data make it."""

from __future__ import annotations

from dataclasses import dataclass

from cvxshear.effects import Placed
from cvxshear.errors import CvxshearError
from cvxshear.identification.efficient import Estimate


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
        Sum of the logarithms of the effects' prior odds.
    failure : CvxshearError or None
        Why there is no fit.
    """

    effects: frozenset[Placed]
    estimate: Estimate | None
    log_evidence: float
    log_prior: float
    failure: CvxshearError | None = None

    @property
    def score(self) -> float:
        """Logarithm of its probability, up to a constant."""
        return self.log_evidence + self.log_prior
