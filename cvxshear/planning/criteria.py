"""What makes one choice better than another: one number from the covariance of what is asked for.

Each criterion is convex in the shares, and each is said as a standard deviation: that of a typical parameter (D, A),
of the worst combination of parameters (E), of the worst parameter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.terms import of_volume, variance
from cvxshear.planning.windows import least_of_largest, least_of_sum
from cvxshear.util import checks
from cvxshear.util.typing import Floats

POWER = 24
"""The largest of the variances is taken for the power mean (sum of v^24)^(1/24) where a derivative is needed: above it
by a factor of s^(1/24) at most for s parameters."""


class Criterion(ABC):
    """A convex measure of a covariance.

    Attributes
    ----------
    name : str
        Its word in options and results.
    summary : str
        What its value is, in words.
    """

    name: ClassVar[str]
    summary: ClassVar[str]

    def value(self, of: Candidates, information: Floats) -> Floats:
        """The standard deviation that an information stands for, shape (...), for information (..., p, p)."""
        return self.value_of(of, of.own(information))

    @abstractmethod
    def value_of(self, of: Candidates, own: Floats) -> Floats:
        """The same, shape (...), for covariances of z_a, shape (..., a, a)."""

    @abstractmethod
    def smooth(self, of: Candidates, shares: Floats) -> tuple[float, Floats]:
        """A smooth convex function that is least where the criterion is, or nearly, and its gradient, shape (n,)."""

    @abstractmethod
    def bound(self, of: Candidates, shares: Floats, number: int, weight: Floats | None = None) -> float:
        """What no choice of so many candidates can beat, by linearising at these shares.

        A convex function lies above its tangent, whose minimum over 0 <= w <= 1, sum w = N is a matter of sorting:
        the bound holds however roughly the shares were found.

        Parameters
        ----------
        of : Candidates
        shares : ndarray, shape (n,)
        number : int
        weight : ndarray, shape (s, s), optional
            Positive semidefinite, of trace 1: the mixture of parameters that a solver found the hardest.
        """

    @abstractmethod
    def windowed(
        self, of: Candidates, shares: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        """What no choice of so many candidates can beat, every choice within windows of neighbours looked at.

        Parameters
        ----------
        of : Candidates
        shares : ndarray, shape (n,)
            Near which the bound is to be close.
        number : int
        width : int
            Of the windows.
        enough : float
            The standard deviation at which looking for a higher bound may end.

        Returns
        -------
        bound : float
            A standard deviation.
        chosen : list of int
            The choice at which the bound is least: one to exchange from.
        """


class Determinant(Criterion):
    """D: the geometric mean of the standard deviations along the axes of the covariance's ellipsoid."""

    name = "D"
    summary = "geometric mean standard deviation"

    def value_of(self, of: Candidates, own: Floats) -> Floats:
        whole = of.log_volume + np.linalg.slogdet(own)[1]
        result: Floats = np.exp(whole / (2 * of.asked.shape[1]))
        return result

    def smooth(self, of: Candidates, shares: Floats) -> tuple[float, Floats]:
        information = of.information(shares)
        own = of.own(information)
        volume = of.log_volume + float(np.linalg.slogdet(own)[1])
        weight = np.asarray(np.linalg.inv(own), dtype=np.float64)
        return volume, of.slopes(information, weight)

    def bound(self, of: Candidates, shares: Floats, number: int, weight: Floats | None = None) -> float:
        volume, slopes = self.smooth(of, shares)
        return float(np.exp((volume + _least(slopes, shares, number)) / (2 * of.asked.shape[1])))

    def windowed(
        self, of: Candidates, shares: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        terms, constant = of_volume(of, shares)
        least, chosen = least_of_sum(terms, shares, number, width)
        return float(np.exp((least + constant + of.log_volume) / (2 * of.asked.shape[1]))), chosen


class _Mixture(Criterion):
    """The criteria that are a largest tr(weight C) over a set of weights."""

    def smooth(self, of: Candidates, shares: Floats) -> tuple[float, Floats]:
        information = of.information(shares)
        covariance = of.covariance(of.own(information))
        weight, least = self.hardest(covariance)
        slopes = of.slopes(information, of.asked.T @ weight @ of.asked)
        # Of the logarithm, whose size is the same for every frame.
        return float(np.log(least)), slopes / float(np.sum(weight * covariance))

    def bound(self, of: Candidates, shares: Floats, number: int, weight: Floats | None = None) -> float:
        information = of.information(shares)
        covariance = of.covariance(of.own(information))
        weight = self.hardest(covariance)[0] if weight is None else weight
        slopes = of.slopes(information, of.asked.T @ weight @ of.asked)
        least = float(np.sum(weight * covariance)) + _least(slopes, shares, number)
        return float(np.sqrt(max(least, 0.0)))

    @abstractmethod
    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        """A weight of trace 1 at which tr(weight C) is nearly the largest, and the smooth function of C behind it."""


class Trace(_Mixture):
    """A: the root mean square standard deviation."""

    name = "A"
    summary = "root mean square standard deviation"

    def value_of(self, of: Candidates, own: Floats) -> Floats:
        result: Floats = np.sqrt(np.sum(own * (of.asked.T @ of.asked), axis=(-2, -1)) / len(of.asked))
        return result

    def windowed(
        self, of: Candidates, shares: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        s = len(of.asked)
        least, chosen = least_of_sum([variance(of, each) for each in np.eye(s)], shares, number, width)
        return float(np.sqrt(max(least, 0.0) / s)), chosen

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        s = len(covariance)
        return np.eye(s) / s, float(np.trace(covariance)) / s


class _Largest(_Mixture):
    """The criteria that are the largest of many variances."""

    def windowed(
        self, of: Candidates, shares: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        least, chosen = least_of_largest(of, self.largest, shares, number, width, enough**2)
        return float(np.sqrt(least)), chosen

    @abstractmethod
    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        """The largest variance, shape (...), of covariances (..., s, s), and its mixture of parameters, (..., s)."""


class Eigenvalue(_Largest):
    """E: the standard deviation of the worst combination of the parameters."""

    name = "E"
    summary = "standard deviation of the worst combination"

    def value_of(self, of: Candidates, own: Floats) -> Floats:
        result: Floats = np.sqrt(np.linalg.eigvalsh(of.covariance(own))[..., -1])
        return result

    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        values, axes = np.linalg.eigh(covariance)
        return values[..., -1], axes[..., -1]

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        values, axes = np.linalg.eigh(covariance)
        shares, mean = _power_mean(values)
        return (axes * shares) @ axes.T, mean


class Worst(_Largest):
    """The largest standard deviation of a parameter, each relative to its size: the worst coefficient of variation."""

    name = "worst"
    summary = "worst coefficient of variation"

    def value_of(self, of: Candidates, own: Floats) -> Floats:
        variances = np.sum((of.asked @ own) * of.asked, axis=-1)
        result: Floats = np.sqrt(np.max(variances, axis=-1))
        return result

    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        variances = np.diagonal(covariance, axis1=-2, axis2=-1)
        return np.max(variances, axis=-1), np.eye(variances.shape[-1])[np.argmax(variances, axis=-1)]

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        shares, mean = _power_mean(np.diag(covariance))
        return np.diag(shares), mean


CRITERIA: dict[str, Criterion] = {each.name: each for each in (Determinant(), Trace(), Eigenvalue(), Worst())}


def criterion_named(name: str) -> Criterion:
    """The criterion of this name.

    Raises
    ------
    InputError
        Where there is none; the message lists those there are.
    """
    return CRITERIA[checks.choice(name, list(CRITERIA), "criterion")]


def _power_mean(variances: Floats) -> tuple[Floats, float]:
    """Shares of the variances in their largest, by (sum v^POWER)^(1/POWER), and that number."""
    largest = float(np.max(variances))
    ratio = np.maximum(variances, 0.0) / largest
    shares = ratio ** (POWER - 1)
    return shares / shares.sum(), largest * float(np.sum(ratio**POWER)) ** (1 / POWER)


def _least(slopes: Floats, shares: Floats, number: int) -> float:
    """The least of slopes' (w - shares) over 0 <= w <= 1, sum w = number: the lowest slopes, so many."""
    return float(np.sort(slopes)[:number].sum() - slopes @ shares)
