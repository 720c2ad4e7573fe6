"""A bound that sees whole sensors: near each parameter every choice of floors is looked at, far from it weights do.

Weights overrate few sensors: half a sensor on every floor sees every story a little, a whole one on every other floor
does not. But the floors near a story determine its stiffness. Let phi be a variance, or the logarithm of one, convex in
the weights; T a window of neighbouring floors; pi the choice within it; v the weights at which the tangent is taken.
For every choice w that is pi in T,

    phi(w) >= phi(pi, v) + sum over k outside T of (d phi / d w_k)(pi, v) (w_k - v_k).

With slopes b_k in place of those that depend on pi, and the least that the difference can be over all choices of the
rest put into the constant, this is a number for each pi and one for each floor outside. What so many sensors make least
of a sum of such terms, or of the largest of them, is found exactly along the floors (`path`). Windows of no floor
would give the tangent bound of the convex program back, and a window of all floors looks at every choice.

Criteria are made of such phi (`Term`), each of them determined by few floors. The trace of the covariance is one
already. Its volume is one by the chain rule: the logarithms of the variances of x_i with x_1, ..., x_(i-1) known add up
to log det C. Known parameters are struck from the information, and the information of one parameter with the rest
marginalised is concave in the whole information, so each of these logarithms is convex.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.planning.candidates import Candidates
from cvxshear.util.typing import Bools, Floats, Ints

MIXTURE_ROUNDS = 60
"""Rounds at most in which mixtures are added that bound the best choice so far; most bounds end before."""

A_ROUND = 4
"""Windows in which a mixture is added in each round."""

Hardest = Callable[[Floats], tuple[Floats, Floats]]
"""From covariances, shape (..., s, s): the criterion's variance, (...), and its mixture of the parameters, (..., s)."""


@dataclass(frozen=True, eq=False)
class Term:
    """v' C(w) v, or its logarithm, C(w) the inverse of an information that the weights add up to.

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
    """Return the variance of a mixture of the parameters asked for: a term a frame, whose sum is the mean.

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
    """Terms, and a number to add, whose sum is the mean over the frames of log det of the covariance of z_a.

    Parameters
    ----------
    problem : Candidates
    weights : ndarray, shape (n,)
        At which it is seen which candidates tell of which parameter: parameters are taken along the candidates.
    """
    a, share = problem.asked.shape[-1], 1.0 / len(problem.base)
    terms, constant = [], 0.0
    every = zip(problem.base, problem.rows, problem.asked, problem.information(weights), strict=True)
    for base, rows, asked, information in every:
        # As many of the parameters asked for as there are coordinates, where an equality ties some to the others.
        picked = np.sort(linalg.qr(asked.T, mode="r", pivoting=True)[1][:a])
        # Where each parameter is measured best: the mean place weighed with the slopes of its variance.
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
    """Bound the sum of terms from below for any choice of so many candidates; return the choice at the bound, too.

    Parameters
    ----------
    terms : sequence of Term
    weights : ndarray, shape (n,)
        Of the candidates, 0 to 1: where tangents are taken.
    number : int
        How many are to be chosen.
    width : int
        Neighbouring candidates of which every choice is looked at.
    """
    n = len(weights)
    values, slopes = np.zeros((n - width + 1, 2**width)), np.zeros(n)
    for term in terms:
        here = term.slopes(weights)
        steepness = np.convolve(here, np.ones(width), mode="valid")
        # Of windows that tell the same, as in a symmetric frame, the first: rounding is not to decide.
        first = int(np.argmax(steepness <= steepness.min() * (1 - 1e-9)))
        outside = np.delete(here, np.s_[first : first + width])
        values[first] += within_window(term, weights, number, first, width, outside)
        slopes += here
        slopes[first : first + width] -= here[first : first + width]
    return path(values, slopes, number, np.add)


def least_of_largest(
    problem: Candidates, hardest: Hardest, weights: Floats, number: int, width: int, enough: float
) -> tuple[float, list[int]]:
    """Bound the largest variance of a mixture of the parameters from below for any choice of so many candidates.

    Mixtures that bound the choice that is best as far as is known are added in turn, each in a window.

    Parameters
    ----------
    problem : Candidates
    hardest : callable
        The largest variance of a covariance, and its mixture.
    weights, number, width
        As in `least_of_sum`.
    enough : float
        The bound at which looking ends.

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
        # The choice within each window, the weights outside of it.
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
    """For each choice within a window, what a term is at least beyond the slopes' part; infinite where it is none.

    Parameters
    ----------
    term : Term
    weights : ndarray, shape (n,)
    number : int
    first : int
        Candidate of the window.
    width : int
    slopes : ndarray, shape (n - width,)
        Of the candidates outside.

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
    # The least of (steep - slopes)'w over choices of the rest: the lowest, as many as are left.
    lowest = np.zeros((len(value), len(outside) + 1))
    np.cumsum(np.sort(steep - slopes, axis=1), axis=1, out=lowest[:, 1:])
    rest = np.clip(left, 0, len(outside))
    least = value - steep @ outside + lowest[np.arange(len(value)), rest]
    return np.asarray(np.where(rest == left, least, np.inf))


def _every_choice(v: Floats, near: Floats, far: Floats, covariance: Floats, width: int) -> tuple[Floats, Floats]:
    """v' C v and far C v for every choice within a window, one candidate after the other taken in or left out.

    C - C J' (1 + J C J')^-1 J C for each that is taken in, of what is needed later alone.

    Parameters
    ----------
    v : ndarray, shape (p,)
    near, far : ndarray, shapes (width d, p) and (f, p)
        Rows of the window's candidates and of the others.
    covariance : ndarray, shape (p, p)
        Without the window's.
    width : int

    Returns
    -------
    value : ndarray, shape (2^width,)
    with_v : ndarray, shape (2^width, f)
    """
    d = len(near) // width
    rows = np.concatenate([near, far])
    # A row each for the window's candidates that are still to come, then for the others.
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
    """Every choice within a window, shape (2^width, width): bit b of a choice's place is candidate b."""
    return np.asarray((np.arange(2**width)[:, None] >> np.arange(width)) & 1)


def path(values: Floats, slopes: Floats, number: int, together: np.ufunc) -> tuple[float, list[int]]:
    """Find the least that the windows' values and the chosen candidates' slopes can make together, and where.

    Parameters
    ----------
    values : ndarray, shape (n - width + 1, 2^width)
        Of each window, for each choice within it.
    slopes : ndarray, shape (n,)
    number : int
        Candidates that are chosen.
    together : ufunc
        `np.add` for the sum of the windows' values, `np.maximum` for the largest of them.
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
        # The lowest candidate leaves the window, of whose two states the better is kept; a new one enters at the top.
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
    """Return the candidates of the path that ends in a state of the last window, ascending."""
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
