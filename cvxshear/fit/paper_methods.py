"""The paper's method, two stages for each configuration, and the methods that the paper compares it with.

The mass iteration is a fixed point of Eq. 14 and not a least-squares fit: each step minimizes its own program, in
modes normalized by the current masses. So it does not use the Gauss-Newton driver of `cvxshear.fit`.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.results import IdentifiedFrame, SingleIdentification, predictions, priced, quality
from cvxshear.measurement.experiment import Experiment
from cvxshear.programs import LeastSquares, Solution
from cvxshear.programs.formulations import CompleteTest, mass_rows, normalized
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

#: Tolerance e of Eq. 15.
TOLERANCE = 1e-6

#: Largest number of mass iterations, of which the paper's frames take 14 to 16, and of linearizations of priors.
MOST_ITERATIONS = 1000

#: Largest relative change of masses or stiffnesses that needs no further linearization of the soft priors.
UNCHANGED = 1e-10


def two_stage(
    test: CompleteTest, backend: Backend, initial_mass: Floats | None = None, tolerance: float = TOLERANCE
) -> SingleIdentification:
    """Identify one configuration as the paper does.

    Each iteration normalizes the modes by the current masses (Eq. 3) and adds the correction dm of Eq. 14. Eq. 15 stops
    it: |dM| / |M| < e with the spectral norm, the largest absolute entry of a diagonal matrix.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg. Default: the total spread evenly.
    tolerance : float, optional
        e of Eq. 15.
    """
    added = test.configuration.added_mass
    history = [test.start_mass(initial_mass)]
    solution: Solution | None = None
    reason = Ending.ITERATION_LIMIT
    while reason is Ending.ITERATION_LIMIT and len(history) <= MOST_ITERATIONS:
        solution = backend.solve(test.mass_correction(history[-1]))
        history.append(history[-1] + solution.x)
        if np.max(np.abs(solution.x)) < tolerance * np.max(np.abs(history[-1] + added)):
            reason = Ending.CORRECTION
    return _finished(test, history[-1] + added, backend, len(history) - 1, reason, solution, history=np.array(history))


def one_shot(test: CompleteTest, backend: Backend) -> SingleIdentification:
    """Identify one configuration from the orthogonality of its modes and the total mass, without iteration.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    """
    solution, rounds = _solved(test, test.one_shot_masses, "floor_mass", backend)
    reason = Ending.SOLVED if rounds <= MOST_ITERATIONS else Ending.ITERATION_LIMIT
    return _finished(test, solution.x + test.configuration.added_mass, backend, rounds, reason, solution)


def qi(test: CompleteTest, backend: Backend, initial_mass: Floats | None = None) -> SingleIdentification:
    """Correct the masses once, by least squares without the total (Eq. 10), at the initial normalization.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg.
    """
    _refuse_priors(test, "qi")
    net, added = test.start_mass(initial_mass), test.configuration.added_mass
    start = net + added
    program = mass_rows(normalized(test.shapes, start), start, test.total).replace(A=None, b=None)
    corrected = net + backend.solve(program).x
    return _finished(test, corrected + added, backend, 1, history=np.array([net, corrected]))


def berman(test: CompleteTest, backend: Backend, initial_mass: Floats | None = None) -> SingleIdentification:
    """Find the smallest change of the mass matrix that makes the modes orthonormal (Berman 1979).

    M = M0 + M0 P a^-1 (1 - a) a^-1 P' M0 with a = P' M0 P, the modes P normalized by M0. The result is a full matrix.
    Its diagonal is reported as floor masses. The stiffnesses follow from Eq. 24 in modes normalized by the full matrix.

    Parameters
    ----------
    test : CompleteTest
    backend : Backend
    initial_mass : ndarray, shape (N,), optional
        Without added mass, kg.
    """
    _refuse_priors(test, "berman")
    net, added = test.start_mass(initial_mass), test.configuration.added_mass
    M0 = np.diag(net + added)
    P = normalized(test.shapes, net + added)
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
    return _finished(test, M, backend, 1, history=np.array([net, np.diag(M) - added]), mass_matrix=M)


def _refuse_priors(test: CompleteTest, method: str) -> None:
    if test.experiment.priors:
        raise UnsuitableError(f"method {method} takes no priors; use two-stage, one-shot or efficient")


def identified_stiffness(test: CompleteTest, mass: Floats, backend: Backend) -> Solution:
    """Solve Eq. 24 with the priors.

    Parameters
    ----------
    test : CompleteTest
    mass : ndarray, shape (N,) or (N, N)
        Floor masses with added mass, or a full mass matrix.
    backend : Backend

    Returns
    -------
    Solution
        Its x is the story stiffnesses, N/m.
    """
    return _solved(test, partial(test.story_stiffnesses, mass), "story_stiffness", backend)[0]


def _solved(
    test: CompleteTest, program: Callable[..., LeastSquares], quantity: str, backend: Backend
) -> tuple[Solution, int]:
    """Solve a program of one quantity, with its soft priors linearized until the solution stays.

    Parameters
    ----------
    test : CompleteTest
    program : callable
        Writes the program for `at`, see `CompleteTest.one_shot_masses`.
    quantity : str
        "floor_mass" or "story_stiffness".
    backend : Backend

    Returns
    -------
    solution : Solution
    rounds : int
        Programs solved; more than `MOST_ITERATIONS` if the soft priors did not settle.
    """
    solution = backend.solve(program())
    soft = any(len(prior.residual(solution.x)[0]) for prior in test.experiment.priors if prior.quantity == quantity)
    if not soft:
        return solution, 1
    rounds, settled = 1, False
    while not settled and rounds <= MOST_ITERATIONS:
        before, rounds = solution.x, rounds + 1
        solution = backend.solve(program(at=before))
        settled = bool(np.max(np.abs(solution.x - before)) <= UNCHANGED * np.max(np.abs(solution.x)))
    return solution, rounds


def _finished(
    test: CompleteTest,
    mass: Floats,
    backend: Backend,
    iterations: int,
    reason: Ending = Ending.SOLVED,
    of_masses: Solution | None = None,
    **more: Floats,
) -> SingleIdentification:
    """Identify the stiffnesses at these masses, and collect errors, predictions and active bounds.

    Parameters
    ----------
    test : CompleteTest
    mass : ndarray, shape (N,) or (N, N)
        Floor masses with added mass, or a full mass matrix.
    backend : Backend
    iterations : int
    reason : Ending, optional
    of_masses : Solution, optional
        Solution of the last program of the masses; its active constraints are reported.
    **more
        `history` and `mass_matrix` of `SingleIdentification`.
    """
    stiffness = identified_stiffness(test, mass, backend)
    diagonal = mass if mass.ndim == 1 else np.diag(mass)
    net = diagonal - test.configuration.added_mass
    frame = dataclasses.replace(test.experiment.frame, reference=None)
    alone = Experiment(frame, (test.configuration,), test.experiment.priors, test.experiment.name)
    misfit = Misfit(alone)
    theta, unknown = np.concatenate([net, stiffness.x]), np.full(len(net), np.nan)
    # The data determine the stiffnesses, and the masses up to the known total.
    free = len(net) + (0 if test.experiment.frame.floor_masses is not None else len(net) - 1)
    at = misfit.evaluate(theta, derivatives=False)
    return SingleIdentification(
        name=test.configuration.name,
        iterations=iterations,
        frame=IdentifiedFrame(net, stiffness.x, unknown, unknown),
        fit=quality(misfit.data, at.models, at.chi2, misfit.count(theta) - free, declared=not misfit.open_noises),
        predictions=predictions(at.models),
        reason=reason,
        active=priced([each for found in (of_masses, stiffness) if found is not None for each in found.active]),
        **more,
    )
