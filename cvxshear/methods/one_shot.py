"""All masses from one program, without an iteration."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.results import SingleIdentification
from cvxshear.methods.separate import MOST_ROUNDS, UNCHANGED, CompleteTest, finished, identified_stiffness
from cvxshear.programs import one_shot_masses
from cvxshear.programs.normal import LOST, digits_lost, keeps_rows
from cvxshear.programs.statements import constrained, softened
from cvxshear.util.typing import Floats


def one_shot(test: CompleteTest, backend: Backend) -> SingleIdentification:
    """Identify one configuration from the off-diagonal orthogonality conditions and the total mass.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    """
    plain = one_shot_masses(test.shapes, test.total, rows=test.rows)
    # Each row is a mass times the shapes' error: its standard deviation goes with the mean floor mass.
    row_std = test.shape_std * test.total / plain.unknowns
    added = test.configuration.added_mass
    solution = backend.solve(constrained(plain, test.mass_statements, -added))
    mass = solution.x
    if not keeps_rows(test.rows, len(mass)) and digits_lost(plain.R) > LOST:
        again = one_shot_masses(test.shapes, test.total, rows=test.rows, at=mass)
        mass = mass + backend.solve(constrained(again, test.mass_statements, mass - added)).x
    iterations = 1
    while iterations <= MOST_ROUNDS:
        soft = softened(plain, test.experiment.priors, "floor_mass", mass - added, row_std, step=False)
        if soft is plain:
            break
        # The soft rows speak of the masses without added mass.
        shifted = soft.replace(s=soft.s + _shift(soft.R, plain.R.shape[0], added))
        solution = backend.solve(constrained(shifted, test.mass_statements, -added), solution)
        before, mass = mass, solution.x
        iterations += 1
        if np.max(np.abs(mass - before)) <= UNCHANGED * np.max(np.abs(mass)):
            break
    return finished(
        test,
        mass,
        identified_stiffness(test, mass, backend),
        iterations=iterations,
        reason=Ending.SOLVED if iterations <= MOST_ROUNDS else Ending.ITERATION_LIMIT,
    )


def _shift(R: Floats, own_rows: int, added: Floats) -> Floats:
    """What the added mass contributes to the soft rows, zero for the program's own."""
    shift: Floats = R @ added
    shift[:own_rows] = 0.0
    return shift
