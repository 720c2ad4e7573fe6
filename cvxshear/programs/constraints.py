"""Convert exact and soft prior knowledge of a quantity to constraints and rows of a program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linprog

from cvxshear.measurement.experiment import Experiment, Frame
from cvxshear.priors import QUANTITY_UNITS, Constraints, Prior
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.util.errors import InfeasibleError
from cvxshear.util.typing import Floats, Ints

#: Smallest positive mass, relative to the mean floor mass; the smallest positive stiffness carries it at mode 1.
#:
#: Solvers cannot resolve a much smaller bound: HiGHS 1.15 fails at 1e-6.
LEAST_POSITIVE = 1e-3

#: Rounding of a sum, relative to the sizes of its terms.
REMAINDER_ROUNDING = 1e-13


def remaining(side: Floats, rows: Floats, origin: Floats) -> Floats:
    """Compute side - rows @ origin, with zero in place of rounding.

    Otherwise, in a very short step, two statements of the same fact (a total, and all floor masses) contradict each
    other in their last digits.
    """
    result = side - rows @ origin
    rounding = REMAINDER_ROUNDING * (np.abs(side) + np.abs(rows) @ np.abs(origin))
    return np.where(np.abs(result) <= rounding, 0.0, result)


@dataclass(frozen=True, eq=False)
class NamedConstraints:
    """Exact statements about one vector, and their name for messages."""

    name: str
    constraints: Constraints

    def widened(self, at: slice | Ints, size: int) -> NamedConstraints:
        """Write statements about some of the parameters, those at `at`, as statements about all of them."""

        def wide(values: Floats | None, fill: float = 0.0) -> Floats | None:
            if values is None:
                return None
            full = np.full((*values.shape[:-1], size), fill)
            full[..., at] = values
            return full

        said = self.constraints
        lower, upper = wide(said.lower, -np.inf), wide(said.upper, np.inf)
        return NamedConstraints(self.name, Constraints(lower, upper, wide(said.G), said.h, wide(said.A), said.b))


def statements(
    priors: Sequence[Prior], quantity: str, stories: int, frame: Frame | None = None, least: float = 0.0
) -> list[NamedConstraints]:
    """Collect the exact statements about one quantity: positivity, the declarations of the frame, and the priors.

    Parameters
    ----------
    priors : sequence of Prior
    quantity : str
        "floor_mass" (without added mass) or "story_stiffness".
    stories : int
    frame : Frame, optional
        For floor masses: its declared total mass or floor masses hold.
    least : float, optional
        Smallest value that counts as positive, kg or N/m: a frame without mass or stiffness has no modes.
    """
    positive = f"{quantity} is at least {least:.3g} {QUANTITY_UNITS[quantity]}" if least else f"{quantity} is positive"
    result = [NamedConstraints(positive, Constraints(lower=np.full(stories, least)))]
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


def exact_frame(frame: Frame, *, total_released: bool = False) -> Frame:
    """Return the frame without its total mass, if that is uncertain or released by an effect."""
    uncertain = total_released or frame.total_mass_std is not None
    if frame.floor_masses is None and frame.total_mass is not None and uncertain:
        return replace(frame, total_mass=None, total_mass_std=None, total_mass_placeholder=False)
    return frame


def constrained(program: LeastSquares, parts: Sequence[NamedConstraints], origin: Floats) -> LeastSquares:
    """Constrain a program with unknown x, a change of a quantity from `origin`, by exact statements.

    Parameters
    ----------
    program : LeastSquares
        It may have equalities, but no inequalities and bounds.
    parts : sequence of NamedConstraints
        About origin + x.
    origin : ndarray, shape (n,)
    """
    n = program.unknowns
    A, b = program.equalities
    rows = {"A": [A], "G": [np.zeros((0, n))]}
    sides = {"A": [b], "G": [np.zeros(0)]}
    bounds = {"lower": np.full(n, -np.inf), "upper": np.full(n, np.inf)}
    sources: dict[str, list[str]] = {
        "A": list(program.sources.get("A", ("",) * len(b))), "G": [], "lower": [""] * n, "upper": [""] * n,
    }  # fmt: skip
    for part in parts:
        stated = part.constraints
        for key, matrix, side in (("A", stated.A, stated.b), ("G", stated.G, stated.h)):
            if matrix is not None and side is not None:
                rows[key].append(matrix)
                sides[key].append(remaining(side, matrix, origin))
                sources[key] += [part.name] * len(side)
        for key, bound, tighter in (("lower", stated.lower, np.greater), ("upper", stated.upper, np.less)):
            if bound is not None:
                for place in np.flatnonzero(tighter(bound - origin, bounds[key])):
                    bounds[key][place] = bound[place] - origin[place]
                    sources[key][place] = part.name
    return program.replace(
        A=np.concatenate(rows["A"]), b=np.concatenate(sides["A"]), G=np.concatenate(rows["G"]),
        h=np.concatenate(sides["G"]), **bounds, sources={name: tuple(each) for name, each in sources.items()},
    )  # fmt: skip


def softened(
    program: LeastSquares, priors: Sequence[Prior], quantity: str, at: Floats, row_std: float, *, step: bool
) -> LeastSquares:
    """Add the soft priors as further rows, linearized at the values `at`.

    Parameters
    ----------
    program : LeastSquares
        Its unknown is the quantity itself or, with `step`, its change from `at`.
    priors : sequence of Prior
    quantity : str
    at : ndarray, shape (n,)
    row_std : float
        Standard deviation of the program's own rows, which weighs the soft priors.
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
    """Scale each row to a largest coefficient of 1: HiGHS has absolute tolerances and drops tiny coefficients."""
    largest = np.max(np.abs(rows), axis=1, initial=0.0)
    largest[largest == 0] = 1.0
    return rows / largest[:, None], sides / largest


def feasible(parts: Sequence[NamedConstraints], size: int) -> bool:
    """Return whether some vector satisfies every statement."""
    together = constrained(LeastSquares(np.zeros((0, size)), np.zeros(0)), parts, np.zeros(size))
    (G, h), (A, b) = _scaled(*together.inequalities), _scaled(*together.equalities)
    # The shortest vector with the equalities often satisfies the inequalities, too; a linear program takes far longer.
    shortest = np.linalg.lstsq(A, b, rcond=None)[0]
    if np.all(G @ shortest <= h) and np.allclose(A @ shortest, b, rtol=REMAINDER_ROUNDING, atol=0.0):
        return True
    scale = max(1e-300, float(np.max(np.abs(np.concatenate([h, b])), initial=0.0)))
    stated: dict[str, Any] = {"A_ub": G, "b_ub": h / scale} if len(G) else {}
    stated |= {"A_eq": A, "b_eq": b / scale} if len(A) else {}
    found = linprog(np.zeros(size), **stated, bounds=(None, None), method="highs")
    return bool(found.status != 2)


def refuse_contradictions(parts: Sequence[NamedConstraints], size: int) -> None:
    """Raise if the statements cannot all be true.

    The deletion filter of Chinneck and Dravnieks (1991) drops one statement after the other as long as the others
    still contradict each other, so that the message names a smallest set.

    Raises
    ------
    InfeasibleError
        Naming the statements that contradict each other.
    InputError
        If a statement is not about a vector of `size` numbers.
    """
    for part in parts:
        part.constraints.check(size, part.name)
    if feasible(parts, size):
        return
    core = list(parts)
    for part in parts:
        without = [other for other in core if other is not part]
        if without and not feasible(without, size):
            core = without
    raise InfeasibleError("these cannot all be true: " + "; ".join(part.name for part in core))


def refuse_infeasible(experiment: Experiment) -> None:
    """Raise if the declared masses and the exact priors of an experiment cannot all be true.

    Raises
    ------
    InfeasibleError
        Naming a smallest set of statements that contradict each other.
    """
    n, priors, frame = experiment.stories, experiment.priors, exact_frame(experiment.frame)
    # Floors that share a total are heavier than rounding.
    least = LEAST_POSITIVE**2 * (frame.total_mass or 0.0) / n
    refuse_contradictions(statements(priors, "floor_mass", n, frame, least), n)
    refuse_contradictions(statements(priors, "story_stiffness", n), n)
