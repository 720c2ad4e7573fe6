"""Sort and choose independently of rounding, and weigh hypotheses.

Kernels of different processors round differently. Two entries that are equal in exact arithmetic differ by some units
in the last place, and a plain sort or argmax would follow these units. Numbers that differ only by rounding keep their
order here.

Of hypotheses that exclude each other and of which one is true, hypothesis i has the probability (Bayes)

    p_i = L_i q_i / sum over j of L_j q_j,

L the likelihood of the data and q the prior probability. A conclusion is certain at `cvxshear.util.quantities.SURE`.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from cvxshear.util.typing import Floats, Ints

Item = TypeVar("Item")

#: Largest relative difference of two equal numbers: rounding destroys half of the digits at most.
SAME_NUMBER = float(np.sqrt(np.finfo(np.float64).eps))

#: Largest difference of the log evidence of two equal models: fits stop at about this distance from the optimum.
SAME_ODDS = 1e-4


def order(values: ArrayLike, *, same: float | None = None) -> list[int]:
    """Order positions by their values, the largest first, and equal values by position.

    Parameters
    ----------
    values : array_like, shape (n,)
        Nan comes last.
    same : float, optional
        Largest absolute difference of two equal values. Default: `SAME_NUMBER` of the larger one.
    """
    found = np.asarray(values, dtype=np.float64)
    result: list[int] = []
    group: list[int] = []
    for at in np.argsort(-found, kind="stable").tolist():
        if group and not _equal(float(found[group[0]]), float(found[at]), same):
            result += sorted(group)
            group = []
        group.append(at)
    return result + sorted(group)


def largest(values: ArrayLike, axis: int = -1) -> Ints:
    """Find the first position of the largest value along an axis; values that differ only by rounding are equal.

    Parameters
    ----------
    values : array_like
    axis : int, optional

    Returns
    -------
    ndarray of int
        Shape of `values` without the axis.
    """
    found = np.asarray(values, dtype=np.float64)
    most = np.max(found, axis=axis, keepdims=True)
    finite = np.where(np.isfinite(most), np.abs(most), 0.0)
    return np.asarray(np.argmax(found >= most - SAME_NUMBER * finite, axis=axis))


def first_largest(values: ArrayLike) -> int:
    """Find the first position of the largest of a vector; see `largest`."""
    return int(largest(values))


def ranked(items: Iterable[Item], value: Callable[[Item], float], *, same: float | None = None) -> list[Item]:
    """Sort items by a value, the largest first; items of equal value keep their order.

    Parameters
    ----------
    items : iterable
    value : callable
    same : float, optional
        As for `order`.
    """
    known: Sequence[Item] = list(items)
    return [known[at] for at in order([value(each) for each in known], same=same)]


def weigh(log_likelihoods: ArrayLike, log_priors: ArrayLike = 0.0) -> Floats:
    """Return the probability of each hypothesis; they add up to 1 along the last axis.

    Parameters
    ----------
    log_likelihoods, log_priors : array_like, shape (..., n)
        Each up to a constant. A hypothesis of log likelihood -inf is impossible; one at least must be possible.

    Returns
    -------
    ndarray, shape (..., n)
    """
    scores = np.asarray(log_likelihoods, dtype=np.float64) + np.asarray(log_priors, dtype=np.float64)
    weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


def _equal(larger: float, smaller: float, same: float | None) -> bool:
    within = SAME_NUMBER * abs(larger) if same is None else same
    return larger == smaller or bool(np.isfinite(larger) and larger - smaller <= within)
