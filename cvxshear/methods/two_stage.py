"""The paper's method: iterate the mass correction, then solve for the stiffnesses (its Sections 2 to 4)."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.results import SingleIdentification
from cvxshear.methods.fixed_point import MOST_ITERATIONS, iterated
from cvxshear.methods.separate import CompleteTest, finished, start_mass
from cvxshear.methods.story_stiffness import identified_stiffness
from cvxshear.util.typing import Floats

__all__ = ["MOST_ITERATIONS", "TOLERANCE", "two_stage"]

TOLERANCE = 1e-6
"""e of Eq. 15."""


def two_stage(
    of: CompleteTest,
    backend: Backend,
    initial_mass: Floats | None = None,
    tolerance: float = TOLERANCE,
    *,
    accelerate: bool = False,
) -> SingleIdentification:
    """Identify one configuration as the paper does.

    In each iteration the modes are normalized by the current masses (Eq. 3), and the correction dm of Eq. 14
    is added to them; Eq. 15 stops it, |dM| / |M| < e with the spectral norm, which for a diagonal matrix is
    its largest absolute entry.

    Parameters
    ----------
    of : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg; the total spread evenly where not given.
    tolerance : float, optional
        e of Eq. 15.
    accelerate : bool, optional
        Fewer steps to the same masses, see `fixed_point`.
    """
    history, converged = iterated(of, start_mass(of, initial_mass), backend, tolerance, accelerate=accelerate)
    mass = history[-1]
    return finished(
        of,
        mass,
        identified_stiffness(of, mass, backend),
        iterations=len(history) - 1,
        history=np.array(history) - of.configuration.added_mass,
        reason=Ending.CORRECTION if converged else Ending.ITERATION_LIMIT,
    )
