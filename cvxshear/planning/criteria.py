"""Criteria that compare choices: one number from the covariance of the parameters of the plan's goal.

Each criterion is convex in the weights of the candidates. Each is reported as a standard deviation: of a typical
parameter (D, A), of the worst combination of parameters (E), or of the worst parameter. Over several frames, the
variances (A, E, worst) or their logarithms (D) are averaged, which keeps the criteria convex.

A criterion also has a program for conic solvers, with linear matrix inequalities in w. For D, a matrix S with
[[M_aa - S, M_ab], [M_ba, M_bb]] >= 0 is at most the information of z_a with the others marginalized, and log det S is
maximized. For the other criteria, [[T, F 0], [(F 0)', M]] >= 0 makes T at least the covariance.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.windows import least_of_largest, least_of_sum, log_volume, variance
from cvxshear.util import checks, ranking
from cvxshear.util.typing import Floats

POWER = 24
"""Exponent of the power mean (sum of v^24)^(1/24), which replaces the largest variance if a derivative is needed. For s
parameters, the power mean is larger by at most a factor of s^(1/24)."""

MOST_PARAMETERS = 16
"""Largest number of parameters in the program for the worst one; the program keeps the least known. The time grows with
the fourth power of this number."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """One frame's candidates in the directions that they determine.

    Parameters
    ----------
    base, added : ndarray, shapes (r, r) and (n, r, r)
    asked : ndarray, shape (s, a)
        F in the directions that are kept; these are the first a of the r directions.
    left : ndarray, shape (s, s)
        Covariance from the directions that are left out.
    whole : bool
        Whether the candidates give no information about other directions.
    """

    base: Floats
    added: Floats
    asked: Floats
    left: Floats
    whole: bool


Program = tuple[Any, list[Any], Callable[[], Floats] | None]
"""Objective and constraints of cvxpy, and a function that returns the hardest mixture of parameters after solving."""


class Criterion(ABC):
    """A convex measure of a covariance.

    Attributes
    ----------
    name : str
        Name in options and results.
    summary : str
        Description of the value.
    """

    name: ClassVar[str]
    summary: ClassVar[str]

    def value(self, problem: Candidates, information: Floats) -> Floats:
        """Return the criterion as a standard deviation, shape (...), for information, shape (..., q, p, p)."""
        return self.value_at(problem, problem.own(information))

    @abstractmethod
    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        """Return the criterion as a standard deviation, shape (...), for covariances of z_a, shape (..., q, a, a)."""

    @abstractmethod
    def smooth(self, problem: Candidates, weights: Floats) -> tuple[float, Floats]:
        """Evaluate a smooth convex function with almost the criterion's minimizer, and its gradient, shape (n,)."""

    @abstractmethod
    def bound(self, problem: Candidates, weights: Floats, number: int, hardest: Floats | None = None) -> float:
        """Compute a lower bound for all choices of `number` candidates, by linearizing at these weights.

        A convex function lies above its tangent. Sorting gives the tangent's minimum over 0 <= w <= 1, sum w = N.
        Hence the bound is valid for any weights; better weights give a tighter bound.

        Parameters
        ----------
        problem : Candidates
        weights : ndarray, shape (n,)
        number : int
        hardest : ndarray, shape (s, s), optional
            Positive semidefinite, trace 1: the hardest mixture of parameters according to a solver.
        """

    @abstractmethod
    def windowed(
        self, problem: Candidates, weights: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        """Compute a tighter lower bound, by trying every choice within windows of neighboring candidates.

        Parameters
        ----------
        problem : Candidates
        weights : ndarray, shape (n,)
            The bound is tight near these weights.
        number : int
        width : int
            Number of candidates in a window.
        enough : float
            The search for a higher bound may end at this standard deviation.

        Returns
        -------
        bound : float
            A standard deviation.
        chosen : list of int
            The choice with the least bound; an exchange can start from this choice.
        """

    @abstractmethod
    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        """Return the criterion's program for a conic solver; the information is affine in the weights."""


class Determinant(Criterion):
    """D: the geometric mean of the standard deviations along the axes of the covariance ellipsoid."""

    name = "D"
    summary = "geometric mean standard deviation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        return self._std(problem, np.mean(problem.log_volume + np.linalg.slogdet(own)[1], axis=-1))

    def smooth(self, problem: Candidates, weights: Floats) -> tuple[float, Floats]:
        information = problem.information(weights)
        own = problem.own(information)
        volume = float(np.mean(problem.log_volume + np.linalg.slogdet(own)[1]))
        return volume, problem.slopes(information, np.asarray(np.linalg.inv(own), dtype=np.float64))

    def bound(self, problem: Candidates, weights: Floats, number: int, hardest: Floats | None = None) -> float:
        volume, slopes = self.smooth(problem, weights)
        return float(self._std(problem, volume + _least(slopes, weights, number)))

    def windowed(
        self, problem: Candidates, weights: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        terms, constant = log_volume(problem, weights)
        least, chosen = least_of_sum(terms, weights, number, width)
        return float(self._std(problem, least + constant + float(np.mean(problem.log_volume)))), chosen

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        a = reduced.asked.shape[1]
        S = cp.Variable((a, a), symmetric=True)
        embed = np.eye(len(reduced.base))[:, :a]
        return cp.Maximize(cp.log_det(S)), [information - embed @ S @ embed.T >> 0], None

    @staticmethod
    def _std(problem: Candidates, volume: Floats | float) -> Floats:
        return np.asarray(np.exp(volume / (2 * problem.asked.shape[-1])))


class _Mixture(Criterion):
    """Criteria that maximize tr(Z C) over a set of mixtures Z of the parameters."""

    def smooth(self, problem: Candidates, weights: Floats) -> tuple[float, Floats]:
        information = problem.information(weights)
        covariance = problem.covariance(problem.own(information))
        Z, least = self.hardest(covariance)
        slopes = problem.slopes(information, problem.asked.swapaxes(1, 2) @ Z @ problem.asked)
        # The logarithm has the same size for every frame.
        return float(np.log(least)), slopes / float(np.sum(Z * covariance))

    def bound(self, problem: Candidates, weights: Floats, number: int, hardest: Floats | None = None) -> float:
        information = problem.information(weights)
        covariance = problem.covariance(problem.own(information))
        Z = self.hardest(covariance)[0] if hardest is None else hardest
        slopes = problem.slopes(information, problem.asked.swapaxes(1, 2) @ Z @ problem.asked)
        least = float(np.sum(Z * covariance)) + _least(slopes, weights, number)
        return float(np.sqrt(max(least, 0.0)))

    @abstractmethod
    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        """Find a mixture of trace 1 that nearly maximizes tr(Z C), and the value of the smooth function of C."""


class Trace(_Mixture):
    """A: the root mean square standard deviation."""

    name = "A"
    summary = "root mean square standard deviation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        inner = problem.asked.swapaxes(1, 2) @ problem.asked
        mean = np.mean(np.sum(own * inner, axis=(-2, -1)), axis=-1)
        return np.asarray(np.sqrt(mean / problem.asked.shape[1]))

    def windowed(
        self, problem: Candidates, weights: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        s = problem.asked.shape[1]
        terms = [term for each in np.eye(s) for term in variance(problem, each)]
        least, chosen = least_of_sum(terms, weights, number, width)
        return float(np.sqrt(max(least, 0.0) / s)), chosen

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        s = len(covariance)
        return np.eye(s) / s, float(np.trace(covariance)) / s

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        # tr(F C F') depends only on F'F: a square factor of F'F replaces F.
        T, above = _above(cp, np.asarray(np.linalg.qr(reduced.asked, mode="r")), information)
        return cp.Minimize(cp.trace(T)), [above], None


class _Largest(_Mixture):
    """Criteria that are the largest of many variances."""

    def windowed(
        self, problem: Candidates, weights: Floats, number: int, width: int, enough: float
    ) -> tuple[float, list[int]]:
        least, chosen = least_of_largest(problem, self.largest, weights, number, width, enough**2)
        return float(np.sqrt(least)), chosen

    @abstractmethod
    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        """Return the largest variance, shape (...), of covariances (..., s, s), and its mixture, shape (..., s)."""


class Eigenvalue(_Largest):
    """E: the standard deviation of the worst combination of the parameters."""

    name = "E"
    summary = "standard deviation of the worst combination"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(np.sqrt(np.linalg.eigvalsh(problem.covariance(own))[..., -1]))

    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        values, axes = np.linalg.eigh(covariance)
        return values[..., -1], axes[..., -1]

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        values, axes = np.linalg.eigh(covariance)
        weights, mean = _power_mean(values)
        return (axes * weights) @ axes.T, mean

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        axes = np.linalg.eigh(reduced.asked @ reduced.asked.T + reduced.left)[1][:, ::-1][:, :MOST_PARAMETERS]
        T, above = _above(cp, axes.T @ reduced.asked, information)
        t = cp.Variable()
        below = t * np.eye(axes.shape[1]) - axes.T @ reduced.left @ axes - T >> 0
        return cp.Minimize(t), [above, below], lambda: axes @ below.dual_value @ axes.T


class Worst(_Largest):
    """Largest relative standard deviation of a parameter: the worst coefficient of variation."""

    name = "worst"
    summary = "worst coefficient of variation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        variances = np.mean(np.sum((problem.asked @ own) * problem.asked, axis=-1), axis=-2)
        return np.asarray(np.sqrt(np.max(variances, axis=-1)))

    def largest(self, covariance: Floats) -> tuple[Floats, Floats]:
        variances = np.diagonal(covariance, axis1=-2, axis2=-1)
        return np.max(variances, axis=-1), np.eye(variances.shape[-1])[np.argmax(variances, axis=-1)]

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        weights, mean = _power_mean(np.diag(covariance))
        return np.diag(weights), mean

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        variances = np.diag(reduced.asked @ reduced.asked.T + reduced.left)
        least_known = ranking.order(variances)[:MOST_PARAMETERS]
        T, above = _above(cp, reduced.asked[least_known], information)
        t = cp.Variable()
        below = cp.diag(T) + np.diag(reduced.left)[least_known] <= t

        def hardest() -> Floats:
            Z = np.zeros((len(variances), len(variances)))
            Z[least_known, least_known] = np.maximum(below.dual_value, 0.0)
            return Z

        return cp.Minimize(t), [above, below], hardest


CRITERIA: dict[str, Criterion] = {each.name: each for each in (Determinant(), Trace(), Eigenvalue(), Worst())}
"""Criteria by their names in options."""


def criterion_named(name: str) -> Criterion:
    """Return the criterion of this name.

    Raises
    ------
    InputError
        If the name is unknown; the message lists the names.
    """
    return CRITERIA[checks.choice(name, list(CRITERIA), "criterion")]


def _power_mean(variances: Floats) -> tuple[Floats, float]:
    """Return the weight of each variance in the gradient of (sum v^POWER)^(1/POWER), and this power mean."""
    largest = float(np.max(variances))
    ratio = np.maximum(variances, 0.0) / largest
    weights = ratio ** (POWER - 1)
    return weights / weights.sum(), largest * float(np.sum(ratio**POWER)) ** (1 / POWER)


def _least(slopes: Floats, weights: Floats, number: int) -> float:
    """Minimize slopes' (w - weights) over 0 <= w <= 1, sum w = number: the `number` lowest slopes have w = 1."""
    return float(np.sort(slopes)[:number].sum() - slopes @ weights)


def _above(cp: Any, asked: Floats, information: Any) -> tuple[Any, Any]:
    """Return a matrix T and the constraint that T is at least F C_a F'."""
    s, r = len(asked), information.shape[0]
    wide = np.hstack([asked, np.zeros((s, r - asked.shape[1]))])
    T = cp.Variable((s, s), symmetric=True)
    return T, cp.bmat([[T, wide], [wide.T, information]]) >> 0
