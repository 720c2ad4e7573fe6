"""The best choice of candidates: a convex program behind it, rounding, exchanges, and what no choice can beat.

    minimize  criterion of C_a(w)   subject to   0 <= w <= 1,  sum w = N,

weights between 0 and 1 in place of yes and no (Joshi and Boyd, 2009), with C_a(w) the covariance of what is asked for.
The program's matrices have a row a direction in the space of the parameters. Directions of which the candidates tell
next to nothing, compared with what is known without them, are left out, and of very many only those they tell most of
are used; it is stated for the frame as designed. Where that is not the whole problem the weights are then improved
with every direction and every frame (sequential quadratic programming, scipy's SLSQP). The bound rests on neither
solver: it is computed afterwards from the weights found. From the weights a choice comes by rounding, and by exchanging
one candidate for another while that improves it.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, minimize

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.criteria import Criterion, Reduced
from cvxshear.util import checks, ranking
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Floats, Ints

SOLVERS = ("clarabel", "scs")
"""Conic solvers that cvxpy brings along and that know semidefinite constraints."""

SOLVER_ACCURACY: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-7},
    "scs": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iters": 40_000},
}
"""Accuracies that they are asked for: the bound is computed afterwards, and rough weights only make it lower."""

TELLING = 1e-3
"""Part of a direction's information that the candidates must give for the direction to stand in the program: the
others' standard deviations change by less than 0.05 %."""

DIRECTIONS_ASKED = 16
"""Directions asked for in the program, and as many again of the rest: its time grows with their fourth power."""

IMPROVES = 1e-9
"""Relative gain from which on an exchange is made; less is rounding."""

AT_ONCE = 2_000_000
"""Numbers in the information matrices that are formed at a time: 16 MB."""

FEW = 20_000
"""Choices up to which all are looked at, of information with `TYPICAL` rows: eighteen floors choose six."""

TYPICAL = 45
"""Rows of the information of an eighteen-story frame with three modes: a cubic measure of what one choice takes."""

AT_LAST = 2
"""Factor on `FEW` where windows leave a gap: a few sensors on a tall frame are then all looked at."""

CLOSE_ENOUGH = 0.05
"""Relative gap to the bound up to which no closer bound is looked for: expected noise is no better known."""

WIDTHS = (4, 6, 8, 10)
"""Numbers of floors in the windows of the closer bound, tried one after the other while the time allows."""

MOST_WORK = 6e7
"""Parameters times choices in a window times the numbers each takes that are affordable: two seconds."""

ROUNDING_SEED = 2009
"""Seed of the choices that are drawn, so that a plan comes out the same each time."""

ROUNDINGS, FEWER_ROUNDINGS = 8, 1
"""Choices drawn with the weights as odds; fewer where there are more than `MANY` candidates, and each takes long."""

MANY = 24
"""Candidates above which a round of exchanges takes seconds: its time goes with the cube of their number."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Candidates that are chosen, and how far from the best and the worst they are.

    Parameters
    ----------
    chosen : ndarray of int, shape (N,)
        Ascending, zero-based.
    value : float
        The criterion's standard deviation.
    bound : float
        What no choice of as many can beat; the value itself where all were looked at.
    worst : float
        What no choice exceeds: the worst of all where all were looked at, else the value without any candidate.
    """

    chosen: Ints
    value: float
    bound: float
    worst: float

    @property
    def gap(self) -> float:
        """How far the choice is above the bound, relative."""
        return self.value / self.bound - 1.0 if self.bound > 0 else float("inf")


def choose(
    problem: Candidates,
    number: int,
    by: Criterion,
    solver: str = "clarabel",
    enumerate_up_to: int = FEW,
    widths: Sequence[int] = WIDTHS,
) -> Choice:
    """Find the best choice: of all, where there are few, else the best that rounding and exchange find.

    Parameters
    ----------
    problem : Candidates
    number : int
        How many.
    by : Criterion
    solver : str, optional
    enumerate_up_to : int, optional
        Where there are no more choices than this, each is looked at.
    widths : sequence of int, optional
        Of the windows with which a closer bound is looked for while the gap is above `CLOSE_ENOUGH`; none where
        the choice alone is wanted.
    """
    frames, rows, _ = problem.base.shape
    work = comb(problem.count, number) * frames * (rows / TYPICAL) ** 3
    if work <= enumerate_up_to:
        return _best_of_all(problem, number, by)
    weights, bound = relaxed(problem, number, by, solver)
    value, chosen = min(exchanged(problem, start, by) for start in _roundings(weights, number))
    # Tangents at the program's own weights are far below where it leaves whole parts of the frame without any.
    evened = (weights + number / problem.count) / 2
    for width in _affordable(widths, problem):
        if value <= (1 + CLOSE_ENOUGH) * bound:
            break
        higher, start = by.windowed(problem, evened, number, width, value / (1 + CLOSE_ENOUGH))
        bound = max(bound, higher)
        value, chosen = min((value, chosen), exchanged(problem, start, by))
    if widths and value > (1 + CLOSE_ENOUGH) * bound and work <= AT_LAST * enumerate_up_to:
        return _best_of_all(problem, number, by)
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


def _affordable(widths: Sequence[int], problem: Candidates) -> list[int]:
    """List the windows whose choices can all be looked at in a few seconds."""
    frames, n, d, _ = problem.rows.shape
    work = problem.asked.shape[1] * n * d**2 * frames
    return [width for width in widths if width <= n and 2**width * work <= MOST_WORK]


def equally_spaced(floors: int, number: int) -> list[int]:
    """List so many floors at equal distances, the top one among them; zero-based."""
    return [round((place + 1) * floors / number) - 1 for place in range(number)]


def _roundings(weights: Floats, number: int) -> list[list[int]]:
    """Choices to exchange from: the largest weights, equal distances, and a few drawn with the weights as odds."""
    rng = np.random.default_rng(ROUNDING_SEED)
    count = len(weights)
    # The largest of log(weight) + Gumbel noise are a draw without replacement with the weights as odds.
    odds = np.log(np.maximum(weights, 1e-6))
    drawn = [odds + rng.gumbel(size=count) for _ in range(ROUNDINGS if count <= MANY else FEWER_ROUNDINGS)]
    largest = [ranking.order(each)[:number] for each in (weights, *drawn)]
    return [*largest, equally_spaced(count, number)]


def exchanged(problem: Candidates, start: Sequence[int], by: Criterion) -> tuple[float, list[int]]:
    """Exchange one candidate for another, the best exchange each time, while that improves the choice.

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
    """Weights of the candidates at which the criterion is least, and the bound that follows.

    Parameters
    ----------
    problem : Candidates
    number : int
        How many are to be chosen, N.
    by : Criterion
    solver : str, optional
        "clarabel" or "scs".

    Returns
    -------
    weights : ndarray, shape (n,)
    bound : float
        Standard deviation that no choice can beat.

    Raises
    ------
    NoSolutionError
        Where the solver finds no weights.
    """
    checks.choice(solver, SOLVERS, "solver")
    if number >= problem.count:
        weights = np.ones(problem.count)
        return weights, float(by.value(problem, problem.information(weights)))
    import cvxpy  # noqa: PLC0415 - takes a second

    # Most of its functions have no types.
    cp: Any = cvxpy
    reduced = _reduced(problem, number / problem.count)
    w = cp.Variable(problem.count)
    r = len(reduced.base)
    information = reduced.base + cp.reshape(reduced.added.reshape(problem.count, -1).T @ w, (r, r), order="C")
    objective, constraints, hardest = by.program(cp, reduced, information)
    conic = cp.Problem(objective, [w >= 0, w <= 1, cp.sum(w) == number, *constraints])
    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": how accurate it is shows in the bound.
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
        improved = descended(partial(by.smooth, problem), weights, total, rounds=100, tolerance=1e-8)
        found.append((by.bound(problem, improved, number), improved))
    bound, weights = max(found, key=lambda pair: pair[0])
    return weights, bound


def _reduced(problem: Candidates, weight: float) -> Reduced:
    """Return the frame as designed in the directions that its candidates tell of."""
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
    """Orthonormal columns, the directions that the candidates tell of, most first; and whether these are all."""
    values, vectors = np.linalg.eigh(whole)
    many = max(1, int(np.sum(values > TELLING)))
    used = ranking.order(values)[: min(many, DIRECTIONS_ASKED)]
    return vectors[:, used], many <= DIRECTIONS_ASKED


def _as_mixture(matrix: Floats) -> Floats:
    """Find the nearest positive semidefinite matrix, of trace 1: what rounding leaves of a multiplier is made one."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    values = np.maximum(values, 0.0)
    return np.asarray((vectors * (values / values.sum())) @ vectors.T)


def descended(
    function: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    within: LinearConstraint,
    rounds: int,
    tolerance: float,
) -> Floats:
    """Where a function of weights between 0 and 1 is least, or at least lower than at the start (scipy's SLSQP).

    Parameters
    ----------
    function : callable
        Value and gradient, shape (n,), at weights of shape (n,).
    start : ndarray, shape (n,)
    within : LinearConstraint
    rounds : int
        Steps at most.
    tolerance : float
        Of the value.
    """
    found = minimize(
        function,
        start,
        jac=True,
        method="SLSQP",
        bounds=Bounds(0.0, 1.0),
        constraints=within,
        options={"maxiter": rounds, "ftol": tolerance},
    )
    return np.asarray(np.clip(found.x, 0.0, 1.0))
