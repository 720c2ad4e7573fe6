"""What the methods share that identify each configuration by itself.

What they need, the story stiffnesses once the masses are known (Eqs. 20-24), and what they return.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import refuse_contradicting
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.quality import quality
from cvxshear.fit.results import IdentifiedFrame, SingleIdentification, predictions
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.programs import LeastSquares, story_stiffnesses
from cvxshear.programs.orthogonality import LOST, digits_lost, keeps_rows, normalized
from cvxshear.programs.statements import NamedConstraints, constrained, softened, statements
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.quantities import ranged
from cvxshear.util.typing import Floats

LEAST_POSITIVE = 1e-3
"""Least positive mass, as a fraction of the mean floor mass, and stiffness, of that which carries it at the first mode.

A bound much smaller than this is lost in a solver's own tolerances; HiGHS 1.15 ends with an error on one of 1e-6."""


MOST_ROUNDS = 50
"""Rounds in which soft priors, which need not be linear, are linearised again at the last solution."""

UNCHANGED = 1e-10
"""Relative change of masses or stiffnesses at which soft priors count as linearised where they belong."""


@dataclass(frozen=True, eq=False)
class CompleteTest:
    """One configuration with everything that a method of this kind needs.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    shapes : ndarray, shape (N, N)
        One column a mode.
    eigenvalues : ndarray, shape (N,)
        (2 pi f)^2.
    total : float
        kg, with added mass.
    mass_statements, stiffness_statements : list of NamedConstraints
        Exact statements about the floor masses without added mass, and about the story stiffnesses.
    shape_std : float
        Relative standard deviation of the shapes, root mean square; soft priors weigh against it.
    rows : bool, optional
        Whether programs keep a row a pair of modes, see `programs.mass_correction`.
    """

    experiment: Experiment
    configuration: Configuration
    shapes: Floats
    eigenvalues: Floats
    total: float
    mass_statements: list[NamedConstraints]
    stiffness_statements: list[NamedConstraints]
    shape_std: float
    rows: bool | None = None


def complete_test(
    experiment: Experiment, configuration: Configuration, method: str, *, rows: bool | None = None
) -> CompleteTest:
    """One configuration, once a method of this kind can use it.

    Raises
    ------
    UnsuitableError
        Where a mode, a floor or the total mass is missing.
    InfeasibleError
        Where declared masses and exact priors contradict each other.
    """
    n = experiment.stories
    where = f'method {method} cannot use configuration "{configuration.name}"'
    for what, there, needed, how in (
        ("mode", configuration.modes, f"all {n} modes", "missing"),
        ("floor", configuration.measured_floors, "every floor", "unmeasured"),
    ):
        if len(there) < n:
            missing = sorted(set(range(1, n + 1)) - set(there.tolist()))
            which = f"{what} {missing[0]} is" if len(missing) == 1 else f"{what}s {ranged(missing)} are"
            raise UnsuitableError(f"{where}: it needs {needed}, {which} {how}; use method efficient")
    if not configuration.complete:
        mode, floor = np.argwhere(~configuration.measured)[0] + 1
        raise UnsuitableError(f"{where}: mode {mode} has no value at floor {floor}; use method efficient")
    total = experiment.frame.known_total
    if total is None:
        raise UnsuitableError(f"{where}: it needs frame: total_mass or floor_masses; use method efficient")
    refuse_contradicting(experiment)
    eigenvalues = (2 * np.pi * configuration.frequencies) ** 2
    relative = configuration.entry_std / np.max(np.abs(configuration.mode_shapes), axis=1, keepdims=True)
    least = LEAST_POSITIVE * total / n
    of_masses = statements(experiment.priors, "floor_mass", n, experiment.frame, least)
    of_stiffnesses = statements(experiment.priors, "story_stiffness", n, least=least * eigenvalues[0])
    shapes, std = configuration.mode_shapes.T, float(np.sqrt(np.mean(relative**2)))
    total += float(configuration.added_mass.sum())
    return CompleteTest(
        experiment, configuration, shapes, eigenvalues, total, of_masses, of_stiffnesses, shape_std=std, rows=rows
    )


def start_mass(test: CompleteTest, initial: Floats | None) -> Floats:
    """Choose the first guess of the floor masses with added mass: the one handed in, else the total spread evenly."""
    n = test.experiment.stories
    net = test.total - test.configuration.added_mass.sum()
    return (np.full(n, net / n) if initial is None else initial) + test.configuration.added_mass


def identified_stiffness(test: CompleteTest, mass: Floats, backend: Backend) -> Floats:
    """Solve Eq. 24 with the priors.

    Parameters
    ----------
    test : CompleteTest
    mass : ndarray, shape (N,) or (N, N)
        Floor masses with added mass, or a full mass matrix.
    backend : Backend

    Returns
    -------
    ndarray, shape (N,)
        N/m.
    """
    program = partial(story_stiffnesses, normalized(test.shapes, mass), test.eigenvalues, rows=test.rows)
    return solved(test, program, "story_stiffness", test.shape_std * float(test.eigenvalues.max()), backend)[0]


def solved(
    test: CompleteTest, program: Callable[..., LeastSquares], quantity: str, row_std: float, backend: Backend
) -> tuple[Floats, int]:
    """Solve a program of one quantity with its exact statements and its soft priors.

    Parameters
    ----------
    test : CompleteTest
    program : callable
        Makes the program of the masses with added mass, or of the stiffnesses; of their change from `at` where given.
    quantity : str
        "floor_mass" or "story_stiffness".
    row_std : float
        Standard deviation of the program's rows, against which soft priors weigh.
    backend : Backend

    Returns
    -------
    x : ndarray, shape (N,)
    iterations : int
        Programs solved; more than `MOST_ROUNDS` where soft priors did not settle.
    """
    of_mass = quantity == "floor_mass"
    exact = test.mass_statements if of_mass else test.stiffness_statements
    # Statements and priors do not speak of the added mass.
    added = test.configuration.added_mass if of_mass else np.zeros(test.experiment.stories)
    plain = program()
    solution = backend.solve(constrained(plain, exact, -added))
    x = solution.x
    if not keeps_rows(test.rows, len(x)) and digits_lost(plain.R) > LOST:
        x = x + backend.solve(constrained(program(at=x), exact, x - added)).x
    for iterations in range(1, MOST_ROUNDS + 1):
        soft = softened(plain, test.experiment.priors, quantity, x - added, row_std, step=False)
        if soft is plain:
            return x, iterations
        shift = np.concatenate([np.zeros(len(plain.s)), soft.R[len(plain.s) :] @ added])
        solution = backend.solve(constrained(soft.replace(s=soft.s + shift), exact, -added), solution)
        before, x = x, solution.x
        if np.max(np.abs(x - before)) <= UNCHANGED * np.max(np.abs(x)):
            return x, iterations + 1
    return x, MOST_ROUNDS + 1


def finished(test: CompleteTest, mass: Floats, backend: Backend, **more: object) -> SingleIdentification:
    """Make the part for a configuration: the frame without its added mass, its stiffnesses, errors and predictions.

    Parameters
    ----------
    test : CompleteTest
    mass : ndarray, shape (N,) or (N, N)
        Floor masses with added mass, or a full mass matrix.
    backend : Backend
    **more
        Further fields of `SingleIdentification`.
    """
    stiffness = identified_stiffness(test, mass, backend)
    mass = mass if mass.ndim == 1 else np.diag(mass)
    net = mass - test.configuration.added_mass
    frame = dataclasses.replace(test.experiment.frame, reference=None)
    alone = Experiment(frame, (test.configuration,), test.experiment.priors, test.experiment.name)
    misfit = Misfit(alone)
    theta = np.concatenate([net, stiffness])
    # The stiffnesses, and the masses less the known total, are what the data had to determine.
    free = len(net) + (0 if test.experiment.frame.floor_masses is not None else len(net) - 1)
    at = misfit.evaluate(theta, derivatives=False)
    declared = not misfit.open_noises
    return SingleIdentification(
        name=test.configuration.name,
        frame=IdentifiedFrame(net, stiffness),
        fit=quality(misfit.data, at.models, at.chi2, misfit.count(theta) - free, declared=declared),
        predictions=predictions(at.models),
        **more,  # type: ignore[arg-type]  # fields of SingleIdentification, of the types that it says
    )
