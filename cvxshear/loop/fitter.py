"""Fits, and how many there were."""

from __future__ import annotations

from dataclasses import dataclass

from cvxshear.backends import Backend
from cvxshear.identification.efficient import Estimate, fitted
from cvxshear.identification.gauss_newton import CONVERGED_STEP
from cvxshear.identification.misfit import Misfit
from cvxshear.typing import Floats


@dataclass(eq=False)
class Fitter:
    """Fits models on one backend and counts the effort.

    Parameters
    ----------
    backend : Backend
    fits, programs : int
        Fits made so far, and step programs that they solved.
    jobs : int, optional
        Processes over which candidates are fitted.
    """

    backend: Backend
    fits: int = 0
    programs: int = 0
    jobs: int = 1

    def fit(self, misfit: Misfit, start: Floats, tolerance: float = CONVERGED_STEP) -> Estimate:
        """The estimate that Gauss-Newton reaches from a starting point."""
        self.fits += 1
        found = fitted(misfit, start, self.backend, tolerance)
        self.programs += found.fit.steps
        return found
