"""The paper's programs of an experiment: mass correction, one-shot masses, story stiffnesses, with all that is known.

Each configuration has its own programs, which need all modes at all floors and the total mass. Positivity, declared
masses and exact priors are constraints. Soft priors are further rows, linearized at given values.

Modes are orthogonal with respect to the masses, and their story drifts with respect to the stiffnesses. Each pair of
modes is one row p_i o p_j, linear in the unknowns. With P the columns p_j, G = P P' and Q = P o P,

    A'A = (G o G + Q Q') / 2                      over the pairs i <= j,
    A'A = (G o G - Q Q') / 2                      over the pairs i < j.

In a tall frame the Cholesky factor of A'A replaces the rows: N stories then cost O(N^3) operations and O(N^2) memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from cvxshear.measurement.experiment import Configuration, Experiment, Measurement, opened
from cvxshear.motions import THREE_MOTIONS, blocks
from cvxshear.priors import Prior
from cvxshear.programs import constraints
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.programs.turning import TurningTest
from cvxshear.util import checks, decorators, errors, quantities
from cvxshear.util.typing import Floats

#: Largest number of stories for a program with one row for each pair of modes: from there on a factor is faster.
ROWS_UP_TO = 30


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
        return test.one_shot_masses(None if at is None else checks.vector(at, "at", length=test.stories, above=0.0))
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
        given = checks.vector(masses, "masses", length=4 * test.stories, each=", four a floor")
        wrong = np.flatnonzero(np.linalg.eigvalsh(blocks(given, THREE_MOTIONS.mass_basis))[:, 0] <= 0)
        if wrong.size:
            raise errors.InputError(f"masses: the mass matrix of floor {wrong[0] + 1} must be positive definite")
        return test.story_stiffnesses(given)
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
    of_masses: list[constraints.NamedConstraints]
    of_stiffnesses: list[constraints.NamedConstraints]
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
        program = constraints.softened(
            plain.replace(A=None, b=None), self.experiment.priors, "floor_mass", net, self.shape_std, step=True
        )
        return constraints.constrained(program, self.of_masses, net).replace(title=self._title("mass correction"))

    def one_shot_masses(self, at: Floats | None = None) -> LeastSquares:
        """Write the one-shot program with all that is known.

        Parameters
        ----------
        at : ndarray, shape (N,), optional
            Floor masses for the linearization of soft priors. Without these masses, the program has no soft priors.
        """
        program = one_shot_rows(self.shapes, self.total, at=self.configuration.added_mass).replace(A=None, b=None)
        if at is not None:
            # A row is off by about a floor's mass times the error of a shape.
            row_std = self.shape_std * self.total / self.experiment.stories
            program = constraints.softened(program, self.experiment.priors, "floor_mass", at, row_std, step=False)
        return constraints.constrained(program, self.of_masses, np.zeros(len(self.shapes))).replace(
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
        program = stiffness_rows(normalized(self.shapes, mass), self.eigenvalues)
        if at is not None:
            # A row is off by about the largest eigenvalue times the error of a shape.
            row_std = self.shape_std * float(self.eigenvalues.max())
            program = constraints.softened(program, self.experiment.priors, "story_stiffness", at, row_std, step=False)
        return constraints.constrained(program, self.of_stiffnesses, np.zeros(len(self.shapes))).replace(
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
    eigenvalues = (2 * np.pi * configuration.frequencies) ** 2
    relative = configuration.entry_std / np.max(np.abs(configuration.mode_shapes), axis=1, keepdims=True)
    least = constraints.LEAST_POSITIVE * total / n
    of_masses = constraints.statements(experiment.priors, "floor_mass", n, experiment.frame, least)
    of_stiffnesses = constraints.statements(experiment.priors, "story_stiffness", n, least=least * eigenvalues[0])
    for each in (of_masses, of_stiffnesses):
        constraints.refuse_contradictions(each, n)
    return CompleteTest(
        experiment,
        configuration,
        shapes=configuration.mode_shapes.T,
        eigenvalues=eigenvalues,
        total=total + float(configuration.added_mass.sum()),
        of_masses=of_masses,
        of_stiffnesses=of_stiffnesses,
        shape_std=float(np.sqrt(np.mean(relative**2))),
    )


def pair_products(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Compute the rows p_i o p_j for the column pairs i <= j, or i < j without the diagonal.

    scipy.linalg.khatri_rao forms every pair twice, and these rows take most of the memory of a program.

    Parameters
    ----------
    columns : ndarray, shape (N, m)

    Returns
    -------
    ndarray, shape (m (m + 1) / 2, N) or (m (m - 1) / 2, N)
    """
    i, j = np.triu_indices(columns.shape[1], k=0 if diagonal else 1)
    return np.ascontiguousarray((columns[:, i] * columns[:, j]).T)


def pair_normal(columns: Floats, *, diagonal: bool = True) -> Floats:
    """Compute A'A of the rows p_i o p_j, i <= j, or i < j without the diagonal.

    Parameters
    ----------
    columns : ndarray, shape (..., N, m)
        Leading axes are a batch.
    diagonal : bool, optional

    Returns
    -------
    ndarray, shape (..., N, N)
    """
    G = columns @ np.swapaxes(columns, -1, -2)
    Q = columns**2
    squares = Q @ np.swapaxes(Q, -1, -2)
    return np.asarray(0.5 * (G * G + squares if diagonal else G * G - squares))


def _of_pairs(columns: Floats, pair_sides: Floats, *, diagonal: bool = True, **more: Any) -> LeastSquares:
    """Write the program with one row for each pair of columns, or with a factor of their normal matrix.

    Parameters
    ----------
    columns : ndarray, shape (N, m)
    pair_sides : ndarray, shape (m, m)
        Symmetric: the right side of each pair.
    diagonal : bool, optional
        Whether the pairs i = i are among the rows.
    **more
        Equalities and names of the program.
    """
    if len(columns) > ROWS_UP_TO:
        normal, squares = pair_normal(columns, diagonal=diagonal), columns**2 @ np.diag(pair_sides)
        side = 0.5 * (np.sum(columns * (columns @ pair_sides), axis=1) + (squares if diagonal else -squares))
        if "A" in more:
            # With exact modes the rows vanish at any multiple of the true masses. The exact total fixes the multiple.
            weight = float(np.trace(normal)) / len(normal) ** 2
            normal, side = normal + weight * more["A"].T @ more["A"], side + weight * more["A"].T @ more["b"]
        lengths = np.sqrt(np.diag(normal))
        try:
            U = linalg.cholesky(normal / lengths[:, None] / lengths)
        except (linalg.LinAlgError, ValueError):
            # Some modes are alike to rounding.
            pass
        else:
            return LeastSquares(U * lengths, linalg.solve_triangular(U, side / lengths, trans="T"), **more)
    i, j = np.triu_indices(columns.shape[1], k=0 if diagonal else 1)
    return LeastSquares(pair_products(columns, diagonal=diagonal), pair_sides[i, j], **more)


def normalized(shapes: Floats, M: Floats) -> Floats:
    """Scale the columns to phi_j' M phi_j = 1 (Eq. 3); M is a vector of masses or a full matrix."""
    weighted = M[:, None] * shapes if M.ndim == 1 else M @ shapes
    return np.asarray(shapes / np.sqrt(np.sum(shapes * weighted, axis=0)))


def mass_rows(shapes: Floats, floor_mass: Floats, total: float) -> LeastSquares:
    """Write Eqs. 5 to 14: the correction dm that makes the modes orthonormal and keeps the total.

    Row (i, j): (phi_i o phi_j)' dm = delta_ij - phi_i' M phi_j, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, normalized by `floor_mass` (Eq. 3).
    floor_mass : ndarray, shape (N,)
        Masses of this iteration with added mass, kg.
    total : float
        Their known sum, kg.
    """
    missing = np.eye(shapes.shape[1]) - shapes.T @ (floor_mass[:, None] * shapes)
    return _of_pairs(shapes, missing, **_total(floor_mass, total))


def _total(at: Floats, total: float) -> dict[str, Any]:
    """State that the masses add up to the total, for their change from `at`, and name them."""
    ones = np.ones((1, len(at)))
    return {
        "A": ones,
        "b": constraints.remaining(np.array([total]), ones, at),
        "names": tuple(f"floor_mass {place}" for place in range(1, len(at) + 1)),
    }


def one_shot_rows(shapes: Floats, total: float, *, at: Floats | None = None) -> LeastSquares:
    """Write the orthogonality of the modes, linear in the masses for any scale of the modes, with the known total.

    Row (i, j): (phi_i o phi_j)' m = 0, for i < j, with sum m = total. For exact modes the masses are exact, without
    iteration.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, of any scale. Each is scaled to unit length, so that its scale has no influence.
    total : float
        Sum of the masses with added mass, kg.
    at : ndarray, shape (N,), optional
        The unknown is the change from these masses, kg. Default: zero.
    """
    unit = shapes / np.linalg.norm(shapes, axis=0)
    origin = np.zeros(len(unit)) if at is None else at
    return _of_pairs(unit, -unit.T @ (origin[:, None] * unit), diagonal=False, **_total(origin, total))


def stiffness_rows(shapes: Floats, eigenvalues: Floats) -> LeastSquares:
    """Write Eqs. 20 to 24: the stiffnesses that make the modes orthogonal, with the measured eigenvalues.

    Row (i, j): (x_i o x_j)' k = delta_ij lambda_i with the story drifts x = T' phi, for i <= j.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column per mode, mass-normalized.
    eigenvalues : ndarray, shape (m,)
        lambda = (2 pi f)^2, (rad/s)^2.
    """
    drifts = np.diff(shapes, axis=0, prepend=0.0)
    names = tuple(f"story_stiffness {place}" for place in range(1, len(drifts) + 1))
    return _of_pairs(drifts, np.diag(eigenvalues), names=names)
