"""Whether exact statements can all be true at once and, where not, a smallest set that cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from cvxshear.priors import Constraints
from cvxshear.util.errors import InfeasibleError, InputError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class NamedConstraints:
    """Exact statements about one vector, and their name for a message."""

    name: str
    constraints: Constraints


def _stacked(parts: Sequence[NamedConstraints], size: int) -> tuple[Floats, Floats, Floats, Floats]:
    """G, h, A, b of all the statements, bounds as rows of G."""
    eye = np.eye(size)
    G, h, A, b = [np.zeros((0, size))], [np.zeros(0)], [np.zeros((0, size))], [np.zeros(0)]
    for part in parts:
        said = part.constraints
        if said.G is not None and said.h is not None:
            G.append(said.G)
            h.append(said.h)
        if said.A is not None and said.b is not None:
            A.append(said.A)
            b.append(said.b)
        for bound, sign in ((said.lower, -1.0), (said.upper, 1.0)):
            if bound is not None:
                finite = np.isfinite(bound)
                G.append(sign * eye[finite])
                h.append(sign * bound[finite])
    return *_scaled(np.concatenate(G), np.concatenate(h)), *_scaled(np.concatenate(A), np.concatenate(b))


def _scaled(rows: Floats, sides: Floats) -> tuple[Floats, Floats]:
    """The rows with a largest coefficient of 1 each: HiGHS judges by absolute tolerances and drops tiny ones."""
    largest = np.max(np.abs(rows), axis=1, initial=0.0)
    largest[largest == 0] = 1.0
    return rows / largest[:, None], sides / largest


def _refuse_malformed(part: NamedConstraints, size: int) -> None:
    """Raise where a statement, perhaps from a prior of the caller's own, is not about a vector of that size."""
    said = part.constraints
    for name in ("lower", "upper", "G", "h", "A", "b"):
        value = getattr(said, name)
        if value is None:
            continue
        shape = np.shape(value)
        if name not in {"h", "b"} and shape[-1:] != (size,):
            raise InputError(f"{part.name}: its {name} has the shape {shape}, where the last length must be {size}")
        wrong = np.isnan(value) if name in {"lower", "upper"} else ~np.isfinite(value)
        if wrong.any():
            raise InputError(f"{part.name}: its {name} must hold finite numbers, not {np.asarray(value)[wrong][0]}")


def feasible(parts: Sequence[NamedConstraints], size: int) -> bool:
    """Whether some vector keeps every statement."""
    G, h, A, b = _stacked(parts, size)
    scale = max(1e-300, float(np.max(np.abs(np.concatenate([h, b])), initial=0.0)))
    found = linprog(
        np.zeros(size),
        A_ub=G if len(G) else None,
        b_ub=h / scale if len(G) else None,
        A_eq=A if len(A) else None,
        b_eq=b / scale if len(A) else None,
        bounds=(None, None),
        method="highs",
    )
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
        _refuse_malformed(part, size)
    if _plainly_feasible(parts, size) or feasible(parts, size):
        return
    core = list(parts)
    for part in parts:
        without = [other for other in core if other is not part]
        if without and not feasible(without, size):
            core = without
    raise InfeasibleError("these cannot all be true: " + "; ".join(part.name for part in core))
