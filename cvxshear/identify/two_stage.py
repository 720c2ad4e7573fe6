"""The paper's method: iterate the mass correction, then solve for the stiffnesses (its Sections 2 to 4)."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.identify.results import Part
from cvxshear.identify.separate import Setting, finished, start_mass
from cvxshear.identify.stiffness import identified_stiffness
from cvxshear.programs import mass_correction
from cvxshear.programs.mass import normalized
from cvxshear.programs.rows import constrained, softened
from cvxshear.typing import Floats

TOLERANCE = 1e-6
"""e of Eq. 15."""

MOST_ITERATIONS = 1000


def two_stage(of: Setting, backend: Backend, initial_mass: Floats | None = None, tolerance: float = TOLERANCE) -> Part:
    """Identify one configuration as the paper does.

    In each iteration the modes are normalized by the current masses (Eq. 3), and the correction dm of Eq. 14
    is added to them; Eq. 15 stops it, |dM| / |M| < e with the spectral norm, which for a diagonal matrix is
    its largest absolute entry.

    Parameters
    ----------
    of : Setting
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg; the total spread evenly where not given.
    tolerance : float, optional
        e of Eq. 15.
    """
    mass = start_mass(of, initial_mass)
    added = of.configuration.added_mass
    history = [mass - added]
    converged = False
    while not converged and len(history) <= MOST_ITERATIONS:
        # The statements below hold the total already.
        program = mass_correction(normalized(of.shapes, mass), mass, of.total).replace(A=None, b=None)
        program = softened(program, of.experiment.priors, "floor_mass", mass - added, of.shape_std, step=True)
        dm = backend.solve(constrained(program, of.mass_statements, mass - added)).x
        mass = mass + dm
        history.append(mass - added)
        converged = bool(np.max(np.abs(dm)) < tolerance * np.max(np.abs(mass)))
    return finished(
        of,
        mass,
        identified_stiffness(of, mass, backend),
        converged=converged,
        iterations=len(history) - 1,
        history=np.array(history),
        reason="correction below tolerance (Eq. 15)" if converged else "iteration limit",
    )
