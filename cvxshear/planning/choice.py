"""Best choice of candidates: a convex program, rounding, exchanges, and a bound on all choices.

    minimize  criterion of C_a(w)   subject to   0 <= w <= 1,  sum w = N,

Weights between 0 and 1 replace the decisions (Joshi and Boyd, 2009); C_a(w) is the covariance of the goal's parameters.
The program's matrices have one row per direction in the space of the parameters. Directions are left out if the
candidates add almost no information to the prior. If very many directions remain, the program uses only those with the
most information from the candidates. The program is stated for the frame as designed. If this is not the whole problem,
sequential quadratic programming (scipy's SLSQP) then improves the weights with every direction and every frame. The
bound does not depend on the accuracy of either solver: it is computed afterwards from the weights. Rounding the weights
gives a choice, and exchanges of candidates improve this choice.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, minimize

from cvxshear.planning.criteria import MOST_IN_PROGRAM, Candidates, Criterion, Reduced
from cvxshear.util import checks, ranking
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Floats, Ints

SOLVERS = ("clarabel", "scs")
"""Conic solvers that cvxpy installs and that solve semidefinite constraints."""

SOLVER_ACCURACY: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-7},
    "scs": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iters": 40_000},
}
"""Accuracies of the solvers. The bound is computed afterwards, so rough weights only give a lower bound."""

TELLING = 1e-3
"""Least share of a direction's information that the candidates must give for a direction in the program. The standard
deviations along the other directions change by less than 0.05 %."""

IMPROVES = 1e-9
"""Least relative gain of an exchange; a smaller gain is rounding."""

AT_ONCE = 2_000_000
"""Largest number of entries of the information matrices that are formed together: 16 MB."""


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


def choose(
    problem: Candidates, number: int, by: Criterion, solver: str = "clarabel", enumerate_up_to: float = 4e7
) -> Choice:
    """Find the best choice by trying all, or a good choice by rounding and exchanges if there are too many.

    Parameters
    ----------
    problem : Candidates
    number : int
        Number of candidates to choose.
    by : Criterion
    solver : str, optional
    enumerate_up_to : float, optional
        Largest number of entries of all choices' information matrices for which every choice is tried: some seconds.
    """
    if comb(problem.count, number) * problem.base.size <= enumerate_up_to:
        return _best_of_all(problem, number, by)
    weights, bound = relaxed(problem, number, by, solver)
    value, chosen = min(exchanged(problem, start, by) for start in roundings(weights, number))
    return Choice(np.array(chosen), value, min(bound, value), float(by.value(problem, problem.base)))


def _best_of_all(problem: Candidates, number: int, by: Criterion) -> Choice:
    every = list(combinations(range(problem.count), number))
    values = values_of(problem, every, by)
    best = ranking.first_largest(-values)
    return Choice(np.array(every[best]), float(values[best]), float(values[best]), float(values.max()))


def values_of(problem: Candidates, choices: Sequence[Sequence[int]], by: Criterion) -> Floats:
    """Evaluate the criterion of each of many choices, shape (len(choices),)."""
    step = max(1, AT_ONCE // problem.base.size)
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


def relaxed(problem: Candidates, number: int, by: Criterion, solver: str = "clarabel") -> tuple[Floats, float]:
    """Find the weights that minimize the criterion, and compute the bound at these weights.

    Parameters
    ----------
    problem : Candidates
    number : int
        Number N of candidates to choose.
    by : Criterion
    solver : str, optional
        "clarabel" or "scs".

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
    checks.choice(solver, SOLVERS, "solver")
    if number >= problem.count:
        weights = np.ones(problem.count)
        return weights, float(by.value(problem, problem.information(weights)))
    import cvxpy  # noqa: PLC0415 - takes a second

    # Most functions of cvxpy have no types.
    cp: Any = cvxpy
    reduced = _reduced(problem, number / problem.count)
    w = cp.Variable(problem.count)
    r = len(reduced.base)
    information = reduced.base + cp.reshape(reduced.added.reshape(problem.count, -1).T @ w, (r, r), order="C")
    objective, constraints, hardest = by.program(cp, reduced, information)
    conic = cp.Problem(objective, [w >= 0, w <= 1, cp.sum(w) == number, *constraints])
    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": the bound accounts for the inaccuracy.
            warnings.simplefilter("ignore")
            conic.solve(solver=solver.upper(), **SOLVER_ACCURACY[solver])
    except cp.SolverError as error:
        raise NoSolutionError(f"cvxpy-{solver}", str(error)) from error
    if w.value is None:
        raise NoSolutionError(f"cvxpy-{solver}", f"no weights found (its status: {conic.status})")
    weights = np.clip(w.value, 0.0, 1.0)
    mixture = None if hardest is None else _as_mixture(hardest())
    found = [(by.bound(problem, weights, number, mixture), weights)]
    if not reduced.whole:
        total = LinearConstraint(np.ones((1, problem.count)), number, number)
        smooth = partial(by.smooth, problem)
        descent = minimize(
            smooth, weights, jac=True, method="SLSQP", bounds=Bounds(0.0, 1.0), constraints=total,
            options={"maxiter": 100, "ftol": 1e-8},
        )  # fmt: skip
        improved = np.clip(descent.x, 0.0, 1.0)
        found.append((by.bound(problem, improved, number), improved))
    bound, weights = max(found, key=lambda pair: pair[0])
    return weights, bound


def _reduced(problem: Candidates, weight: float) -> Reduced:
    """Return the frame as designed in the directions on which its candidates have information."""
    base, added, asked = problem.base[0], problem.added[0], problem.asked[0]
    whole = weight * added.sum(axis=0)
    a = asked.shape[1]
    (own, all_own), (rest, all_rest) = _telling(whole[:a, :a]), _telling(whole[a:, a:])
    turn = np.zeros((len(whole), own.shape[1] + rest.shape[1]))
    turn[:a, : own.shape[1]] = own
    turn[a:, own.shape[1] :] = rest
    seen = asked @ own
    left = asked @ asked.T - seen @ seen.T
    single = len(problem.base) == 1
    return Reduced(turn.T @ base @ turn, turn.T @ added @ turn, seen, left, all_own and all_rest and single)


def _telling(whole: Floats) -> tuple[Floats, bool]:
    """Return orthonormal directions with information of the candidates, the largest first; and whether all are used."""
    values, vectors = np.linalg.eigh(whole)
    many = max(1, int(np.sum(values > TELLING)))
    used = ranking.order(values)[: min(many, MOST_IN_PROGRAM)]
    return vectors[:, used], many <= MOST_IN_PROGRAM


def _as_mixture(matrix: Floats) -> Floats:
    """Return the nearest positive semidefinite matrix of trace 1; a solver's multiplier is one only up to rounding."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    values = np.maximum(values, 0.0)
    return np.asarray((vectors * (values / values.sum())) @ vectors.T)
