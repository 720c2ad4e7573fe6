"""A bound that sees whole sensors: near each parameter every choice of floors is looked at, far from it shares suffice.

Shares overrate few sensors: half a sensor on every floor sees every story a little, a whole one on every other floor
does not. But a story's stiffness is told by the floors near it. Let phi be a variance, or the logarithm of one,
convex in the shares; T a window of neighbouring floors; pi the choice within it; v the shares at which the tangent is
taken. For every choice w that is pi in T,

    phi(w) >= phi(pi, v) + sum over k outside T of (d phi / d w_k)(pi, v) (w_k - v_k).

With slopes b_k in place of those that depend on pi, and the least that the difference can be over all choices of the
rest put into the constant, this is a number for each pi and one for each floor outside. What so many sensors make least
of a sum of such terms, or of the largest of them, is found exactly along the floors (`path`). Windows of no floor
would give the tangent bound of the convex program back, and a window of all floors looks at every choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cvxshear.planning.candidates import Candidates
from cvxshear.planning.path import least_largest, least_sum, patterns
from cvxshear.planning.terms import Term, variance
from cvxshear.util.typing import Floats

ROUNDS = 60
"""Of looking for what bounds the best choice so far."""

A_ROUND = 4
"""Windows in which a mixture is added in each."""

Hardest = Callable[[Floats], tuple[Floats, Floats]]
"""From covariances, shape (..., s, s): the criterion's variance, (...), and its mixture of the parameters, (..., s)."""


def least_of_sum(terms: Sequence[Term], shares: Floats, number: int, width: int) -> tuple[float, list[int]]:
    """What the sum of terms is at least for any choice of so many candidates, and the choice that it is least for.

    Parameters
    ----------
    terms : sequence of Term
    shares : ndarray, shape (n,)
        Of the candidates, 0 to 1: where tangents are taken.
    number : int
        How many are to be chosen.
    width : int
        Neighbouring candidates of which every choice is looked at.
    """
    n = len(shares)
    values, slopes = np.zeros((n - width + 1, 2**width)), np.zeros(n)
    for term in terms:
        here = term.slopes(shares)
        told = np.convolve(here, np.ones(width), mode="valid")
        # Of windows that tell the same, as in a symmetric frame, the first: rounding is not to decide.
        first = int(np.argmax(told <= told.min() * (1 - 1e-9)))
        outside = np.delete(here, np.s_[first : first + width])
        values[first] += within_window(term, shares, number, first, width, outside)
        slopes += here
        slopes[first : first + width] -= here[first : first + width]
    return least_sum(values, slopes, number)


def least_of_largest(
    of: Candidates, hardest: Hardest, shares: Floats, number: int, width: int, enough: float
) -> tuple[float, list[int]]:
    """What the largest variance of a mixture of the parameters is at least for any choice of so many candidates.

    Mixtures that bound the choice that is best as far as is known are added in turn, each in a window.

    Parameters
    ----------
    of : Candidates
    hardest : callable
        The largest variance of a covariance, and its mixture.
    shares, number, width
        As in `least_of_sum`.
    enough : float
        The bound at which looking ends.

    Returns
    -------
    least : float
    chosen : list of int
    """
    n = of.count
    count = n - width + 1
    values = np.zeros((count, 2**width))
    added: set[tuple[int, bytes]] = set()
    for _ in range(ROUNDS):
        least, chosen = least_largest(values, number)
        if least >= enough:
            break
        # The choice within each window, the shares outside of it.
        near = np.abs(np.arange(n) - np.arange(count)[:, None] - (width - 1) / 2) < width / 2
        mixed = np.where(near, np.isin(np.arange(n), chosen), shares)
        largest, mixtures = hardest(of.covariance(of.own(of.information(mixed))))
        new = [place for place in np.argsort(-largest) if (place, mixtures[place].tobytes()) not in added]
        if not new:
            break
        for place in new[:A_ROUND]:
            added.add((place, mixtures[place].tobytes()))
            found = within_window(variance(of, mixtures[place]), shares, number, place, width, np.zeros(n - width))
            values[place] = np.maximum(values[place], found)
    return least_largest(values, number)


def within_window(term: Term, shares: Floats, number: int, first: int, width: int, slopes: Floats) -> Floats:
    """For each choice within a window, what a term is at least beyond the slopes' part; infinite where it is none.

    Parameters
    ----------
    term : Term
    shares : ndarray, shape (n,)
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
    bare = shares.copy()
    bare[window] = 0.0
    covariance = np.asarray(np.linalg.inv(term.information(bare)), dtype=np.float64)
    near, far = term.rows[window].reshape(-1, p), np.delete(term.rows, window, axis=0).reshape(-1, p)
    value, told = _every_choice(term.v, near, far, covariance, width)
    outside, left = np.delete(shares, window), number - patterns(width).sum(axis=1)
    steep = -np.sum(told.reshape(len(value), len(outside), d) ** 2, axis=2)
    if term.logarithm:
        value, steep = np.log(value), steep / value[:, None]
    # The least of (steep - slopes)'w over choices of the rest: the lowest, as many as are left.
    lowest = np.zeros((len(value), len(outside) + 1))
    np.cumsum(np.sort(steep - slopes, axis=1), axis=1, out=lowest[:, 1:])
    rest = np.clip(left, 0, len(outside))
    least = value - steep @ outside + lowest[np.arange(len(value)), rest]
    result: Floats = np.where(rest == left, least, np.inf)
    return result


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
    told : ndarray, shape (2^width, f)
    """
    d = len(near) // width
    rows = np.concatenate([near, far])
    # A row each for the window's candidates that are still to come, then for the others.
    value, told = (v @ covariance @ v)[None], (rows @ covariance @ v)[None]
    between = (rows @ covariance @ near.T)[None]
    for _ in range(width):
        own, seen = between[:, :d, :d], between[:, d:, :d]
        gain = np.linalg.solve(np.eye(d) + own, np.concatenate([told[:, :d, None], between[:, :d, d:]], axis=2))
        taken = value - np.einsum("ki,ki->k", told[:, :d], gain[:, :, 0])
        value = np.concatenate([value, taken])
        told = np.concatenate([told[:, d:], told[:, d:] - (seen @ gain[:, :, :1])[:, :, 0]])
        between = np.concatenate([between[:, d:, d:], between[:, d:, d:] - seen @ gain[:, :, 1:]])
    return value, told
