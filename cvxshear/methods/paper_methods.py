"""The paper's method: iterate the mass correction, then solve for the stiffnesses (its Sections 2 to 4).

The mass iteration is a fixed point of Eq. 14 and no least-squares fit: each step is the minimum of its own program, of
modes that are normalized anew, and what it leads to minimizes no sum of squares that stays the same. So it does not use
the Gauss-Newton driver of `cvxshear.fit`.

Every step is a program whose rows speak of the pairs of modes,

    (phi_i o phi_j)' dm = delta_ij - phi_i' M phi_j,        i <= j.

The modes were normalized by M, so the right sides of the rows i = j are zero: at the fixed point they contribute
nothing to the gradient, and on the way there they only hold dm back, by about a half in every iteration. Without
them the gradient at dm = 0 is the same, so that the iteration can stop at the same masses alone, under noise and
with constraints or soft priors too; but each step goes nearly all the way. What is left of the error after a step
is of the order of the modes' lack of orthogonality, and nothing for exact modes, where the first step is the
one-shot answer.
"""

from functools import partial

import numpy as np

from cvxshear.backends import Backend, Solution
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.results import SingleIdentification
from cvxshear.methods.separate import MOST_ROUNDS, CompleteTest, finished, solved, start_mass
from cvxshear.programs import mass_correction, one_shot_masses
from cvxshear.programs.orthogonality import normalized
from cvxshear.programs.statements import constrained, softened
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

TOLERANCE = 1e-6
"""e of Eq. 15."""

MOST_ITERATIONS = 1000
"""Steps of the mass iteration: the paper's frames take 14, and one that takes a thousand gets nowhere."""


def two_stage(
    test: CompleteTest,
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
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg; the total spread evenly where not given.
    tolerance : float, optional
        e of Eq. 15.
    accelerate : bool, optional
        Fewer steps to the same masses, see above.
    """
    history, converged = iterated(test, start_mass(test, initial_mass), backend, tolerance, accelerate=accelerate)
    net, steps = np.array(history) - test.configuration.added_mass, len(history) - 1
    reason = Ending.CORRECTION if converged else Ending.ITERATION_LIMIT
    return finished(test, history[-1], backend, iterations=steps, history=net, reason=reason)


def correction(
    test: CompleteTest, mass: Floats, backend: Backend, start: Solution | None = None, *, diagonal: bool = True
) -> Solution:
    """One step dm from these masses.

    Parameters
    ----------
    test : CompleteTest
    mass : ndarray, shape (N,)
        With added mass, kg.
    backend : Backend
    start : Solution, optional
        Of the step before.
    diagonal : bool, optional
        With the rows i = j, Eq. 14 as printed.

    Returns
    -------
    Solution
        Its x is dm.
    """
    net = mass - test.configuration.added_mass
    program = mass_correction(normalized(test.shapes, mass), mass, test.total, rows=test.rows, diagonal=diagonal)
    # The statements hold the total already.
    program = softened(
        program.replace(A=None, b=None), test.experiment.priors, "floor_mass", net, test.shape_std, step=True
    )
    return backend.solve(constrained(program, test.mass_statements, net), start)


def iterated(
    test: CompleteTest, start: Floats, backend: Backend, tolerance: float, *, accelerate: bool
) -> tuple[list[Floats], bool]:
    """Return the masses with added mass at the start and after each step, and whether Eq. 15 was met.

    Parameters
    ----------
    test : CompleteTest
    start : ndarray, shape (N,)
    backend : Backend
    tolerance : float
        e of Eq. 15.
    accelerate : bool
        Steps without the rows i = j. Should one not be shorter than the step before it, the next is the paper's.

    Notes
    -----
    Eq. 15 bounds the last step. The paper's iteration converges linearly, with an error at the end of about one
    more such step; that of the accelerated one is far below it.
    """
    history, before = [start], np.inf
    diagonal = not accelerate
    solution: Solution | None = None
    while len(history) <= MOST_ITERATIONS:
        solution = correction(test, history[-1], backend, solution, diagonal=diagonal)
        dm = solution.x
        history.append(history[-1] + dm)
        length = float(np.max(np.abs(dm)))
        if length < tolerance * float(np.max(np.abs(history[-1]))):
            return history, True
        diagonal = not accelerate or length >= before
        before = length
    return history, False


def one_shot(test: CompleteTest, backend: Backend) -> SingleIdentification:
    """Identify one configuration from the off-diagonal orthogonality conditions and the total mass.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    """
    program = partial(one_shot_masses, test.shapes, test.total, rows=test.rows)
    # Each row is a mass times the shapes' error: its standard deviation goes with the mean floor mass.
    row_std = test.shape_std * test.total / test.experiment.stories
    mass, iterations = solved(test, program, "floor_mass", row_std, backend)
    reason = Ending.SOLVED if iterations <= MOST_ROUNDS else Ending.ITERATION_LIMIT
    return finished(test, mass, backend, iterations=iterations, reason=reason)


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
    return finished(test, mass, backend, iterations=1, history=np.array([start - added, mass - added]))


def berman(test: CompleteTest, backend: Backend, initial_mass: Floats | None = None) -> SingleIdentification:
    """Find the smallest change of the mass matrix that makes the modes orthonormal (Berman, 1979).

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
        test, M, backend, iterations=1, history=np.array([start - added, np.diag(M) - added]), mass_matrix=M
    )
