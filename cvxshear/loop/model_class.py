"""A model class: the shear frame with a set of effects, fitted, and how probable the data make it."""

from __future__ import annotations

from dataclasses import dataclass

from cvxshear.effects import Placed
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.numbering import Changes
from cvxshear.util.errors import CvxshearError


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
