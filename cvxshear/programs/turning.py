r"""The one-shot programs of frames whose floors turn: least squares with linear matrix inequalities.

The rows of the modes are phi_i' M phi_j = 0 (i < j), linear in the mass, first moments and inertia of each floor, and
phi_i' K phi_j = lambda_i delta_ij (i <= j) with the modes normalized by M, linear in the entries of each story's
symmetric matrix. Each M_i and each K_s is positive semidefinite. A row is divided by its own deviation from the noise
of the readings, to first order. A Rayleigh quotient does not change to first order, so row (i, i) of the stiffnesses
has the deviation of lambda_i and a term of second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import MOTIONS, Configuration, Experiment, Frame
from cvxshear.motions import THREE_MOTIONS, products, unit_derivatives
from cvxshear.priors import Constraints, Prior
from cvxshear.programs.certificate import MatrixInequality
from cvxshear.programs.constraints import LEAST_POSITIVE, NamedConstraints, constrained, refuse_infeasible, statements
from cvxshear.programs.least_squares import LeastSquares
from cvxshear.util import quantities
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of pairs of modes, with the noise that the readings of the shapes leave in them.

    Parameters
    ----------
    R : ndarray, shape (p, n)
        A row for each pair, without weights.
    pairs : tuple of ndarray, shape (p,)
        The two modes of each pair, from 0.
    by_reading : ndarray, shape (r, m, n)
        Derivatives of row (i, j) by reading k of mode i.
    std : ndarray, shape (m, r)
        Standard deviations of the readings.
    weights : ndarray, shape (p,)
    """

    R: Floats
    pairs: tuple[Ints, Ints]
    by_reading: Floats
    std: Floats
    weights: Floats

    @property
    def noise(self) -> Floats:
        """Expected product R'W^2 R of the noise alone, shape (n, n)."""
        found = np.zeros((self.R.shape[1], self.R.shape[1]))
        for i, j, weight in zip(*self.pairs, self.weights, strict=True):
            for first, second in {(i, j), (j, i)}:
                change = weight * self.std[first][:, None] * self.by_reading[:, second]
                found += (4.0 if i == j else 1.0) * change.T @ change
        return found

    def slopes(self, x: Floats, own: Floats | None = None) -> Floats:
        """Differentiate the weighted rows' R x by every reading over its deviation, mode by mode, shape (p, m r).

        Parameters
        ----------
        x : ndarray, shape (n,)
            With what is known beforehand, such as added mass.
        own : ndarray, shape (r, m), optional
            Change of R x of the pair (i, i) by the normalization of mode i, to be taken off.
        """
        by_reading = self.by_reading @ x
        found = np.zeros((len(self.weights), *self.std.shape))
        for row, (i, j) in enumerate(zip(*self.pairs, strict=True)):
            found[row, i] += by_reading[:, j]
            found[row, j] += by_reading[:, i]
            if own is not None and i == j:
                found[row, i] -= own[:, i]
        return np.asarray((self.weights[:, None, None] * self.std * found).reshape(len(found), -1))


@dataclass(frozen=True, eq=False)
class TurningTest:
    """One configuration of a frame that turns, with the motions of its floors in each mode.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    observation : ndarray, shape (r, 3 N)
        C: a row a sensor.
    inverse : ndarray, shape (3 N, r)
        Motions of the floors by a unit reading of each sensor, the pseudoinverse of C.
    shapes : ndarray, shape (3 N, m)
        Motions of the floors in each mode, of unit length in readings; zero for what no sensor sees.
    std : ndarray, shape (m, r)
        Standard deviations of the readings of these shapes.
    unseen : tuple of str
        Motions that no sensor sees on any floor.
    """

    experiment: Experiment
    configuration: Configuration
    observation: Floats
    inverse: Floats
    shapes: Floats
    std: Floats
    unseen: tuple[str, ...]

    @staticmethod
    def of(experiment: Experiment, configuration: Configuration, user: str) -> TurningTest:
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
            If a reading, a second mode or the total mass is missing, or the sensors do not tell the motions of a floor
            apart.
        """
        where = f'{user} cannot use configuration "{configuration.name}"'
        if experiment.frame.known_total is None:
            raise UnsuitableError(f"{where}: it needs frame: total_mass or floor_masses")
        if not configuration.sensors:
            raise UnsuitableError(f"{where}: it needs mode shapes")
        if not configuration.measured.all():
            mode, sensor = np.argwhere(~configuration.measured)[0] + 1
            raise UnsuitableError(f"{where}: it needs every reading, and mode {mode} has none of sensor {sensor}")
        if len(configuration.frequencies) < 2:
            raise UnsuitableError(f"{where}: it needs two modes, which are orthogonal")
        refuse_infeasible(experiment)
        C = configuration.sensor_rows
        seen = _seen(C, where)
        # The pseudoinverse has rounding in place of the zeros of what no sensor sees.
        inverse = np.where(np.any(C != 0, axis=0)[:, None], np.linalg.pinv(C), 0.0)
        lengths = np.linalg.norm(configuration.mode_shapes, axis=1)[:, None]
        return TurningTest(
            experiment,
            configuration,
            observation=C,
            inverse=inverse,
            shapes=inverse @ (configuration.mode_shapes / lengths).T,
            std=configuration.entry_std / lengths,
            unseen=tuple(name for name, sees in zip(MOTIONS, seen, strict=True) if not sees),
        )

    @property
    def stories(self) -> int:
        return self.experiment.stories

    @property
    def eigenvalues(self) -> Floats:
        """(2 pi f)^2 of each mode, shape (m,)."""
        return np.asarray((2 * np.pi * self.configuration.frequencies) ** 2)

    @cached_property
    def added(self) -> Floats:
        """Parameters of the added masses, shape (4 N,)."""
        mass = self.configuration.added_mass
        places = self.configuration.added_mass_position
        x, y = places.T if len(places) else np.zeros((2, self.stories))
        return np.column_stack([mass, mass * x, mass * y, mass * (x**2 + y**2)]).ravel()

    @cached_property
    def even_masses(self) -> Floats:
        """Parameters of floors with the known masses, or the total spread evenly, symmetric about their reference."""
        frame = self.experiment.frame
        assert frame.known_total is not None
        mass = np.full(self.stories, frame.known_total / self.stories)
        mass = mass if frame.floor_masses is None else frame.floor_masses
        none = np.zeros(self.stories)
        return np.column_stack([mass, none, none, mass * self.experiment.radius**2]).ravel()

    def even_stiffnesses(self, masses: Floats) -> Floats:
        """Parameters of equal symmetric stories for which the Rayleigh quotient of mode 1 is its eigenvalue."""
        one = np.ones(self.stories)
        entries = np.column_stack([one, one, self.experiment.radius**2, *np.zeros((3, self.stories))]).ravel()
        first = self.normalized(masses)[:, 0]
        quotient = float(first @ THREE_MOTIONS.stiffnesses(entries) @ first)
        return np.asarray(entries * self.eigenvalues[0] / quotient)

    def normalized(self, masses: Floats) -> Floats:
        """Scale the modes to phi' M phi = 1, with the parameters of floors without added mass."""
        M = THREE_MOTIONS.masses(masses + self.added)
        return np.asarray(self.shapes / np.sqrt(np.einsum("am,ab,bm->m", self.shapes, M, self.shapes)))

    def mass_rows(self) -> Rows:
        """Write phi_i' M phi_j for i < j, weighted by their noise at even floors."""
        pairs = np.triu_indices(self.shapes.shape[1], k=1)
        R = products(self.shapes, self.shapes, THREE_MOTIONS.mass_basis)[pairs]
        by_reading = products(self.inverse, self.shapes, THREE_MOTIONS.mass_basis)
        plain = Rows(R, pairs, by_reading, self.std, np.ones(len(R)))
        spread = np.linalg.norm(plain.slopes(self.even_masses + self.added), axis=1)
        return Rows(R, pairs, by_reading, self.std, 1.0 / spread)

    def modal(self, masses: Floats) -> Floats:
        """Compute c_k' M phi_j for the motions c_k of a unit reading and the normalized modes, shape (r, m)."""
        M = THREE_MOTIONS.masses(masses + self.added)
        return np.asarray(self.inverse.T @ M @ self.normalized(masses))

    def stiffness_rows(self, masses: Floats) -> Rows:
        """Write phi_i' K phi_j for i <= j, in modes normalized by the masses, weighted by their noise."""
        i, j = np.triu_indices(self.shapes.shape[1])
        phi = self.normalized(masses)
        drifts, basis = THREE_MOTIONS.relative(phi), THREE_MOTIONS.stiffness_basis
        by_reading = products(THREE_MOTIONS.relative(self.inverse), drifts, basis)
        std = self.std * (np.linalg.norm(phi, axis=0) / np.linalg.norm(self.shapes, axis=0))[:, None]
        # K phi_j = lambda_j M phi_j, and c' K c of a motion c is the sum over the modes of lambda (phi' M c)^2.
        along, eigenvalues = np.einsum("ik,kj->ij", std**2, self.modal(masses) ** 2), self.eigenvalues
        of_shapes = np.sqrt(along[i, j] * eigenvalues[j] ** 2 + along[j, i] * eigenvalues[i] ** 2)
        own = np.hypot(2.0 * eigenvalues * self.configuration.log_frequency_std, along @ eigenvalues)
        spread = np.where(i == j, own[i], of_shapes)
        return Rows(products(drifts, drifts, basis)[i, j], (i, j), by_reading, std, 1.0 / spread)

    def one_shot_masses(self, at: Floats | None = None) -> LeastSquares:
        """Write the masses of the floors that make the modes orthogonal; see `programs.one_shot_masses`."""
        rows, priors = self.mass_rows(), self.experiment.priors
        mass = self.even_masses[::4] if at is None else at
        known = [prior.residual(mass) for prior in priors]
        of_masses = np.concatenate([np.zeros((0, self.stories)), *(J for _, J in known)])
        soft = np.concatenate([plan_rows(self.experiment), of_masses @ np.eye(4 * self.stories)[::4]])
        sides = [np.zeros(len(soft) - len(of_masses)), *(J @ mass - r for r, J in known)]
        program = LeastSquares(
            np.concatenate([rows.R, soft]), np.concatenate([-rows.R @ self.added, *sides]),
            np.concatenate([rows.weights, np.ones(len(soft))]), names=self.names(THREE_MOTIONS.mass_names),
            title=f"one-shot masses, {self.configuration.name}",
            lmi=positive_floors(self.experiment, LEAST_POSITIVE * float(np.mean(self.even_masses[::4]))),
        )  # fmt: skip
        declared = floor_statements(self.experiment, self.experiment.frame, priors)
        return constrained(program, declared, np.zeros(program.unknowns))

    def story_stiffnesses(self, masses: Floats) -> LeastSquares:
        """Write the stiffnesses of the stories at the parameters of the floors; see `programs.story_stiffnesses`."""
        rows = self.stiffness_rows(masses)
        i, j = rows.pairs
        least = LEAST_POSITIVE * float(np.mean(masses[::4])) * float(self.eigenvalues[0])
        return LeastSquares(
            rows.R, np.where(i == j, self.eigenvalues[i], 0.0), rows.weights,
            names=self.names(THREE_MOTIONS.stiffness_names), title=f"story stiffnesses, {self.configuration.name}",
            lmi=positive_stories(self.experiment, least),
        )  # fmt: skip

    def story_equations(self, theta: Floats) -> tuple[Floats, Floats]:
        """Write the balance of every story in every mode, each row over its own deviation at theta.

        Story s carries the inertia forces of the floors above, K_s (phi_s - phi_(s-1)) = lambda sum over l >= s of
        M_l phi_l, which is linear in the parameters of floors and stories together.

        Parameters
        ----------
        theta : ndarray, shape (10 N,)

        Returns
        -------
        rows : ndarray, shape (3 N m, 10 N)
        sides : ndarray, shape (3 N m,)
            Of the added masses.
        """
        above = np.kron(np.triu(np.ones((self.stories, self.stories))), np.eye(3))
        dM, dK = unit_derivatives(THREE_MOTIONS, self.stories)
        phi, eigenvalues = self.shapes, self.eigenvalues
        rows = np.einsum("ab,pbm->map", above, dK @ phi - eigenvalues * (dM @ phi))
        added = THREE_MOTIONS.masses(self.added)
        M, K = np.tensordot(theta, dM, 1) + added, np.tensordot(theta, dK, 1)
        noise = above @ (K - eigenvalues[:, None, None] * M) @ self.inverse * self.std[:, None]
        lengths = np.linalg.norm(noise, axis=2).ravel()
        # Rows of a motion that no sensor sees have neither noise nor terms.
        weights = 1.0 / np.where(lengths > 0, lengths, np.inf)
        sides = (eigenvalues * (above @ added @ phi)).T
        return weights[:, None] * rows.reshape(len(weights), -1), weights * sides.ravel()

    def names(self, each: tuple[str, ...]) -> tuple[str, ...]:
        """Name the parameters of every floor or story."""
        return tuple(f"{name} {place}" for place in range(1, self.stories + 1) for name in each)


def turning_tests(experiment: Experiment) -> list[TurningTest]:
    """Collect every configuration with what the programs need.

    Raises
    ------
    UnsuitableError
        If no configuration has it; the message is about the first.
    """
    tests, refused = [], list[UnsuitableError]()
    for each in experiment.configurations:
        try:
            tests.append(TurningTest.of(experiment, each, "method efficient"))
        except UnsuitableError as error:
            refused.append(error)
    if not tests:
        raise refused[0]
    return tests


def floor_statements(experiment: Experiment, frame: Frame, priors: Sequence[Prior]) -> list[NamedConstraints]:
    """List the exact statements about the parameters of the floors: about masses, and mass centers in the plan."""
    n, q = experiment.stories, len(experiment.motions.mass_names)
    floors = np.eye(n * q).reshape(n, q, -1)
    found = [each.widened(experiment.of_masses, n * q) for each in statements(priors, "floor_mass", n, frame)[1:]]
    if frame.plan is not None and not experiment.symmetric:
        half = np.broadcast_to(frame.plan, (n, 2)).T[:, :, None] / 2.0
        G = np.concatenate([
            sign * floors[:, 1 + axis] - half[axis] * floors[:, 0] for axis in (0, 1) for sign in (1.0, -1.0)
        ])  # fmt: skip
        within = Constraints(G=G, h=np.zeros(len(G)))
        found.append(NamedConstraints("the mass center lies within the plan", within))
    return found


def plan_rows(experiment: Experiment, std: float | None = None) -> Floats:
    """Rows of (J - r^2 m) / (std J_even), zero of uniform floors, shape (N, q N); none without a plan or `std`."""
    frame, n, q = experiment.frame, experiment.stories, len(experiment.motions.mass_names)
    if frame.plan is None and std is None:
        return np.zeros((0, n * q))
    floors, square = np.eye(n * q).reshape(n, q, -1), experiment.radius[:, None] ** 2
    assert frame.known_total is not None, "the size of an inertia needs the mass"
    even = np.full(n, frame.known_total / n) if frame.floor_masses is None else frame.floor_masses
    return np.asarray((floors[:, -1] - square * floors[:, 0]) / ((std or frame.plan_std) * even[:, None] * square))


def positive_floors(experiment: Experiment, least: float) -> tuple[MatrixInequality, ...]:
    """State that the matrix of each floor exceeds the least mass, with rotations times the radius as motions."""
    return _positive(experiment, experiment.motions.mass_basis, "mass matrix of floor", least)


def positive_stories(experiment: Experiment, least: float) -> tuple[MatrixInequality, ...]:
    """State that the matrix of each story exceeds the least stiffness, as `positive_floors` does."""
    return _positive(experiment, experiment.motions.stiffness_basis, "stiffness matrix of story", least)


def _positive(experiment: Experiment, basis: Floats, what: str, least: float) -> tuple[MatrixInequality, ...]:
    found = []
    for place, radius in enumerate(experiment.radius):
        unit = np.array([1.0, 1.0, 1.0 / radius])
        slopes = np.zeros((experiment.stories, len(basis), 3, 3))
        slopes[place] = basis * unit[:, None] * unit
        found.append(MatrixInequality(f"{what} {place + 1}", -least * np.eye(3), slopes.reshape(-1, 3, 3)))
    return tuple(found)


def _seen(C: Floats, where: str) -> Bools:
    """Return which of the three motions the sensors see, the same on every floor."""
    of_floors = C.reshape(len(C), -1, 3)
    seen = np.any(of_floors != 0, axis=(0, 1))
    for floor in range(of_floors.shape[1]):
        if np.linalg.matrix_rank(of_floors[:, floor, seen]) < np.sum(seen):
            names = quantities.listed([name for name, sees in zip(MOTIONS, seen, strict=True) if sees])
            raise UnsuitableError(
                f"{where}: the sensors of floor {floor + 1} do not tell its motions ({names}) apart; it needs one "
                "sensor for each, at different places or in different directions"
            )
    return np.asarray(seen)
