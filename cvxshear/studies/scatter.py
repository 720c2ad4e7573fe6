"""How the estimates of one method scatter around the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.fit.results import plain
from cvxshear.studies.setups import Setup
from cvxshear.util.typing import Bools, Floats, Json

NORMAL_95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """One method on the samples of one noise level.

    Parameters
    ----------
    setup : Setup
    method : str
    estimates : ndarray, shape (S, 2N)
        Floor masses, then story stiffnesses, kg and N/m; nan where there was no answer.
    stated_std : ndarray, shape (S, 2N) or None
        What the method says of its own accuracy; None where it says nothing.
    bound : ndarray, shape (2N,)
        Cramer-Rao bound of the standard deviations, kg and N/m.
    seconds : float
    """

    setup: Setup
    method: str
    estimates: Floats
    stated_std: Floats | None
    bound: Floats
    seconds: float

    @property
    def answered(self) -> Bools:
        """Which samples have an answer, shape (S,); every figure is of these."""
        return np.asarray(np.isfinite(self.estimates).all(axis=1), dtype=np.bool_)

    @property
    def errors(self) -> Floats:
        """Estimate less truth, relative to the truth, shape (answered, 2N)."""
        return self.estimates[self.answered] / self.setup.truth - 1.0

    @property
    def mean(self) -> Floats:
        """Mean estimate, shape (2N,), kg and N/m."""
        return np.asarray(self.estimates[self.answered].mean(axis=0))

    @property
    def bias(self) -> Floats:
        """Error of the mean, relative, shape (2N,): Table 3."""
        return np.asarray(self.errors.mean(axis=0))

    @property
    def bias_error(self) -> Floats:
        """Standard error of `bias`, shape (2N,)."""
        return np.asarray(self.errors.std(axis=0, ddof=1) / np.sqrt(len(self.errors)))

    @property
    def variation(self) -> Floats:
        """Coefficient of variation (Eq. 28), shape (2N,): Fig. 6."""
        return np.asarray(self.estimates[self.answered].std(axis=0, ddof=1) / self.mean)

    @property
    def rmse(self) -> Floats:
        """Root-mean-square error, relative to the truth, shape (2N,)."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)))

    @property
    def relative_bound(self) -> Floats:
        """Cramer-Rao bound, relative to the truth, shape (2N,)."""
        return self.bound / self.setup.truth

    @property
    def ratio(self) -> Floats:
        """Root-mean-square error over the Cramer-Rao bound, shape (2N,); nan where nothing is left to estimate."""
        free = self.bound > 0
        return np.where(free, self.rmse / np.where(free, self.relative_bound, 1.0), np.nan)

    @property
    def coverage(self) -> Floats | None:
        """Share of the samples whose stated 95 % interval holds the truth, shape (2N,)."""
        if self.stated_std is None:
            return None
        distance = np.abs(self.estimates - self.setup.truth)[self.answered]
        return np.asarray(np.mean(distance <= NORMAL_95 * self.stated_std[self.answered], axis=0))

    def to_dict(self) -> Json:
        """The figures, errors relative and not in percent."""
        coverage = self.coverage
        return {
            "setup": self.setup.to_dict(),
            "method": self.method,
            "samples": len(self.estimates),
            "failures": int(np.sum(~self.answered)),
            "seconds": self.seconds,
            "mean": self.mean.tolist(),
            "bias": self.bias.tolist(),
            "bias_error": self.bias_error.tolist(),
            "variation": self.variation.tolist(),
            "rmse": self.rmse.tolist(),
            "bound": self.relative_bound.tolist(),
            "ratio": plain(self.ratio),
            "coverage": None if coverage is None else coverage.tolist(),
        }
