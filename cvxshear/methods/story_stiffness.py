"""The story stiffnesses, once the masses are known (Eqs. 20-24)."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.methods.separate import CompleteTest
from cvxshear.programs import story_stiffnesses
from cvxshear.programs.normal import LOST, digits_lost, keeps_rows
from cvxshear.programs.orthogonality import normalized
from cvxshear.programs.statements import constrained, softened
from cvxshear.util.typing import Floats

MOST_ROUNDS = 50
UNCHANGED = 1e-10
"""Relative change of the stiffnesses at which soft priors count as linearised where they belong."""


def identified_stiffness(of: CompleteTest, mass: Floats, backend: Backend) -> Floats:
    """Solve Eq. 24 with the priors.

    Parameters
    ----------
    of : CompleteTest
    mass : ndarray, shape (N,) or (N, N)
        Floor masses with added mass, or a full mass matrix.
    backend : Backend

    Returns
    -------
    ndarray, shape (N,)
        N/m.
    """
    shapes = normalized(of.shapes, mass)
    plain = story_stiffnesses(shapes, of.eigenvalues, rows=of.rows)
    origin = np.zeros(plain.unknowns)
    solution = backend.solve(constrained(plain, of.stiffness_statements, origin))
    k = solution.x
    if not keeps_rows(of.rows, len(k)) and digits_lost(plain.R) > LOST:
        again = story_stiffnesses(shapes, of.eigenvalues, rows=of.rows, at=k)
        k = k + backend.solve(constrained(again, of.stiffness_statements, k)).x
    row_std = of.shape_std * float(of.eigenvalues.max())
    for _ in range(MOST_ROUNDS):
        soft = softened(plain, of.experiment.priors, "story_stiffness", k, row_std, step=False)
        if soft is plain:
            return k
        solution = backend.solve(constrained(soft, of.stiffness_statements, origin), solution)
        before, k = k, solution.x
        if np.max(np.abs(k - before)) <= UNCHANGED * np.max(np.abs(k)):
            break
    return k
