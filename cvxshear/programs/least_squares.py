"""The one form of every program that a backend sees."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cvxshear.util.typing import Floats

NO_DIFFERENCE = 1e-13
"""Relative size of a difference that counts as none."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """minimize |W (R x - s)|^2 subject to G x <= h, A x = b, lower <= x <= upper.

    Parameters
    ----------
    R, s : ndarray, shapes (r, n) and (r,)
        The rows, not their normal matrix, whose condition number would be the square.
    W : ndarray, shape (r,), optional
        Weights, the diagonal of W; ones where not given.
    A, b : ndarray, shapes (a, n) and (a,), optional
    G, h : ndarray, shapes (g, n) and (g,), optional
    lower, upper : ndarray, shape (n,), optional
        Infinite where there is no bound.
    names : tuple of str, optional
        What each of the n unknowns is called in messages.
    """

    R: Floats
    s: Floats
    W: Floats | None = None
    A: Floats | None = None
    b: Floats | None = None
    G: Floats | None = None
    h: Floats | None = None
    lower: Floats | None = None
    upper: Floats | None = None
    names: tuple[str, ...] = ()

    @property
    def unknowns(self) -> int:
        """Number of unknowns n."""
        return int(self.R.shape[1])

    @property
    def weighted(self) -> tuple[Floats, Floats]:
        """W R and W s."""
        if self.W is None:
            return self.R, self.s
        return self.W[:, None] * self.R, self.W * self.s

    @property
    def equalities(self) -> tuple[Floats, Floats]:
        """A and b, of no rows where there are none."""
        if self.A is None or self.b is None:
            return np.zeros((0, self.unknowns)), np.zeros(0)
        return self.A, self.b

    @property
    def inequalities(self) -> tuple[Floats, Floats]:
        """G and h with the finite bounds as further rows: first G, then lower, then upper bounds."""
        rows, sides = [np.zeros((0, self.unknowns))], [np.zeros(0)]
        if self.G is not None and self.h is not None:
            rows.append(self.G)
            sides.append(self.h)
        for bound, sign in ((self.lower, -1.0), (self.upper, 1.0)):
            if bound is not None:
                finite = np.isfinite(bound)
                rows.append(sign * np.eye(self.unknowns)[finite])
                sides.append(sign * bound[finite])
        return np.concatenate(rows), np.concatenate(sides)

    def replace(self, **changes: object) -> LeastSquares:
        """Return a copy with some parts replaced."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]  # fields of this class, of the types that it says


def remaining(side: Floats, rows: Floats, origin: Floats) -> Floats:
    """side - rows @ origin, zero where it is nothing but rounding.

    Two ways of saying the same (a total, and all the floor masses) would otherwise contradict each other in
    their last digits once a step is as small as those.
    """
    result = side - rows @ origin
    rounding = NO_DIFFERENCE * (np.abs(side) + np.abs(rows) @ np.abs(origin))
    return np.where(np.abs(result) <= rounding, 0.0, result)
