"""Candidates of a plan, and the criteria that compare choices of them.

The information of the parameters is a sum over the chosen candidates, floors or tests,

    M(w) = M_0 + sum over j of w_j G_j,   G_j = J_j' J_j,

with w_j = 1 for a chosen candidate. The scale of every measured shape is unknown. Eliminating the scale from each shape
would spoil the sum, so the scale is a parameter here, and the criteria use the covariance with the other parameters
marginalized. If the design values are uncertain, every matrix has a version for each of several allowed frames, and a
criterion is an average over these frames: of variances (A, E, worst) or of their logarithms (D).

A criterion is one number from the covariance of the parameters of the plan's goal, convex in the weights. It is
reported as a standard deviation: of a typical parameter (D, A), of the worst combination of parameters (E), or of the
worst parameter. It also has a program for conic solvers, with linear matrix inequalities in w. For D, a matrix S with
[[M_aa - S, M_ab], [M_ba, M_bb]] >= 0 is at most the information of z_a with the others marginalized, and log det S is
maximized. For the other criteria, [[T, F 0], [(F 0)', M]] >= 0 makes T at least the covariance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import linalg

from cvxshear.util import checks, ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

KNOWN_EXACTLY = 1e-12
"""Largest length of a row of the question, with each parameter relative to its size, for an exactly known parameter."""

POWER = 24
"""Exponent of the power mean (sum of v^24)^(1/24), which replaces the largest variance if a derivative is needed. For s
parameters, the power mean is larger by at most a factor of s^(1/24)."""

MOST_IN_PROGRAM = 16
"""Largest number of directions of the goal's parameters in a conic program, and of the other directions. The time grows
with the fourth power of this number."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Prior information and the information of each candidate, in well-scaled coordinates.

    The goal's parameters are x = F z_a; z_a are the first of these coordinates z. The information of all
    candidates with equal weights is the identity.

    Parameters
    ----------
    base : ndarray, shape (q, p, p)
        Information without any candidate, for each of q frames.
    rows : ndarray, shape (q, n, d, p)
        J_j of each candidate.
    asked : ndarray, shape (q, s, a)
        F.
    """

    base: Floats
    rows: Floats
    asked: Floats

    @staticmethod
    def averaged(frames: Sequence[Candidates]) -> Candidates:
        """Return the candidates on several frames; a criterion is an average over these frames."""
        parts = [[each.base for each in frames], [each.rows for each in frames], [each.asked for each in frames]]
        return Candidates(*map(np.concatenate, parts))

    @cached_property
    def added(self) -> Floats:
        """Information that each candidate adds, G_j, shape (q, n, p, p)."""
        return self.rows.swapaxes(2, 3) @ self.rows

    @cached_property
    def log_volume(self) -> Floats:
        """log det of the covariance of the goal's parameters if the covariance of z_a is the identity."""
        return np.asarray(np.sum(np.log(np.linalg.svd(self.asked, compute_uv=False) ** 2), axis=-1))

    @property
    def count(self) -> int:
        """Number of candidates."""
        return int(self.rows.shape[1])

    def information(self, weights: Floats) -> Floats:
        """Compute M(w), shape (..., q, p, p), for weights w of shape (..., n)."""
        return np.asarray(self.base + np.tensordot(weights, self.added, axes=(-1, 1)))

    def subset(self, chosen: Ints | list[int]) -> Floats:
        """Return the information of the chosen candidates, shape (q, p, p)."""
        return np.asarray(self.base + self.added[:, chosen].sum(axis=1))

    def own(self, information: Floats) -> Floats:
        """Compute the covariance of z_a with all others marginalized, shape (..., q, a, a)."""
        a = self.asked.shape[-1]
        return np.asarray(np.linalg.inv(information), dtype=np.float64)[..., :a, :a]

    def own_with_each(self, chosen: Ints | list[int], others: Ints | list[int]) -> Floats:
        """Compute the covariance of z_a with the chosen candidates and each one of the others, shape (k, q, a, a).

        C - C J' (1 + J C J')^-1 J C needs only one inverse for all of them.
        """
        a = self.asked.shape[-1]
        covariance = np.linalg.inv(self.subset(chosen))
        J = self.rows[:, others]
        seen = J @ covariance[:, None]
        inner = np.eye(J.shape[2]) + seen @ J.swapaxes(2, 3)
        columns = seen[..., :a]
        result: Floats = covariance[:, None, :a, :a] - columns.swapaxes(2, 3) @ np.linalg.solve(inner, columns)
        return result.swapaxes(0, 1)

    def covariance(self, own: Floats) -> Floats:
        """Compute the covariance of the goal's parameters, (..., s, s), from the covariances of z_a, as a mean."""
        return np.asarray(np.mean(self.asked @ own @ self.asked.swapaxes(1, 2), axis=-3))

    def slopes(self, information: Floats, weight: Floats) -> Floats:
        """Differentiate the frames' mean of tr(weight C_aa) by the weights, shape (n,); C is the whole covariance.

        The derivative for one frame is -tr(weight C_a. G_j C_.a).

        Parameters
        ----------
        information : ndarray, shape (q, p, p)
        weight : ndarray, shape (q, a, a)
        """
        a = self.asked.shape[-1]
        columns = np.linalg.inv(information)[..., :a]
        spread = columns @ weight @ columns.swapaxes(1, 2)
        return np.asarray(-np.tensordot(self.added, spread, axes=([0, 2, 3], [0, 1, 2])) / len(spread))


def candidates(known: Floats, fixed: Floats, rows: Floats, question: Floats, weight: float) -> Candidates:
    """Build the candidates on one frame in well-scaled coordinates.

    Parameters
    ----------
    known : ndarray, shape (k, p)
        Rows of the prior information, in standard deviations: K'K is its information.
    fixed : ndarray, shape (e, p)
        Rows whose product with every allowed change is zero: exact knowledge.
    rows : ndarray, shape (n, d, p)
        Derivatives of each candidate's data in standard deviations.
    question : ndarray, shape (s, p)
        Rows that compute the goal's parameters from all p parameters.
    weight : float
        Weight of every candidate in the coordinates' scaling: this information becomes the identity.

    Raises
    ------
    InputError
        If the goal's parameters are all known exactly.
    """
    free = free_changes(fixed)
    left, sizes, right = np.linalg.svd(question @ free)
    rank = int(np.sum(sizes > KNOWN_EXACTLY * max(1.0, sizes[0] if len(sizes) else 1.0)))
    if not rank or sizes[0] <= KNOWN_EXACTLY:
        raise InputError("what the plan is for is known exactly already; plan for something that is not")
    basis = free @ right.T
    known, rows = known @ basis, rows @ basis
    scale = _lower(np.concatenate([known, np.sqrt(weight) * rows.reshape(-1, rows.shape[2])]))
    known, rows = known @ scale, rows @ scale
    asked = left[:, :rank] * sizes[:rank] @ scale[:rank, :rank]
    return Candidates((known.T @ known)[None], rows[None], asked[None])


def free_changes(fixed: Floats) -> Floats:
    """Find an orthonormal basis, shape (p, f), of the changes of p parameters with zero products with fixed rows."""
    return np.asarray(linalg.null_space(fixed, rcond=1e-12)) if len(fixed) else np.eye(fixed.shape[1])


def _lower(whole: Floats) -> Floats:
    """Find lower triangular L with (whole L)'(whole L) = 1: the first coordinates depend only on the first of z."""
    # QR of the columns in reverse order gives whole' whole = U U' with U upper triangular; L is U^-T.
    triangle = np.asarray(np.linalg.qr(whole[:, ::-1], mode="r"))
    upper = triangle.T[::-1, ::-1]
    return np.asarray(linalg.solve_triangular(upper, np.eye(len(upper))).T)


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

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        s = len(covariance)
        return np.eye(s) / s, float(np.trace(covariance)) / s

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        # tr(F C F') depends only on F'F: a square factor of F'F replaces F.
        T, above = _above(cp, np.asarray(np.linalg.qr(reduced.asked, mode="r")), information)
        return cp.Minimize(cp.trace(T)), [above], None


class Eigenvalue(_Mixture):
    """E: the standard deviation of the worst combination of the parameters."""

    name = "E"
    summary = "standard deviation of the worst combination"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(np.sqrt(np.linalg.eigvalsh(problem.covariance(own))[..., -1]))

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        values, axes = np.linalg.eigh(covariance)
        weights, mean = _power_mean(values)
        return (axes * weights) @ axes.T, mean

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        axes = np.linalg.eigh(reduced.asked @ reduced.asked.T + reduced.left)[1][:, ::-1][:, :MOST_IN_PROGRAM]
        T, above = _above(cp, axes.T @ reduced.asked, information)
        t = cp.Variable()
        below = t * np.eye(axes.shape[1]) - axes.T @ reduced.left @ axes - T >> 0
        return cp.Minimize(t), [above, below], lambda: axes @ below.dual_value @ axes.T


class Worst(_Mixture):
    """Largest relative standard deviation of a parameter: the worst coefficient of variation."""

    name = "worst"
    summary = "worst coefficient of variation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        variances = np.mean(np.sum((problem.asked @ own) * problem.asked, axis=-1), axis=-2)
        return np.asarray(np.sqrt(np.max(variances, axis=-1)))

    def hardest(self, covariance: Floats) -> tuple[Floats, float]:
        weights, mean = _power_mean(np.diag(covariance))
        return np.diag(weights), mean

    def program(self, cp: Any, reduced: Reduced, information: Any) -> Program:
        variances = np.diag(reduced.asked @ reduced.asked.T + reduced.left)
        least_known = ranking.order(variances)[:MOST_IN_PROGRAM]
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
