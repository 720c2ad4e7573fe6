"""The linearised model at a fit: what every effect that might be added would do to it.

All candidates for one more effect share a fit, and with it the factorization of its derivatives: of each candidate
only its own column, at its null value, is new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Placed
from cvxshear.identification.efficient import Estimate, parameter_names
from cvxshear.identification.misfit import Misfit
from cvxshear.identification.uncertainty import NULL, TAKES_PART
from cvxshear.typing import Floats


@dataclass(frozen=True)
class Score:
    """What an effect would do to a fit, from derivatives alone.

    Parameters
    ----------
    gain : float
        Decrease of chi-square that the linearised model promises (Rao's score test).
    determined : bool
        Whether the data tell the effect's parameters from those already in the model.
    """

    gain: float
    determined: bool


class Tangent:
    """The derivatives at a fit, factorized once for all candidates.

    Parameters
    ----------
    base : Estimate
    """

    def __init__(self, base: Estimate) -> None:
        self.base = base
        # Orthonormal columns: the residual's changes that the parameters of the fit can make.
        self._reached = base.fit.at.J @ base.uncertainty.root
        self._columns: dict[Placed, Floats] = {}

    def sensitivity(self, placed: Placed) -> Floats:
        """Derivative of the residuals by an effect's parameters at its null value, shape (d, p)."""
        if placed not in self._columns:
            base = self.base
            misfit = Misfit(base.experiment, (*base.effects, placed))
            null = [item.null for item in placed.effect.parameters]
            theta = np.concatenate([base.theta, null])
            self._columns[placed] = misfit.evaluate(theta, by=slice(len(base.theta), None)).J
        return self._columns[placed]

    def predicted(self, placed: Placed) -> Floats:
        """Where the linearised model has its minimum with an effect added, the effect kept within its bounds.

        Returns
        -------
        ndarray, shape (P + p,)
            The parameters of the fit, then the effect's.
        """
        base, g = self.base, self.sensitivity(placed)
        null = np.array([item.null for item in placed.effect.parameters])
        lower = np.array([item.lower for item in placed.effect.parameters])
        upper = np.array([item.upper for item in placed.effect.parameters])
        free = null - np.linalg.lstsq(self._own(g), base.fit.at.r, rcond=None)[0]
        values = np.clip(free, lower, upper)
        left = self._reached.T @ (base.fit.at.r + g @ (values - null))
        return np.concatenate([base.theta - base.uncertainty.root @ left, values])

    def _own(self, g: Floats) -> Floats:
        """What of a change of the residuals the parameters of the fit cannot make."""
        own: Floats = g - self._reached @ (self._reached.T @ g)
        return own

    def score(self, placed: Placed) -> Score:
        """The score of an effect at its null value, all other parameters following."""
        g = self.sensitivity(placed)
        own = self._own(g)
        lengths, left = np.linalg.norm(g, axis=0), np.linalg.norm(own, axis=0)
        if np.any(left <= NULL * np.maximum(lengths, 1e-300)):
            return Score(0.0, determined=False)
        basis, _ = np.linalg.qr(own)
        return Score(float(np.sum((basis.T @ self.base.fit.at.r) ** 2)), determined=True)

    def confounders(self, placed: Placed) -> tuple[str, ...]:
        """The parameters whose change, as far as they are free, does what an effect does; largest share first."""
        base = self.base
        change = base.uncertainty.root @ (self._reached.T @ self.sensitivity(placed).sum(axis=1))
        share = np.abs(change) * np.linalg.norm(base.fit.at.J, axis=0)
        names = parameter_names(base.experiment, base.effects)
        order = np.argsort(-share, kind="stable")
        return tuple(names[i] for i in order if share[i] > TAKES_PART * share[order[0]])
