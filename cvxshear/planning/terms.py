"""Criteria as sums of terms that are convex in the shares, each of them told by few floors.

The trace of the covariance is one already. Its volume is one by the chain rule: the logarithms of the variances of x_i
with x_1, ..., x_(i-1) known add up to log det C. Known parameters are struck from the information, and the information
of one parameter with the rest marginalised is concave in the whole information, so each of these logarithms is convex.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.planning.candidates import Candidates
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Term:
    """v' C(w) v, or its logarithm, C(w) the inverse of an information that the shares add up to.

    Parameters
    ----------
    base : ndarray, shape (p, p)
        Information without any candidate.
    rows : ndarray, shape (n, d, p)
        J_j of each candidate.
    v : ndarray, shape (p,)
    logarithm : bool
    """

    base: Floats
    rows: Floats
    v: Floats
    logarithm: bool = False

    def information(self, shares: Floats) -> Floats:
        """The information, shape (p, p), at shares of shape (n,)."""
        weighed = (self.rows * np.sqrt(shares)[:, None, None]).reshape(-1, len(self.v))
        result: Floats = self.base + weighed.T @ weighed
        return result

    def slopes(self, shares: Floats) -> Floats:
        """Derivatives by the shares, shape (n,)."""
        seen = np.linalg.solve(self.information(shares), self.v)
        steep: Floats = -np.sum((self.rows @ seen) ** 2, axis=1)
        return steep / float(self.v @ seen) if self.logarithm else steep


def variance(of: Candidates, mixture: Floats) -> Term:
    """The variance of a mixture of the parameters asked for.

    Parameters
    ----------
    of : Candidates
    mixture : ndarray, shape (s,)
    """
    v = np.zeros(len(of.base))
    v[: of.asked.shape[1]] = of.asked.T @ mixture
    return Term(of.base, of.rows, v)


def of_volume(of: Candidates, shares: Floats) -> tuple[list[Term], float]:
    """Terms, and a number to add, whose sum is log det of the covariance of z_a.

    Parameters
    ----------
    of : Candidates
    shares : ndarray, shape (n,)
        At which it is seen which candidates tell of which parameter: parameters are taken along the candidates.
    """
    a = of.asked.shape[1]
    # As many of the parameters asked for as there are coordinates, where an equality ties some to the others.
    picked = np.sort(linalg.qr(of.asked.T, mode="r", pivoting=True)[1][:a])
    picked = picked[np.argsort(_places(of, of.asked[picked], shares), kind="stable")]
    square = of.asked[picked]
    turn = linalg.block_diag(np.linalg.inv(square), np.eye(len(of.base) - a))
    turned = Candidates(turn.T @ of.base @ turn, of.rows @ turn, np.eye(a))
    return list(_chain(turned)), -2.0 * float(np.linalg.slogdet(square)[1])


def _places(of: Candidates, asked: Floats, shares: Floats) -> Floats:
    """Where among the candidates each parameter is told, the mean place weighed with the slopes of its variance."""
    columns = np.linalg.inv(of.information(shares))[:, : of.asked.shape[1]] @ asked.T
    told = np.sum((of.rows @ columns) ** 2, axis=1)
    result: Floats = np.arange(of.count) @ told / told.sum(axis=0)
    return result


def _chain(of: Candidates) -> Iterator[Term]:
    """The variances of the coordinates asked for, each with those before it known."""
    for first in range(of.asked.shape[1]):
        v = np.eye(1, len(of.base) - first)[0]
        yield Term(of.base[first:, first:], of.rows[:, :, first:], v, logarithm=True)
