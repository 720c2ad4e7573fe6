"""Least-squares programs: what they are, and those of masses, stiffnesses and steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog

from cvxshear.measurement.experiment import Frame
from cvxshear.priors import Constraints, Prior
from cvxshear.util.errors import InfeasibleError
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
        return self.inequalities_in(None)

    def inequalities_in(self, basis: Floats | None) -> tuple[Floats, Floats]:
        """Convert the rows and sides of `inequalities` to those for z in x = basis @ z: a bound picks a row of it."""
        units = np.eye(self.unknowns) if basis is None else basis
        rows, sides = [np.zeros((0, self.unknowns))], [np.zeros(0)]
        if self.G is not None and self.h is not None and len(self.G):
            rows.append(self.G if basis is None else self.G @ basis)
            sides.append(self.h)
        for bound, sign in ((self.lower, -1.0), (self.upper, 1.0)):
            if bound is not None:
                finite = np.isfinite(bound)
                rows.append(sign * units[finite])
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


@dataclass(frozen=True, eq=False)
class NamedConstraints:
    """Exact statements about one vector, and their name for a message."""

    name: str
    constraints: Constraints


def statements(
    priors: Sequence[Prior], quantity: str, stories: int, frame: Frame | None = None, least: float = 0.0
) -> list[NamedConstraints]:
    """Collect the exact statements about one quantity: positivity, what the frame declares, and the priors.

    Parameters
    ----------
    priors : sequence of Prior
    quantity : str
        "floor_mass" (without added mass) or "story_stiffness".
    stories : int
    frame : Frame, optional
        For floor masses: whose declared total or floor masses hold.
    least : float, optional
        What counts as positive, kg or N/m: a mass or stiffness of zero has no modes.
    """
    result = [NamedConstraints(f"{quantity} is positive", Constraints(lower=np.full(stories, least)))]
    if quantity == "floor_mass" and frame is not None:
        if frame.floor_masses is not None:
            result.append(NamedConstraints("floor_masses", Constraints(A=np.eye(stories), b=frame.floor_masses)))
        elif frame.total_mass is not None:
            known = Constraints(A=np.ones((1, stories)), b=np.array([frame.total_mass]))
            result.append(NamedConstraints(f"total_mass = {frame.total_mass:g} kg", known))
    return result + [
        NamedConstraints(f"prior: {prior.describe()}", prior.constraints(stories))
        for prior in priors
        if prior.quantity == quantity
    ]


def constrained(program: LeastSquares, parts: Sequence[NamedConstraints], origin: Floats) -> LeastSquares:
    """Constrain a program, whose unknown x is a change of a quantity from `origin`, by the statements.

    Parameters
    ----------
    program : LeastSquares
        With equalities of its own or none, and without inequalities and bounds.
    parts : sequence of NamedConstraints
        About origin + x.
    origin : ndarray, shape (n,)
    """
    A, b = ([each] for each in program.equalities)
    G, h = [np.zeros((0, program.unknowns))], [np.zeros(0)]
    lower, upper = np.full(program.unknowns, -np.inf), np.full(program.unknowns, np.inf)
    for part in parts:
        said = part.constraints
        if said.G is not None and said.h is not None:
            G.append(said.G)
            h.append(remaining(said.h, said.G, origin))
        if said.A is not None and said.b is not None:
            A.append(said.A)
            b.append(remaining(said.b, said.A, origin))
        if said.lower is not None:
            lower = np.maximum(lower, said.lower - origin)
        if said.upper is not None:
            upper = np.minimum(upper, said.upper - origin)
    return program.replace(
        G=np.concatenate(G), h=np.concatenate(h), A=np.concatenate(A), b=np.concatenate(b), lower=lower, upper=upper
    )


def softened(
    program: LeastSquares, priors: Sequence[Prior], quantity: str, at: Floats, row_std: float, *, step: bool
) -> LeastSquares:
    """Add the soft priors as further rows, linearised at the values `at`.

    Parameters
    ----------
    program : LeastSquares
        Its unknown is the quantity itself or, with `step`, its change from `at`.
    priors : sequence of Prior
    quantity : str
    at : ndarray, shape (n,)
    row_std : float
        Standard deviation of the program's own rows, against which the soft priors weigh.
    step : bool
    """
    soft = [prior.residual(at) for prior in priors if prior.quantity == quantity]
    r = np.concatenate([np.zeros(0), *(part[0] for part in soft)])
    if not r.size:
        return program
    J = np.concatenate([part[1] for part in soft])
    R, s = program.weighted
    return program.replace(
        R=np.concatenate([R / row_std, J]), s=np.concatenate([s / row_std, -r if step else J @ at - r]), W=None
    )


def _scaled(rows: Floats, sides: Floats) -> tuple[Floats, Floats]:
    """Scale each row to a largest coefficient of 1: HiGHS judges by absolute tolerances and drops tiny ones."""
    largest = np.max(np.abs(rows), axis=1, initial=0.0)
    largest[largest == 0] = 1.0
    return rows / largest[:, None], sides / largest


def feasible(parts: Sequence[NamedConstraints], size: int) -> bool:
    """Whether some vector keeps every statement."""
    together = constrained(LeastSquares(np.zeros((0, size)), np.zeros(0)), parts, np.zeros(size))
    (G, h), (A, b) = _scaled(*together.inequalities), _scaled(*together.equalities)
    scale = max(1e-300, float(np.max(np.abs(np.concatenate([h, b])), initial=0.0)))
    said: dict[str, Any] = {"A_ub": G, "b_ub": h / scale} if len(G) else {}
    said |= {"A_eq": A, "b_eq": b / scale} if len(A) else {}
    found = linprog(np.zeros(size), **said, bounds=(None, None), method="highs")
    return bool(found.status != 2)


def _plainly_feasible(parts: Sequence[NamedConstraints], size: int) -> bool:
    """Whether the statements are lower bounds and at most one weighted sum that is greater than theirs.

    Then a point that keeps them all is at hand, and no linear program need be solved.
    """
    lower = np.full(size, -np.inf)
    sums: list[tuple[Floats, float]] = []
    for part in parts:
        said = part.constraints
        if said.upper is not None or said.G is not None:
            return False
        if said.lower is not None:
            lower = np.maximum(lower, said.lower)
        if said.A is not None and said.b is not None:
            sums += [(row, float(side)) for row, side in zip(said.A[:2], said.b[:2], strict=True)]
        if len(sums) > 1:
            return False
    if not sums:
        return True
    row, side = sums[0]
    return bool(np.all(row > 0) and np.all(np.isfinite(lower)) and row @ lower < side)


def refuse_contradictions(parts: Sequence[NamedConstraints], size: int) -> None:
    """Raise where the statements cannot all be true.

    A statement that the others contradict without each other's help is kept, the rest are dropped one by
    one (the deletion filter of Chinneck and Dravnieks, 1991), so that the message names a smallest set.

    Raises
    ------
    InfeasibleError
        Naming the statements that contradict each other.
    InputError
        Where a statement is not about a vector of `size` numbers.
    """
    for part in parts:
        part.constraints.check(size, part.name)
    if _plainly_feasible(parts, size) or feasible(parts, size):
        return
    core = list(parts)
    for part in parts:
        without = [other for other in core if other is not part]
        if without and not feasible(without, size):
            core = without
    raise InfeasibleError("these cannot all be true: " + "; ".join(part.name for part in core))
