"""Priors as rows and constraints of a program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.measurement.experiment import Frame
from cvxshear.priors import Constraints, Prior
from cvxshear.programs.feasibility import NamedConstraints
from cvxshear.programs.least_squares import LeastSquares, remaining
from cvxshear.util.typing import Floats


def statements(
    priors: Sequence[Prior], quantity: str, stories: int, frame: Frame | None = None, least: float = 0.0
) -> list[NamedConstraints]:
    """The exact statements about one quantity: its positivity, what the frame declares, and the priors.

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
    """The program, its unknown x being a change of a quantity from `origin`, kept within the statements.

    Parameters
    ----------
    program : LeastSquares
    parts : sequence of NamedConstraints
        About origin + x.
    origin : ndarray, shape (n,)
    """
    G, h, A, b = _shared(program)
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


def _shared(program: LeastSquares) -> tuple[list[Floats], list[Floats], list[Floats], list[Floats]]:
    A, b = program.equalities
    if program.G is None or program.h is None:
        return [np.zeros((0, program.unknowns))], [np.zeros(0)], [A], [b]
    return [program.G], [program.h], [A], [b]


def softened(
    program: LeastSquares, priors: Sequence[Prior], quantity: str, at: Floats, row_std: float, *, step: bool
) -> LeastSquares:
    """The program with the soft priors as further rows, linearised at the values `at`.

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
        R=np.concatenate([R / row_std, J]),
        s=np.concatenate([s / row_std, -r if step else J @ at - r]),
        W=None,
    )
