"""The convex program behind a choice: shares between 0 and 1 in place of yes and no (Joshi and Boyd, 2009).

    minimize  criterion of C_a(w)   subject to   0 <= w <= 1,  sum w = N,

with C_a(w) the covariance of what is asked for. Written for conic solvers with linear matrix inequalities in
w: for D, a matrix S with [[M_aa - S, M_ab], [M_ba, M_bb]] >= 0 is at most the information of z_a with the others
marginalised, and log det S is maximised; for the others [[T, F 0], [(F 0)', M]] >= 0 makes T at least the covariance.

The program's matrices have a row a direction in the space of the parameters. Directions of which the candidates tell
next to nothing, compared with what is known without them, are left out, and of very many only those they tell most of
are kept; the shares are then improved with all of them (sequential quadratic programming, scipy's SLSQP). The bound
rests on neither solver: it is computed afterwards, with every direction, from the shares found.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import LinearConstraint

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.criteria import Criterion
from cvxshear.planning.descent import descended
from cvxshear.util import checks
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Floats

SOLVERS = ("clarabel", "scs")

TELLING = 1e-3
"""Share of a direction's information that the candidates must give for the direction to stand in the program."""

MOST_DIRECTIONS = 16
"""Of what is asked for, and as many again of the rest: the program's time grows with their fourth power."""

MOST_PARAMETERS = 16
"""Parameters, those known least, whose standard deviations stand in the program for the worst one."""

ACCURACY: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-7},
    "scs": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iters": 40_000},
}


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The solved program.

    Parameters
    ----------
    shares : ndarray, shape (n,)
    bound : float
        Standard deviation that no choice can beat.
    solver : str
    """

    shares: Floats
    bound: float
    solver: str


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The candidates in the directions that they tell of.

    Parameters
    ----------
    base, atoms : ndarray, shapes (r, r) and (n, r, r)
    asked : ndarray, shape (s, a)
        F of the directions that are kept, the first a of r.
    left : ndarray, shape (s, s)
        Covariance that comes from the directions left out.
    whole : bool
        Whether the candidates tell of no other direction.
    """

    base: Floats
    atoms: Floats
    asked: Floats
    left: Floats
    whole: bool

    @staticmethod
    def of(whole: Candidates, shares: float) -> _Reduced:
        told = shares * whole.atoms.sum(axis=0)
        a = whole.asked.shape[1]
        (own, all_own), (rest, all_rest) = _telling(told[:a, :a]), _telling(told[a:, a:])
        turn = np.zeros((len(told), own.shape[1] + rest.shape[1]))
        turn[:a, : own.shape[1]] = own
        turn[a:, own.shape[1] :] = rest
        asked = whole.asked @ own
        left = whole.asked @ whole.asked.T - asked @ asked.T
        return _Reduced(turn.T @ whole.base @ turn, turn.T @ whole.atoms @ turn, asked, left, all_own and all_rest)


def _telling(told: Floats) -> tuple[Floats, bool]:
    """Orthonormal columns, the directions that the candidates tell of, most first; and whether these are all."""
    values, vectors = np.linalg.eigh(told)
    many = max(1, int(np.sum(values > TELLING)))
    kept = np.argsort(-values)[: min(many, MOST_DIRECTIONS)]
    return vectors[:, kept], many <= MOST_DIRECTIONS


def relaxed(of: Candidates, number: int, by: Criterion, solver: str = "clarabel") -> Relaxed:
    """Shares of the candidates at which the criterion is least, and the bound that follows.

    Parameters
    ----------
    of : Candidates
    number : int
        How many are to be chosen, N.
    by : Criterion
    solver : str, optional
        "clarabel" or "scs".

    Raises
    ------
    NoSolutionError
        Where the solver finds no shares.
    """
    checks.choice(solver, SOLVERS, "solver")
    if number >= of.count:
        shares = np.ones(of.count)
        return Relaxed(shares, float(by.value(of, of.information(shares))), solver)
    import cvxpy  # noqa: PLC0415 - takes a second

    # Most of its functions have no types.
    cp: Any = cvxpy
    reduced = _Reduced.of(of, number / of.count)
    w = cp.Variable(of.count)
    flat = reduced.atoms.reshape(of.count, -1)
    r = len(reduced.base)
    information = reduced.base + cp.reshape(flat.T @ w, (r, r), order="C")
    objective, constraints, hardest = FORMS[by.name](cp, reduced, information)
    problem = cp.Problem(objective, [w >= 0, w <= 1, cp.sum(w) == number, *constraints])
    try:
        with warnings.catch_warnings():
            # "Solution may be inaccurate": how accurate it is shows in the bound.
            warnings.simplefilter("ignore")
            problem.solve(solver=solver.upper(), **ACCURACY[solver])
    except cp.SolverError as error:
        raise NoSolutionError(f"cvxpy-{solver}", str(error)) from error
    if w.value is None:
        raise NoSolutionError(f"cvxpy-{solver}", f"no shares found (its status: {problem.status})")
    shares = np.clip(w.value, 0.0, 1.0)
    weight = None if hardest is None else _as_weight(hardest())
    found = [(by.bound(of, shares, number, weight), shares)]
    if not reduced.whole:
        total = LinearConstraint(np.ones((1, of.count)), number, number)
        improved = descended(partial(by.smooth, of), shares, total, rounds=100, tolerance=1e-8)
        found.append((by.bound(of, improved, number), improved))
    bound, shares = max(found, key=lambda pair: pair[0])
    return Relaxed(shares, bound, solver)


Form = tuple[Any, list[Any], Callable[[], Floats] | None]


def _determinant(cp: Any, of: _Reduced, information: Any) -> Form:
    a = of.asked.shape[1]
    S = cp.Variable((a, a), symmetric=True)
    r = len(of.base)
    embed = np.eye(r)[:, :a]
    return cp.Maximize(cp.log_det(S)), [information - embed @ S @ embed.T >> 0], None


def _trace(cp: Any, of: _Reduced, information: Any) -> Form:
    # tr(F C F') depends on F'F alone: a square factor of it stands for F.
    factor = np.asarray(np.linalg.qr(of.asked, mode="r"))
    T, above = _above(cp, factor, information)
    return cp.Minimize(cp.trace(T)), [above], None


def _eigenvalue(cp: Any, of: _Reduced, information: Any) -> Form:
    axes = np.linalg.eigh(of.asked @ of.asked.T + of.left)[1][:, ::-1][:, :MOST_PARAMETERS]
    T, above = _above(cp, axes.T @ of.asked, information)
    t = cp.Variable()
    below = t * np.eye(axes.shape[1]) - axes.T @ of.left @ axes - T >> 0
    return cp.Minimize(t), [above, below], lambda: axes @ below.dual_value @ axes.T


def _worst(cp: Any, of: _Reduced, information: Any) -> Form:
    variance = np.diag(of.asked @ of.asked.T + of.left)
    kept = np.argsort(-variance)[:MOST_PARAMETERS]
    T, above = _above(cp, of.asked[kept], information)
    t = cp.Variable()
    below = cp.diag(T) + np.diag(of.left)[kept] <= t

    def hardest() -> Floats:
        weight = np.zeros((len(variance), len(variance)))
        weight[kept, kept] = np.maximum(below.dual_value, 0.0)
        return weight

    return cp.Minimize(t), [above, below], hardest


def _above(cp: Any, asked: Floats, information: Any) -> tuple[Any, Any]:
    """A matrix T, and the constraint that makes it at least F C_a F'."""
    s, r = len(asked), information.shape[0]
    wide = np.hstack([asked, np.zeros((s, r - asked.shape[1]))])
    T = cp.Variable((s, s), symmetric=True)
    return T, cp.bmat([[T, wide], [wide.T, information]]) >> 0


FORMS: dict[str, Callable[[Any, _Reduced, Any], Form]] = {
    "D": _determinant,
    "A": _trace,
    "E": _eigenvalue,
    "worst": _worst,
}


def _as_weight(matrix: Floats) -> Floats:
    """The nearest positive semidefinite matrix, of trace 1: what rounding leaves of a multiplier is made one."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    values = np.maximum(values, 0.0)
    result: Floats = (vectors * (values / values.sum())) @ vectors.T
    return result
