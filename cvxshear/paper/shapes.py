"""The mode shapes of Fig. 8, which are drawn and not printed, recovered from the figures of Table 6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.programs import story_stiffnesses
from cvxshear.programs.orthogonality import normalized
from cvxshear.util.typing import Floats


@dataclass(frozen=True)
class RecoveredShapes:
    """The two modes of a two-story frame.

    Parameters
    ----------
    first, second : float
        Entry at floor 1 over that at floor 2.
    misfit : float
        Largest relative distance of the stiffnesses that Eq. 24 gives from the printed ones.
    """

    first: float
    second: float
    misfit: float


def recovered_shapes(floor_mass: Floats, story_stiffness: Floats, frequencies: Floats) -> RecoveredShapes:
    """The mode shapes from which the paper's method finds these masses and stiffnesses.

    The method ends at masses on which two measured modes are orthogonal, so the second shape follows from the
    first one's ratio r: m1 r r2 + m2 = 0. That r for which Eq. 24 returns the stiffnesses is found by least
    squares, two equations for one unknown; what is left shows whether the two agree.

    Parameters
    ----------
    floor_mass : ndarray, shape (2,)
        Identified, with added mass, kg.
    story_stiffness : ndarray, shape (2,)
        Identified, N/m.
    frequencies : ndarray, shape (2,)
        Measured, Hz.
    """
    eigenvalues = (2 * np.pi * frequencies) ** 2

    def second(first: float) -> float:
        return float(-floor_mass[1] / (floor_mass[0] * first))

    def misfit(ratio: Floats) -> Floats:
        shapes = np.array([[ratio[0], second(ratio[0])], [1.0, 1.0]])
        program = story_stiffnesses(normalized(shapes, floor_mass), eigenvalues)
        return np.asarray(np.linalg.lstsq(program.R, program.s, rcond=None)[0] / story_stiffness - 1.0)

    model = modes(mass_matrix(floor_mass), stiffness_matrix(story_stiffness)).shapes[0]
    found = optimize.least_squares(misfit, [model[0] / model[1]], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    first = float(found.x[0])
    return RecoveredShapes(first, second(first), float(np.max(np.abs(found.fun))))
