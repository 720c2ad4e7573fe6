"""Lower bounds that use whole sensors: all choices of floors near a parameter, weights far from it.

The tangent bound with weights is too optimistic for few sensors. Half a sensor on every floor observes every story a
little; whole sensors on every other floor do not. But mainly the floors near a story determine its stiffness. Let phi
be a variance, or the logarithm of one, convex in the weights; T a window of neighboring floors; pi the choice within
the window; v the weights of the tangent. For every choice w that equals pi in T,

    phi(w) >= phi(pi, v) + sum over k outside T of (d phi / d w_k)(pi, v) (w_k - v_k).

The slopes depend on pi. Fixed slopes b_k replace them, and the constant gets the least difference over all choices of
the other floors. The bound then is a number for each pi plus a number for each floor outside. `path` finds the exact
minimum, over all choices of N sensors, of a sum of such terms or of the largest term. Empty windows would give the
tangent bound of the convex program; a window of all floors would try every choice.

Criteria consist of such phi (`Term`); few floors determine each. The trace of the covariance is a sum of variances. Its
volume follows from the chain rule: the logarithms of the variances of x_i, given x_1, ..., x_(i-1), add up to
log det C. Each logarithm is convex for two reasons: given parameters are deleted from the information, and the
information of one parameter with the rest marginalized is concave in the whole information.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.planning.candidates import Candidates
from cvxshear.util.typing import Bools, Floats, Ints

MIXTURE_ROUNDS = 60
"""Maximum number of rounds that add mixtures against the best choice so far; most bounds need fewer."""

A_ROUND = 4
"""Number of windows that get a new mixture in each round."""

Hardest = Callable[[Floats], tuple[Floats, Floats]]
"""Function of covariances, shape (..., s, s): the criterion's variance, (...), and its mixture of the parameters,
(..., s)."""


@dataclass(frozen=True, eq=False)
class Term:
    """v' C(w) v, or its logarithm; C(w) is the inverse of an information that is linear in the weights.

    Parameters
    ----------
    base : ndarray, shape (p, p)
        Information without any candidate.
    rows : ndarray, shape (n, d, p)
        J_j of each candidate.
    v : ndarray, shape (p,)
    logarithm : bool
    weight : float
        Factor of the term in a sum.
    """

    base: Floats
    rows: Floats
    v: Floats
    logarithm: bool = False
    weight: float = 1.0

    def information(self, weights: Floats) -> Floats:
        """Return the information, shape (p, p), at weights of shape (n,)."""
        weighed = (self.rows * np.sqrt(weights)[:, None, None]).reshape(-1, len(self.v))
        return np.asarray(self.base + weighed.T @ weighed)

    def slopes(self, weights: Floats) -> Floats:
        """Return derivatives by the weights, shape (n,)."""
        seen = np.linalg.solve(self.information(weights), self.v)
        steep: Floats = -np.sum((self.rows @ seen) ** 2, axis=1)
        return self.weight * (steep / float(self.v @ seen) if self.logarithm else steep)


def variance(problem: Candidates, mixture: Floats) -> list[Term]:
    """Return the variance of a mixture of the goal's parameters: one term per frame; their sum is the mean.

    Parameters
    ----------
    problem : Candidates
    mixture : ndarray, shape (s,)
    """
    terms = []
    for base, rows, asked in zip(problem.base, problem.rows, problem.asked, strict=True):
        v = np.zeros(len(base))
        v[: asked.shape[1]] = asked.T @ mixture
        terms.append(Term(base, rows, v, weight=1.0 / len(problem.base)))
    return terms


def log_volume(problem: Candidates, weights: Floats) -> tuple[list[Term], float]:
    """Return terms and a constant; their sum is the mean over the frames of log det of the covariance of z_a.

    Parameters
    ----------
    problem : Candidates
    weights : ndarray, shape (n,)
        Weights that show which candidates determine which parameter; the parameters are sorted along the candidates.
    """
    a, share = problem.asked.shape[-1], 1.0 / len(problem.base)
    terms, constant = [], 0.0
    every = zip(problem.base, problem.rows, problem.asked, problem.information(weights), strict=True)
    for base, rows, asked, information in every:
        # If an equality ties some parameters to others, only independent ones (a in number) are picked.
        picked = np.sort(linalg.qr(asked.T, mode="r", pivoting=True)[1][:a])
        # Mean position of the candidates that determine each parameter, weighted with the slopes of its variance.
        slopes = np.sum((rows @ np.linalg.inv(information)[:, :a] @ asked[picked].T) ** 2, axis=1)
        picked = picked[np.argsort(np.arange(len(rows)) @ slopes / slopes.sum(axis=0), kind="stable")]
        square = asked[picked]
        turn = linalg.block_diag(np.linalg.inv(square), np.eye(len(base) - a))
        turned, seen = turn.T @ base @ turn, rows @ turn
        for first in range(a):
            v = np.eye(1, len(base) - first)[0]
            terms.append(Term(turned[first:, first:], seen[:, :, first:], v, logarithm=True, weight=share))
        constant -= 2.0 * share * float(np.linalg.slogdet(square)[1])
    return terms, constant


def least_of_sum(terms: Sequence[Term], weights: Floats, number: int, width: int) -> tuple[float, list[int]]:
    """Compute a lower bound of the sum of terms over all choices of `number` candidates; return its choice, too.

    Parameters
    ----------
    terms : sequence of Term
    weights : ndarray, shape (n,)
        Weights of the candidates, 0 to 1; the tangents are taken there.
    number : int
        Number of candidates to choose.
    width : int
        Number of neighboring candidates in a window; every choice within a window is tried.
    """
    n = len(weights)
    values, slopes = np.zeros((n - width + 1, 2**width)), np.zeros(n)
    for term in terms:
        here = term.slopes(weights)
        steepness = np.convolve(here, np.ones(width), mode="valid")
        # Windows of a symmetric frame can have equal slopes: take the first one, so that rounding does not decide.
        first = int(np.argmax(steepness <= steepness.min() * (1 - 1e-9)))
        outside = np.delete(here, np.s_[first : first + width])
        values[first] += within_window(term, weights, number, first, width, outside)
        slopes += here
        slopes[first : first + width] -= here[first : first + width]
    return path(values, slopes, number, np.add)


def least_of_largest(
    problem: Candidates, hardest: Hardest, weights: Floats, number: int, width: int, enough: float
) -> tuple[float, list[int]]:
    """Compute a lower bound, over all choices of `number` candidates, of the largest variance of a mixture.

    Each round takes the choice with the least bound so far and adds mixtures with large variances at this choice, each
    in a window.

    Parameters
    ----------
    problem : Candidates
    hardest : callable
        Function that returns the largest variance of a covariance, and its mixture.
    weights, number, width
        As in `least_of_sum`.
    enough : float
        The search ends at this bound.

    Returns
    -------
    least : float
    chosen : list of int
    """
    n = problem.count
    count = n - width + 1
    values = np.zeros((count, 2**width))
    added: set[tuple[int, bytes]] = set()
    for _ in range(MIXTURE_ROUNDS):
        least, chosen = path(values, np.zeros(n), number, np.maximum)
        if least >= enough:
            break
        # The choice within each window, and the weights outside.
        near = np.abs(np.arange(n) - np.arange(count)[:, None] - (width - 1) / 2) < width / 2
        mixed = np.where(near, np.isin(np.arange(n), chosen), weights)
        largest, mixtures = hardest(problem.covariance(problem.own(problem.information(mixed))))
        new = [place for place in np.argsort(-largest) if (place, mixtures[place].tobytes()) not in added]
        if not new:
            break
        for place in new[:A_ROUND]:
            added.add((place, mixtures[place].tobytes()))
            flat = np.zeros(n - width)
            parts = (
                within_window(term, weights, number, int(place), width, flat)
                for term in variance(problem, mixtures[place])
            )
            values[place] = np.maximum(values[place], sum(parts))
    return path(values, np.zeros(n), number, np.maximum)


def within_window(term: Term, weights: Floats, number: int, first: int, width: int, slopes: Floats) -> Floats:
    """Compute the minimum of a term minus the slopes' part, for each choice within a window; infinite if infeasible.

    Parameters
    ----------
    term : Term
    weights : ndarray, shape (n,)
    number : int
    first : int
        First candidate of the window.
    width : int
    slopes : ndarray, shape (n - width,)
        Slopes of the candidates outside the window.

    Returns
    -------
    ndarray, shape (2^width,)
    """
    _, d, p = term.rows.shape
    window = np.s_[first : first + width]
    bare = weights.copy()
    bare[window] = 0.0
    covariance = np.asarray(np.linalg.inv(term.information(bare)), dtype=np.float64)
    near, far = term.rows[window].reshape(-1, p), np.delete(term.rows, window, axis=0).reshape(-1, p)
    value, with_v = _every_choice(term.v, near, far, covariance, width)
    outside, left = np.delete(weights, window), number - patterns(width).sum(axis=1)
    steep = -np.sum(with_v.reshape(len(value), len(outside), d) ** 2, axis=2)
    if term.logarithm:
        value, steep = np.log(value), steep / value[:, None]
    value, steep = term.weight * value, term.weight * steep
    # Minimum of (steep - slopes)'w over choices of the other candidates: the sum of the lowest entries.
    lowest = np.zeros((len(value), len(outside) + 1))
    np.cumsum(np.sort(steep - slopes, axis=1), axis=1, out=lowest[:, 1:])
    rest = np.clip(left, 0, len(outside))
    least = value - steep @ outside + lowest[np.arange(len(value)), rest]
    return np.asarray(np.where(rest == left, least, np.inf))


def _every_choice(v: Floats, near: Floats, far: Floats, covariance: Floats, width: int) -> tuple[Floats, Floats]:
    """Compute v' C v and far C v for every choice within a window, by adding one candidate after the other.

    A candidate that is added changes C to C - C J' (1 + J C J')^-1 J C; only the required parts are computed.

    Parameters
    ----------
    v : ndarray, shape (p,)
    near, far : ndarray, shapes (width d, p) and (f, p)
        Rows of the window's candidates and of the others.
    covariance : ndarray, shape (p, p)
        Covariance without the window's candidates.
    width : int

    Returns
    -------
    value : ndarray, shape (2^width,)
    with_v : ndarray, shape (2^width, f)
    """
    d = len(near) // width
    rows = np.concatenate([near, far])
    # Rows of the window's remaining candidates, then rows of the others.
    value, with_v = (v @ covariance @ v)[None], (rows @ covariance @ v)[None]
    between = (rows @ covariance @ near.T)[None]
    for _ in range(width):
        own, seen = between[:, :d, :d], between[:, d:, :d]
        gain = np.linalg.solve(np.eye(d) + own, np.concatenate([with_v[:, :d, None], between[:, :d, d:]], axis=2))
        taken = value - np.einsum("ki,ki->k", with_v[:, :d], gain[:, :, 0])
        value = np.concatenate([value, taken])
        with_v = np.concatenate([with_v[:, d:], with_v[:, d:] - (seen @ gain[:, :, :1])[:, :, 0]])
        between = np.concatenate([between[:, d:, d:], between[:, d:, d:] - seen @ gain[:, :, 1:]])
    return value, with_v


def patterns(width: int) -> Ints:
    """List every choice within a window, shape (2^width, width): bit b of a choice's index is candidate b."""
    return np.asarray((np.arange(2**width)[:, None] >> np.arange(width)) & 1)


def path(values: Floats, slopes: Floats, number: int, together: np.ufunc) -> tuple[float, list[int]]:
    """Minimize the windows' values plus the chosen candidates' slopes; return the minimum and the choice.

    Parameters
    ----------
    values : ndarray, shape (n - width + 1, 2^width)
        Value of each window, for each choice within the window.
    slopes : ndarray, shape (n,)
    number : int
        Number of chosen candidates.
    together : ufunc
        `np.add` for the sum of the windows' values, `np.maximum` for their maximum.
    """
    every = values.shape[1]
    half, width = every // 2, every.bit_length() - 1
    within = patterns(width)
    counts = within.sum(axis=1)
    cost = np.full((every, number + 1), np.inf)
    few = np.flatnonzero(counts <= number)
    cost[few, counts[few]] = (values[0] + within @ slopes[:width])[few]
    gone = []
    for first in range(1, len(values)):
        # The lowest candidate leaves the window: keep the better of its two states. A new one enters at the top.
        without, with_it = cost[0::2], cost[1::2]
        gone.append(with_it < without)
        kept = np.minimum(without, with_it)
        cost = np.full((every, number + 1), np.inf)
        cost[:half] = kept
        cost[half:, 1:] = kept[:, :-1] + slopes[first + width - 1]
        cost = together(cost, values[first][:, None])
    state = int(np.argmin(cost[:, number]))
    return float(cost[state, number]), _traced(state, number, gone, width)


def _traced(state: int, number: int, gone: Sequence[Bools], width: int) -> list[int]:
    """Return the candidates of the path that ends in this state of the last window, ascending."""
    last = len(gone)
    chosen = [last + bit for bit in range(width) if state >> bit & 1]
    for first in range(last - 1, -1, -1):
        entered, before = state >> (width - 1), state & (2 ** (width - 1) - 1)
        number -= entered
        leaves = int(gone[first][before, number])
        if leaves:
            chosen.append(first)
        state = before << 1 | leaves
    return sorted(chosen)
