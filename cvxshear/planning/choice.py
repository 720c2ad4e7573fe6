"""Best choice of candidates: their information, the criteria, a convex program, exchanges, and a bound on all choices.

The information of the parameters is a sum over the chosen candidates, floors or tests,

    M(w) = M_0 + sum over j of w_j G_j,   G_j = J_j' J_j,

with w_j = 1 for a chosen candidate. The scale of every measured shape is unknown. Eliminating the scale from each shape
would spoil the sum, so the scale is a parameter here, and the criteria use the covariance with the other parameters
marginalized. A criterion is one number from this covariance, convex in the weights, reported as a standard deviation.

    minimize  criterion of C_a(w)   subject to   0 <= w <= 1,  sum w = N

is the convex program with weights in place of decisions (Joshi and Boyd, 2009). Sequential quadratic programming solves
it (scipy's SLSQP). The bound does not depend on the solver's accuracy: it is computed afterwards from the weights.
Rounding the weights gives a choice, and exchanges of candidates improve this choice.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import comb
from typing import ClassVar

import numpy as np
from scipy import linalg, optimize

from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

KNOWN_EXACTLY = 1e-12
"""Largest length of a row of the question, with each parameter relative to its size, for an exactly known parameter."""

IMPROVES = 1e-9
"""Least relative gain of an exchange; a smaller gain is rounding."""

ARBITRARY = 0.01
"""Largest relative difference of best and worst choice that counts as equal; the noise is not known to one percent."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Prior information and the information of each candidate, in well-scaled coordinates.

    The goal's parameters are x = F z_a; z_a are the first of these coordinates z. The information of all
    candidates with equal weights is the identity.

    Parameters
    ----------
    base : ndarray, shape (p, p)
        Information without any candidate.
    rows : ndarray, shape (n, d, p)
        J_j of each candidate.
    asked : ndarray, shape (s, a)
        F.
    """

    base: Floats
    rows: Floats
    asked: Floats

    @cached_property
    def added(self) -> Floats:
        """Information that each candidate adds, G_j, shape (n, p, p)."""
        return self.rows.swapaxes(1, 2) @ self.rows

    @cached_property
    def log_volume(self) -> float:
        """log det of the covariance of the goal's parameters if the covariance of z_a is the identity."""
        return float(np.sum(np.log(np.linalg.svd(self.asked, compute_uv=False) ** 2)))

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.rows)

    def information(self, weights: Floats) -> Floats:
        """Compute M(w), shape (..., p, p), for weights w of shape (..., n)."""
        return np.asarray(self.base + np.tensordot(weights, self.added, axes=(-1, 0)))

    def subset(self, chosen: Ints | Sequence[int]) -> Floats:
        """Return the information of the chosen candidates, shape (p, p)."""
        return np.asarray(self.base + self.added[list(chosen)].sum(axis=0))

    def own(self, information: Floats) -> Floats:
        """Compute the covariance of z_a with all others marginalized, shape (..., a, a)."""
        a = self.asked.shape[1]
        return np.asarray(np.linalg.inv(information), dtype=np.float64)[..., :a, :a]

    def own_with_each(self, chosen: list[int], others: list[int]) -> Floats:
        """Compute the covariance of z_a with the chosen candidates and each one of the others, shape (k, a, a).

        C - C J' (1 + J C J')^-1 J C needs only one inverse for all of them.
        """
        a = self.asked.shape[1]
        covariance = np.linalg.inv(self.subset(chosen))
        J = self.rows[others]
        seen = J @ covariance
        inner = np.eye(J.shape[1]) + seen @ J.swapaxes(1, 2)
        columns = seen[..., :a]
        result: Floats = covariance[:a, :a] - columns.swapaxes(1, 2) @ np.linalg.solve(inner, columns)
        return result

    def covariance(self, own: Floats) -> Floats:
        """Compute the covariance of the goal's parameters, (..., s, s), from the covariance of z_a."""
        return np.asarray(self.asked @ own @ self.asked.T)

    def slopes(self, information: Floats, weight: Floats) -> Floats:
        """Differentiate tr(weight C_aa) by the weights, shape (n,): -tr(weight C_a. G_j C_.a), C the whole covariance.

        Parameters
        ----------
        information : ndarray, shape (p, p)
        weight : ndarray, shape (a, a)
        """
        columns = np.linalg.inv(information)[:, : self.asked.shape[1]]
        return np.asarray(-np.tensordot(self.added, columns @ weight @ columns.T, axes=2))


def candidates(known: Floats, fixed: Floats, rows: Floats, question: Floats, weight: float) -> Candidates:
    """Build the candidates in well-scaled coordinates.

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
    return Candidates(known.T @ known, rows, left[:, :rank] * sizes[:rank] @ scale[:rank, :rank])


def free_changes(fixed: Floats) -> Floats:
    """Find an orthonormal basis, shape (p, f), of the changes of p parameters with zero products with fixed rows."""
    return np.asarray(linalg.null_space(fixed, rcond=1e-12)) if len(fixed) else np.eye(fixed.shape[1])


def _lower(whole: Floats) -> Floats:
    """Find lower triangular L with (whole L)'(whole L) = 1: the first coordinates depend only on the first of z."""
    # QR of the columns in reverse order gives whole' whole = U U' with U upper triangular; L is U^-T.
    triangle = np.asarray(np.linalg.qr(whole[:, ::-1], mode="r"))
    upper = triangle.T[::-1, ::-1]
    return np.asarray(linalg.solve_triangular(upper, np.eye(len(upper))).T)


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
        """Return the criterion as a standard deviation, shape (...), for information, shape (..., p, p)."""
        return self.value_at(problem, problem.own(information))

    @abstractmethod
    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        """Return the criterion as a standard deviation, shape (...), for covariances of z_a, shape (..., a, a)."""

    @abstractmethod
    def smooth(self, problem: Candidates, weights: Floats, power: int) -> tuple[float, Floats]:
        """Evaluate a smooth convex function with almost the criterion's minimizer, and its gradient, shape (n,).

        For E it is the power mean (sum of v^power)^(1/power) of the eigenvalues, which approaches the largest.
        """

    @abstractmethod
    def bound(self, problem: Candidates, weights: Floats, number: int, power: int) -> float:
        """Compute a lower bound for all choices of `number` candidates, by linearizing at these weights.

        A convex function lies above its tangent. Sorting gives the tangent's minimum over 0 <= w <= 1, sum w = N.
        Hence the bound is valid for any weights; better weights give a tighter bound.
        """


class Determinant(Criterion):
    """D: the geometric mean of the standard deviations along the axes of the covariance ellipsoid."""

    name = "D"
    summary = "geometric mean standard deviation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        return self._std(problem, problem.log_volume + np.linalg.slogdet(own)[1])

    def smooth(self, problem: Candidates, weights: Floats, power: int) -> tuple[float, Floats]:
        information = problem.information(weights)
        own = problem.own(information)
        return problem.log_volume + float(np.linalg.slogdet(own)[1]), problem.slopes(
            information, np.asarray(np.linalg.inv(own), dtype=np.float64)
        )

    def bound(self, problem: Candidates, weights: Floats, number: int, power: int) -> float:
        volume, slopes = self.smooth(problem, weights, power)
        return float(self._std(problem, volume + _least(slopes, weights, number)))

    @staticmethod
    def _std(problem: Candidates, volume: Floats | float) -> Floats:
        return np.asarray(np.exp(volume / (2 * problem.asked.shape[1])))


class _Mixture(Criterion):
    """Criteria that maximize tr(Z C) over a set of mixtures Z of the parameters."""

    def smooth(self, problem: Candidates, weights: Floats, power: int) -> tuple[float, Floats]:
        least, variance, slopes = self._linear(problem, weights, power)
        # The logarithm has the same size for every frame.
        return float(np.log(least)), slopes / variance

    def bound(self, problem: Candidates, weights: Floats, number: int, power: int) -> float:
        _, variance, slopes = self._linear(problem, weights, power)
        return float(np.sqrt(max(variance + _least(slopes, weights, number), 0.0)))

    def _linear(self, problem: Candidates, weights: Floats, power: int) -> tuple[float, float, Floats]:
        """Return the smooth function's value, and tr(Z C) with its derivatives for the hardest mixture Z."""
        information = problem.information(weights)
        covariance = problem.covariance(problem.own(information))
        Z, least = self.hardest(covariance, power)
        return least, float(np.sum(Z * covariance)), problem.slopes(information, problem.asked.T @ Z @ problem.asked)

    @abstractmethod
    def hardest(self, covariance: Floats, power: int) -> tuple[Floats, float]:
        """Find a mixture of trace 1 that nearly maximizes tr(Z C), and the value of the smooth function of C."""


class Trace(_Mixture):
    """A: the root mean square standard deviation."""

    name = "A"
    summary = "root mean square standard deviation"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        inner = problem.asked.T @ problem.asked
        return np.asarray(np.sqrt(np.sum(own * inner, axis=(-2, -1)) / len(problem.asked)))

    def hardest(self, covariance: Floats, power: int) -> tuple[Floats, float]:
        s = len(covariance)
        return np.eye(s) / s, float(np.trace(covariance)) / s


class Eigenvalue(_Mixture):
    """E: the standard deviation of the worst combination of the parameters."""

    name = "E"
    summary = "standard deviation of the worst combination"

    def value_at(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(np.sqrt(np.linalg.eigvalsh(problem.covariance(own))[..., -1]))

    def hardest(self, covariance: Floats, power: int) -> tuple[Floats, float]:
        values, axes = np.linalg.eigh(covariance)
        ratio = np.maximum(values, 0.0) / values[-1]
        weights = ratio ** (power - 1)
        mean = float(values[-1]) * float(np.sum(ratio**power)) ** (1 / power)
        return (axes * (weights / weights.sum())) @ axes.T, mean


CRITERIA: dict[str, Criterion] = {each.name: each for each in (Determinant(), Trace(), Eigenvalue())}
"""Criteria by their names in options."""


def _least(slopes: Floats, weights: Floats, number: int) -> float:
    """Minimize slopes' (w - weights) over 0 <= w <= 1, sum w = number: the `number` lowest slopes have w = 1."""
    return float(np.sort(slopes)[:number].sum() - slopes @ weights)


@dataclass(frozen=True, eq=False)
class Choice:
    """Chosen candidates, and bounds on the best and the worst choice.

    Parameters
    ----------
    chosen : ndarray of int, shape (N,)
        Ascending, zero-based.
    value : float
        The criterion's standard deviation.
    bound : float
        Lower bound on all choices of the same size; the value itself if all choices were tried.
    worst : float
        Upper bound on all choices: the worst if all choices were tried, else the value without any candidate.
    """

    chosen: Ints
    value: float
    bound: float
    worst: float

    @property
    def gap(self) -> float:
        """Relative difference of the choice's value and the bound."""
        return self.value / self.bound - 1.0 if self.bound > 0 else float("inf")

    @property
    def arbitrary(self) -> bool:
        """Whether every choice of the same size is equally good."""
        return self.worst <= (1 + ARBITRARY) * self.bound


def choose(problem: Candidates, number: int, by: Criterion, enumerate_up_to: float = 4e7) -> Choice:
    """Find the best choice by trying all, or a good choice by rounding and exchanges if there are too many.

    Parameters
    ----------
    problem : Candidates
    number : int
        Number of candidates to choose.
    by : Criterion
    enumerate_up_to : float, optional
        Largest number of entries of all choices' information matrices for which every choice is tried: some seconds.
    """
    if comb(problem.count, number) * problem.base.size <= enumerate_up_to:
        return _best_of_all(problem, number, by)
    weights, bound = relaxed(problem, number, by)
    value, chosen = min(exchanged(problem, start, by) for start in roundings(weights, number))
    return Choice(np.array(chosen), value, min(bound, value), float(by.value(problem, problem.base)))


def _best_of_all(problem: Candidates, number: int, by: Criterion) -> Choice:
    every = list(combinations(range(problem.count), number))
    values = values_of(problem, every, by)
    best = ranking.first_largest(-values)
    return Choice(np.array(every[best]), float(values[best]), float(values[best]), float(values.max()))


def values_of(problem: Candidates, choices: Sequence[Sequence[int]], by: Criterion, at_once: int = 2_000_000) -> Floats:
    """Evaluate the criterion of each of many choices, shape (len(choices),).

    `at_once` is the largest number of entries of the information matrices that are formed together: 16 MB.
    """
    step = max(1, at_once // problem.base.size)
    parts = []
    for first in range(0, len(choices), step):
        some = choices[first : first + step]
        weights = np.zeros((len(some), problem.count))
        np.put_along_axis(weights, np.array(some), 1.0, axis=1)
        parts.append(by.value(problem, problem.information(weights)))
    return np.concatenate(parts)


def equally_spaced(floors: int, number: int) -> list[int]:
    """List `number` floors at equal distances, including the top floor; zero-based."""
    return [round((place + 1) * floors / number) - 1 for place in range(number)]


def roundings(weights: Floats, number: int, drawn: int = 4, seed: int = 2009) -> list[list[int]]:
    """List starting choices: the largest weights, equal distances, and a few drawn with the weights as odds.

    A fixed seed makes plans repeatable.
    """
    count = len(weights)
    # The largest values of log(weight) + Gumbel noise are a draw without replacement with the weights as odds.
    noise = np.random.default_rng(seed).gumbel(size=(drawn, count))
    scores = [weights, *(np.log(np.maximum(weights, 1e-6)) + noise)]
    return [*(ranking.order(each)[:number] for each in scores), equally_spaced(count, number)]


def exchanged(problem: Candidates, start: Sequence[int], by: Criterion) -> tuple[float, list[int]]:
    """Repeat the best exchange of one candidate for another while the choice improves.

    Returns
    -------
    value : float
    chosen : list of int
        Ascending.
    """
    chosen = sorted(start)
    value = float(by.value(problem, problem.subset(chosen)))
    while True:
        others = [j for j in range(problem.count) if j not in chosen]
        if not others:
            return value, chosen
        ends = []
        for out in chosen:
            rest = [i for i in chosen if i != out]
            values = by.value_at(problem, problem.own_with_each(rest, others))
            best = ranking.first_largest(-values)
            ends.append((float(values[best]), sorted([*rest, others[best]])))
        least, nearest = min(ends)
        if least >= value * (1 - IMPROVES):
            return value, chosen
        value, chosen = least, nearest


def relaxed(problem: Candidates, number: int, by: Criterion, powers: Sequence[int] = (24, 200)) -> tuple[Floats, float]:
    """Find the weights that minimize the criterion, and compute the bound at these weights.

    Parameters
    ----------
    problem : Candidates
    number : int
        Number N of candidates to choose.
    by : Criterion
    powers : sequence of int, optional
        Exponents of the power mean, for one descent after the other. With s parameters, the mean exceeds the largest
        variance by at most a factor of s^(1/power).

    Returns
    -------
    weights : ndarray, shape (n,)
    bound : float
        Lower bound of the standard deviation over all choices.
    """
    weights = np.full(problem.count, number / problem.count)
    total = optimize.LinearConstraint(np.ones((1, problem.count)), number, number)
    found = []
    for power in powers:
        descent = optimize.minimize(
            partial(by.smooth, problem, power=power), weights, jac=True, method="SLSQP",
            bounds=optimize.Bounds(0.0, 1.0), constraints=total, options={"maxiter": 200, "ftol": 1e-9},
        )  # fmt: skip
        weights = np.clip(descent.x, 0.0, 1.0)
        found.append((by.bound(problem, weights, number, power), weights))
    bound, weights = max(found, key=lambda pair: pair[0])
    return weights, bound
