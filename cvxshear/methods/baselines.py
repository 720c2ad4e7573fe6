"""The two earlier methods that the paper compares itself with: Berman (its Ref. 17) and Qi (its Ref. 23)."""

from __future__ import annotations

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.results import SingleIdentification
from cvxshear.methods.separate import CompleteTest, finished, identified_stiffness, start_mass
from cvxshear.programs import mass_correction
from cvxshear.programs.orthogonality import normalized
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats


def _refuse_priors(test: CompleteTest, method: str) -> None:
    if test.experiment.priors:
        raise UnsuitableError(f"method {method} takes no priors; use two-stage, one-shot or efficient")


def qi(test: CompleteTest, backend: Backend, initial_mass: Floats | None = None) -> SingleIdentification:
    """One least-squares correction without the constraint on the total (Eq. 10), on the initial normalization.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg.
    """
    _refuse_priors(test, "qi")
    start = start_mass(test, initial_mass)
    program = mass_correction(normalized(test.shapes, start), start, test.total).replace(A=None, b=None)
    mass = start + backend.solve(program).x
    added = test.configuration.added_mass
    return finished(
        test,
        mass,
        identified_stiffness(test, mass, backend),
        iterations=1,
        history=np.array([start - added, mass - added]),
    )


def berman(test: CompleteTest, backend: Backend, initial_mass: Floats | None = None) -> SingleIdentification:
    """The smallest change of the mass matrix that makes the modes orthonormal (Berman, 1979).

    M = M0 + M0 P a^-1 (1 - a) a^-1 P' M0 with a = P' M0 P, the modes P normalized by M0. The result is a full
    matrix; its diagonal is reported as floor masses, and the stiffnesses follow from Eq. 24 on the modes
    renormalized by the full matrix.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg.
    """
    _refuse_priors(test, "berman")
    start = start_mass(test, initial_mass)
    M0 = np.diag(start)
    P = normalized(test.shapes, start)
    a = P.T @ M0 @ P
    if not np.linalg.cond(a) < 1 / np.sqrt(np.finfo(np.float64).eps):
        raise UnsuitableError("method berman needs modes that differ from each other; use efficient")
    inverse = np.linalg.inv(a)
    # a^-1 (1 - a) a^-1 = a^-2 - a^-1.
    M = M0 + M0 @ P @ (inverse @ inverse - inverse) @ P.T @ M0
    M = 0.5 * (M + M.T)
    if np.any(np.diag(M) <= 0) or np.linalg.eigvalsh(M)[0] <= 0:
        raise UnsuitableError(
            "method berman corrects the mass matrix of these modes to one that is not positive definite; use efficient"
        )
    added = test.configuration.added_mass
    return finished(
        test,
        np.diag(M).copy(),
        identified_stiffness(test, M, backend),
        iterations=1,
        history=np.array([start - added, np.diag(M) - added]),
        mass_matrix=M,
    )
