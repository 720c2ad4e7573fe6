"""Best choice of candidates: their information, the criteria, a convex program, exchanges, and a bound on all choices.

The information of the parameters is a sum over the chosen candidates, floors or tests,

    M(w) = M_0 + sum over j of w_j G_j,   G_j = J_j' J_j,

with w_j = 1 for a chosen candidate. The scale of every measured shape is unknown. Eliminating the scale from each shape
would spoil the sum, so the scale is a parameter here, and the criteria use the covariance with the other parameters
marginalized. A criterion is one number from this covariance, convex in the weights, reported as a standard deviation.

    minimize  criterion of C_a(w)   subject to   0 <= w <= 1,  sum w = N

is the convex program with weights in place of decisions (Joshi and Boyd, 2009), stated in cvxpy and solved by Clarabel.
The bound does not depend on the solver's accuracy: it is computed afterwards from the weights. Rounding the weights
gives a choice, and exchanges of candidates improve this choice.
"""

from __future__ import annotations

import operator
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any, ClassVar

import numpy as np
from scipy import linalg

from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.typing import Floats, Ints

#: Largest length of a row of the question, with each parameter relative to its size, for an exactly known parameter.
KNOWN_EXACTLY = 1e-12

#: Accuracy of the solver. The bound is computed afterwards, so rough weights only give a lower bound.
ACCURACY = {"tol_gap_abs": 1e-5, "tol_gap_rel": 1e-5, "tol_feas": 1e-6}

#: Number of directions of the parameters in the program of D, twice as many in that of A, one and a half times in that
#: of E; the time grows with the sixth power. Of 40 stories, it leaves the bound at least 99.5 % of the optimum.
TOLD = 28

#: Largest relative difference of best and worst choice that counts as equal; the noise is not known to one percent.
ARBITRARY = 0.01


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
    def inner(self) -> Floats:
        """F'F, shape (a, a)."""
        return np.asarray(self.asked.T @ self.asked)

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.rows)

    def information(self, weights: Floats) -> Floats:
        """Compute M(w), shape (..., p, p), for weights w of shape (..., n)."""
        return np.asarray(self.base + np.tensordot(weights, self.added, axes=(-1, 0)))

    def telling(self, most: int, worst: int = 0) -> Candidates:
        """Keep the directions of z_a of which the candidates tell most, and the `worst` ones for the goal's parameters.

        The others hardly depend on the weights. Without them the programs of tall frames take a second.
        """
        a = self.asked.shape[1]
        known, widest = np.linalg.eigh(self.base[:a, :a])[1], np.linalg.eigh(self.inner)[1][:, ::-1]
        own = linalg.orth(np.hstack([known[:, :most], widest[:, :worst]]))
        turn = linalg.block_diag(own, np.eye(len(self.base) - a))
        return Candidates(turn.T @ self.base @ turn, self.rows @ turn, self.asked @ own)

    def stated(self, cp: Any, w: Any) -> Any:
        """State M(w) for weights w of cvxpy."""
        return self.base + cp.reshape(self.added.reshape(self.count, -1).T @ w, self.base.shape, order="C")

    def own(self, information: Floats) -> Floats:
        """Compute the covariance of z_a with all others marginalized, shape (..., a, a)."""
        a = self.asked.shape[1]
        return np.asarray(np.linalg.inv(information), dtype=np.float64)[..., :a, :a]

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
        return self.std(problem, self.measure(problem, problem.own(information)))

    def bound(self, problem: Candidates, weights: Floats, number: int, dual: Floats) -> float:
        """Compute a lower bound for all choices of `number` candidates, by linearizing at these weights.

        A convex function lies above its tangent. Sorting gives the tangent's minimum over 0 <= w <= 1, sum w = N.
        Hence the bound is valid for any weights and any `dual`; better ones give a tighter bound.
        """
        information = problem.information(weights)
        value, weight = self.tangent(problem, problem.own(information), dual)
        slopes = problem.slopes(information, weight)
        least = np.sort(slopes)[:number].sum() - slopes @ weights
        return float(self.std(problem, np.asarray(value + least)))

    def std(self, problem: Candidates, measure: Floats) -> Floats:
        """Convert the measure to a standard deviation; by default, it is a variance."""
        return np.sqrt(np.maximum(measure, 0.0))

    @abstractmethod
    def measure(self, problem: Candidates, own: Floats) -> Floats:
        """Compute a function of the covariances of z_a, shape (..., a, a), that is convex in the weights."""

    @abstractmethod
    def tangent(self, problem: Candidates, own: Floats, dual: Floats) -> tuple[float, Floats]:
        """Return a number of at most the measure, and its derivative by the covariance of z_a, shape (a, a).

        `dual` is the multiplier of the program's constraint.
        """

    @abstractmethod
    def program(self, cp: Any, problem: Candidates, w: Any) -> tuple[Any, Any]:
        """State the measure in cvxpy, as a function of weights w: the objective and a constraint."""


class Determinant(Criterion):
    """D: the geometric mean of the standard deviations along the axes of the covariance ellipsoid."""

    name = "D"
    summary = "geometric mean standard deviation"

    def measure(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(problem.log_volume + np.linalg.slogdet(own)[1])

    def std(self, problem: Candidates, measure: Floats) -> Floats:
        return np.asarray(np.exp(measure / (2 * problem.asked.shape[1])))

    def tangent(self, problem: Candidates, own: Floats, dual: Floats) -> tuple[float, Floats]:
        return float(self.measure(problem, own)), np.asarray(np.linalg.inv(own), dtype=np.float64)

    def program(self, cp: Any, problem: Candidates, w: Any) -> tuple[Any, Any]:
        # S is at most the information of z_a with all others marginalized.
        some = problem.telling(TOLD)
        p, a = len(some.base), some.asked.shape[1]
        S = cp.Variable((a, a), symmetric=True)
        return cp.Maximize(cp.log_det(S)), some.stated(cp, w) - np.eye(p, a) @ S @ np.eye(a, p) >> 0


class Trace(Criterion):
    """A: the root mean square standard deviation."""

    name = "A"
    summary = "root mean square standard deviation"

    def measure(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(np.sum(own * problem.inner, axis=(-2, -1)) / len(problem.asked))

    def tangent(self, problem: Candidates, own: Floats, dual: Floats) -> tuple[float, Floats]:
        return float(self.measure(problem, own)), problem.inner / len(problem.asked)

    def program(self, cp: Any, problem: Candidates, w: Any) -> tuple[Any, Any]:
        # C is the covariance of the best linear unbiased estimator, which weights the prior and each candidate's data.
        some = problem.telling(2 * TOLD)
        F = np.pad(np.linalg.qr(some.asked, mode="r"), ((0, 0), (0, len(some.base) - some.asked.shape[1])))
        values, axes = np.linalg.eigh(some.base)
        prior, *Z = (cp.Variable((len(F), each)) for each in (len(values), *[some.rows.shape[1]] * some.count))
        unbiased = prior @ (axes * np.sqrt(np.maximum(values, 0.0))).T + sum(map(operator.matmul, Z, some.rows)) == F
        return cp.Minimize(cp.sum_squares(prior) + sum(map(cp.quad_over_lin, Z, w))), unbiased


class Eigenvalue(Criterion):
    """E: the standard deviation of the worst combination of the parameters."""

    name = "E"
    summary = "standard deviation of the worst combination"

    def measure(self, problem: Candidates, own: Floats) -> Floats:
        return np.asarray(np.linalg.eigvalsh(problem.covariance(own))[..., -1])

    def tangent(self, problem: Candidates, own: Floats, dual: Floats) -> tuple[float, Floats]:
        # The largest eigenvalue is at least tr(Z C) for every mixture Z of parameters; the multiplier is the hardest.
        F = problem.telling(TOLD, TOLD // 2).asked
        values, axes = np.linalg.eigh(F @ dual[: F.shape[1], : F.shape[1]] @ F.T)
        shares = np.maximum(values, 0.0)
        mixture = problem.asked.T @ axes
        weight = np.asarray(mixture * (shares / shares.sum()) @ mixture.T)
        return float(np.sum(weight * own)), weight

    def program(self, cp: Any, problem: Candidates, w: Any) -> tuple[Any, Any]:
        # F C F' <= 1 / t if, and only if, M >= t F'F.
        some, t = problem.telling(TOLD, TOLD // 2), cp.Variable()
        inner = np.pad(some.inner, (0, len(some.base) - len(some.inner)))
        return cp.Maximize(t), some.stated(cp, w) - t * inner >> 0


#: Criteria by their names in options.
CRITERIA: dict[str, Criterion] = {each.name: each for each in (Determinant(), Trace(), Eigenvalue())}


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
        every = list(combinations(range(problem.count), number))
        values = values_of(problem, every, by)
        best = ranking.first_largest(-values)
        return Choice(np.array(every[best]), float(values[best]), float(values[best]), float(values.max()))
    weights, bound = relaxed(problem, number, by)
    value, chosen = min(exchanged(problem, start, by) for start in roundings(weights, number))
    return Choice(np.array(chosen), value, min(bound, value), float(by.value(problem, problem.base)))


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
    value, chosen = np.inf, sorted(start)
    found = [chosen]
    while True:
        values = values_of(problem, found, by)
        best = ranking.first_largest(-values)
        if ranking.first_largest([-value, -values[best]]) == 0:
            return value, chosen
        value, chosen = float(values[best]), found[best]
        others = set(range(problem.count)).difference(chosen)
        found = [sorted({*chosen, into} - {out}) for out in chosen for into in others]


def relaxed(problem: Candidates, number: int, by: Criterion) -> tuple[Floats, float]:
    """Find the weights that minimize the criterion, and compute the bound at these weights.

    Parameters
    ----------
    problem : Candidates
    number : int
        Number N of candidates to choose.
    by : Criterion

    Returns
    -------
    weights : ndarray, shape (n,)
    bound : float
        Lower bound of the standard deviation over all choices.

    Raises
    ------
    NoSolutionError
        If the solver finds no weights.
    """
    import cvxpy  # noqa: PLC0415 - takes a second to import

    cp: Any = cvxpy  # most functions of cvxpy have no types
    w = cp.Variable(problem.count)
    objective, constraint = by.program(cp, problem, w)
    conic = cp.Problem(objective, [w >= 0, w <= 1, cp.sum(w) == number, constraint])
    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": the bound accounts for the inaccuracy.
            warnings.simplefilter("ignore")
            conic.solve(solver="CLARABEL", **ACCURACY)
    except cp.SolverError as error:
        raise NoSolutionError("cvxpy-clarabel", str(error)) from error
    if w.value is None:
        raise NoSolutionError("cvxpy-clarabel", f"no weights found (its status: {conic.status})")
    weights = np.clip(w.value, 0.0, 1.0)
    return weights, by.bound(problem, weights, number, constraint.dual_value)
