"""The paper's programs of an experiment: mass correction, one-shot masses, story stiffnesses, with all that is known.

Each configuration has its own programs, which need all modes at all floors and the total mass. Positivity, declared
masses and exact priors are constraints. Soft priors are further rows, linearized at given values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment, Measurement, opened
from cvxshear.priors import Prior
from cvxshear.programs.constraints import (
    LEAST_POSITIVE,
    NamedConstraints,
    constrained,
    refuse_contradicting,
    softened,
    statements,
)
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.programs.pair_rows import mass_rows, normalized, one_shot_rows, stiffness_rows
from cvxshear.programs.turning import TurningTest
from cvxshear.util import checks, decorators, errors, quantities
from cvxshear.util.typing import Floats


@decorators.usual_arithmetic
def mass_correction(
    experiment: Measurement,
    masses: Sequence[float] | Floats | None = None,
    *,
    configuration: str | None = None,
    priors: Sequence[Prior] = (),
) -> LeastSquares:
    """Write one iteration of the paper's mass identification at the given masses (Eqs. 5 to 14).

    Minimize the sum over i <= j of ((phi_i o phi_j)' dm - delta_ij + phi_i' M phi_j)^2 subject to
    sum(dm) = total - sum(masses), the modes normalized by the given masses (Eq. 3).

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in example
    masses : array_like, shape (N,), optional
        Floor masses of this iteration without added mass, kg. Default: the total mass spread evenly.
    configuration : str, optional
        Name of the configuration. Default: the only one.
    priors : sequence of Prior, optional
        In addition to the priors of the experiment; soft ones are linearized at `masses`.

    Returns
    -------
    LeastSquares
        Its unknown x is dm, kg: the next masses are masses + x.

    Raises
    ------
    InfeasibleError
        If declared masses and exact priors contradict each other.
    InputError
        If the masses are not N positive numbers, or the configuration is unknown.
    UnsuitableError
        If a mode, a floor or the total mass is missing.
    """
    test = _chosen(experiment, configuration, priors, "mass_correction")
    assert isinstance(test, CompleteTest)
    return test.mass_correction(test.start_mass(masses))


@decorators.usual_arithmetic
def one_shot_masses(
    experiment: Measurement,
    *,
    configuration: str | None = None,
    priors: Sequence[Prior] = (),
    at: Sequence[float] | Floats | None = None,
) -> LeastSquares:
    """Write the one-shot identification of the masses: orthogonality off the diagonal, and the total.

    Minimize the sum over i < j of ((phi_i o phi_j)' m)^2, with modes of unit length, subject to the known total.
    Exact modes give exact masses without iteration.

    Of floors that turn, minimize the sum over i < j of (phi_i' M phi_j)^2, each row over its deviation, with the mass
    matrix of every floor positive semidefinite (`lmi`). A declared plan bounds the mass centers and gives soft rows for
    the inertias.

    Parameters
    ----------
    experiment, configuration, priors
        As for `mass_correction`.
    at : array_like, shape (N,), optional
        Floor masses for the linearization of soft priors, kg. Default: the total mass spread evenly.

    Returns
    -------
    LeastSquares
        Its unknown x is the floor masses without added mass, kg. Of floors that turn: mass (kg), first moments in x and
        y (kg m) and polar inertia (kg m2) of each, at the reference point, shape (4 N,).

    Raises
    ------
    InfeasibleError, InputError, UnsuitableError
        As for `mass_correction`.
    """
    test = _chosen(experiment, configuration, priors, "one_shot_masses", turning=True)
    if isinstance(test, TurningTest):
        return test.one_shot_masses()
    return test.one_shot_masses(at=test.start_mass(at))


@decorators.usual_arithmetic
def story_stiffnesses(
    experiment: Measurement,
    masses: Sequence[float] | Floats,
    *,
    configuration: str | None = None,
    priors: Sequence[Prior] = (),
    at: Sequence[float] | Floats | None = None,
) -> LeastSquares:
    """Write the identification of the story stiffnesses at the given masses (Eqs. 20 to 24).

    Minimize the sum over i <= j of ((x_i o x_j)' k - delta_ij lambda_i)^2 with the story drifts x = T' phi of the modes
    normalized by the masses, and lambda_i = (2 pi f_i)^2.

    Of floors that turn, minimize the sum over i <= j of (phi_i' K phi_j - delta_ij lambda_i)^2, each row over its
    deviation, with the stiffness matrix of every story positive semidefinite (`lmi`).

    Parameters
    ----------
    experiment, configuration, priors
        As for `mass_correction`.
    masses : array_like, shape (N,)
        Floor masses without added mass, kg. Of floors that turn, shape (4 N,), as `one_shot_masses` finds them.
    at : array_like, shape (N,), optional
        Story stiffnesses for the linearization of soft priors, N/m. Default: equal stiffnesses with the first
        eigenvalue as the Rayleigh quotient of the first mode.

    Returns
    -------
    LeastSquares
        Its unknown x is the story stiffnesses, N/m. Of floors that turn: the entries xx, yy, rr, xy, xr and yr of each
        story's matrix, r the rotation, at the reference point, shape (6 N,), N/m, N and N m.

    Raises
    ------
    InfeasibleError, InputError, UnsuitableError
        As for `mass_correction`.
    """
    test = _chosen(experiment, configuration, priors, "story_stiffnesses", turning=True)
    if isinstance(test, TurningTest):
        each = ", four a floor"
        return test.story_stiffnesses(checks.vector(masses, "masses", length=4 * test.stories, each=each))
    mass = test.start_mass(masses) + test.configuration.added_mass
    start = None if at is None else checks.vector(np.asarray(at), "at", length=test.experiment.stories, above=0.0)
    return test.story_stiffnesses(mass, at=test.even_stiffness(mass) if start is None else start)


@dataclass(frozen=True, eq=False)
class CompleteTest:
    """One configuration with all modes at all floors and a known total mass.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    shapes : ndarray, shape (N, N)
        One column per mode.
    eigenvalues : ndarray, shape (N,)
        (2 pi f)^2.
    total : float
        Total mass with added mass, kg.
    of_masses, of_stiffnesses : list of NamedConstraints
        Exact statements about the floor masses without added mass, and about the story stiffnesses.
    shape_std : float
        Relative standard deviation of the shapes, root mean square; the weight of soft priors depends on this value.
    """

    experiment: Experiment
    configuration: Configuration
    shapes: Floats
    eigenvalues: Floats
    total: float
    of_masses: list[NamedConstraints]
    of_stiffnesses: list[NamedConstraints]
    shape_std: float

    def start_mass(self, given: Sequence[float] | Floats | None = None) -> Floats:
        """Return floor masses without added mass, kg: those given, once checked, else the total spread evenly."""
        n = self.experiment.stories
        if given is None:
            return np.full(n, (self.total - self.configuration.added_mass.sum()) / n)
        return checks.vector(np.asarray(given), "masses", length=n, above=0.0)

    def even_stiffness(self, mass: Floats) -> Floats:
        """Return equal story stiffnesses for which the Rayleigh quotient of mode 1 is its eigenvalue, N/m."""
        first = normalized(self.shapes[:, :1], mass)
        return np.full(len(first), self.eigenvalues[0] / np.sum(np.diff(first[:, 0], prepend=0.0) ** 2))

    def mass_correction(self, net: Floats) -> LeastSquares:
        """Write Eq. 14 with all that is known, at floor masses without added mass; x is their correction."""
        mass = net + self.configuration.added_mass
        plain = mass_rows(normalized(self.shapes, mass), mass, self.total)
        # The statements hold the total already.
        program = softened(
            plain.replace(A=None, b=None), self.experiment.priors, "floor_mass", net, self.shape_std, step=True
        )
        return constrained(program, self.of_masses, net).replace(title=self._title("mass correction"))

    def one_shot_masses(self, at: Floats | None = None) -> LeastSquares:
        """Write the one-shot program with all that is known.

        Parameters
        ----------
        at : ndarray, shape (N,), optional
            Floor masses for the linearization of soft priors. Without these masses, the program has no soft priors.
        """
        plain = one_shot_rows(self.shapes, self.total, at=self.configuration.added_mass).replace(A=None, b=None)
        program = plain
        if at is not None:
            # A row is off by about a floor's mass times the error of a shape.
            row_std = self.shape_std * self.total / self.experiment.stories
            program = softened(plain, self.experiment.priors, "floor_mass", at, row_std, step=False)
        return constrained(program, self.of_masses, np.zeros(len(self.shapes))).replace(
            title=self._title("one-shot masses")
        )

    def story_stiffnesses(self, mass: Floats, at: Floats | None = None) -> LeastSquares:
        """Write Eq. 24 with all that is known, at floor masses with added mass or at a full mass matrix.

        Parameters
        ----------
        mass : ndarray, shape (N,) or (N, N)
        at : ndarray, shape (N,), optional
            Story stiffnesses for the linearization of soft priors.
        """
        plain = stiffness_rows(normalized(self.shapes, mass), self.eigenvalues)
        program = plain
        if at is not None:
            # A row is off by about the largest eigenvalue times the error of a shape.
            row_std = self.shape_std * float(self.eigenvalues.max())
            program = softened(plain, self.experiment.priors, "story_stiffness", at, row_std, step=False)
        return constrained(program, self.of_stiffnesses, np.zeros(len(self.shapes))).replace(
            title=self._title("story stiffnesses")
        )

    def _title(self, what: str) -> str:
        return f"{what}, {self.configuration.name}"


def _chosen(
    experiment: Measurement, name: str | None, priors: Sequence[Prior], program: str, *, turning: bool = False
) -> CompleteTest | TurningTest:
    """Select the configuration of a program."""
    experiment = opened(experiment, turning=turning).with_priors(tuple(priors))
    names = [each.name for each in experiment.configurations]
    if name is None and len(names) > 1:
        raise errors.InputError(
            f"{program}: the experiment has {len(names)} configurations; name one of them, such as "
            f"configuration={names[0]!r}"
        )
    chosen = names[0] if name is None else checks.choice(name, names, "configuration")
    collect = TurningTest.of if experiment.frame.turns else complete_test
    return collect(experiment, experiment.configurations[names.index(chosen)], program)


def complete_test(experiment: Experiment, configuration: Configuration, user: str) -> CompleteTest:
    """Collect what the programs of one configuration need.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    user : str
        The method or program that needs it, for messages.

    Raises
    ------
    InfeasibleError
        If declared masses and exact priors contradict each other.
    UnsuitableError
        If a mode, a floor or the total mass is missing.
    """
    n = experiment.stories
    where = f'{user} cannot use configuration "{configuration.name}"'
    for what, there, needed, how in (
        ("mode", configuration.modes, f"all {n} modes", "missing"),
        ("floor", configuration.measured_floors, "every floor", "unmeasured"),
    ):
        if len(there) < n:
            missing = sorted(set(range(1, n + 1)) - set(there.tolist()))
            which = f"{what} {missing[0]} is" if len(missing) == 1 else f"{what}s {quantities.ranged(missing)} are"
            raise errors.UnsuitableError(f"{where}: it needs {needed}, {which} {how}; use method efficient")
    if not configuration.complete:
        mode, floor = np.argwhere(~configuration.measured)[0] + 1
        raise errors.UnsuitableError(f"{where}: mode {mode} has no value at floor {floor}; use method efficient")
    total = experiment.frame.known_total
    if total is None:
        raise errors.UnsuitableError(f"{where}: it needs frame: total_mass or floor_masses; use method efficient")
    refuse_contradicting(experiment)
    eigenvalues = (2 * np.pi * configuration.frequencies) ** 2
    relative = configuration.entry_std / np.max(np.abs(configuration.mode_shapes), axis=1, keepdims=True)
    least = LEAST_POSITIVE * total / n
    return CompleteTest(
        experiment,
        configuration,
        shapes=configuration.mode_shapes.T,
        eigenvalues=eigenvalues,
        total=total + float(configuration.added_mass.sum()),
        of_masses=statements(experiment.priors, "floor_mass", n, experiment.frame, least),
        of_stiffnesses=statements(experiment.priors, "story_stiffness", n, least=least * eigenvalues[0]),
        shape_std=float(np.sqrt(np.mean(relative**2))),
    )
