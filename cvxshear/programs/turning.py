r"""The one-shot programs of frames whose floors turn: least squares with linear matrix inequalities.

The rows of the modes are phi_i' M phi_j = 0 (i < j), linear in the mass, first moments and inertia of each floor, and
phi_i' K phi_j = lambda_i delta_ij (i <= j) with the modes normalized by M, linear in the entries of each story's
symmetric matrix. Each M_i and each K_s is positive semidefinite. A row is divided by its own deviation from the noise
of the readings, to first order. A Rayleigh quotient does not change to first order, so row (i, i) of the stiffnesses
has the deviation of lambda_i and a term of second order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import MOTIONS, Configuration, Experiment
from cvxshear.motions import THREE_MOTIONS, products
from cvxshear.programs.certificate import MatrixInequality
from cvxshear.programs.constraints import LEAST_POSITIVE
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
        UnsuitableError
            If a reading or the total mass is missing, or the sensors do not tell the motions of a floor apart.
        """
        where = f'{user} cannot use configuration "{configuration.name}"'
        if experiment.frame.known_total is None:
            raise UnsuitableError(f"{where}: it needs frame: total_mass or floor_masses")
        if not configuration.sensors or not configuration.measured.all():
            what = "mode shapes"
            if configuration.sensors:
                mode, sensor = np.argwhere(~configuration.measured)[0] + 1
                what = f"every reading, and mode {mode} has none of sensor {sensor}"
            raise UnsuitableError(f"{where}: it needs {what}")
        C = np.zeros((len(configuration.sensors), 3 * experiment.stories))
        for row, sensor in zip(C, configuration.sensors, strict=True):
            row[3 * sensor.floor - 3 : 3 * sensor.floor] = sensor.row
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
    def radius(self) -> Floats:
        """Radius of gyration of each floor, shape (N,), m: of its plan, else of the places of the sensors."""
        plan = self.experiment.frame.plan
        if plan is not None:
            return np.broadcast_to(np.sqrt(np.sum(plan**2, axis=-1) / 12.0), (self.stories,))
        places = np.array([sensor.position for sensor in self.configuration.sensors])
        found = float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))
        return np.full(self.stories, found or 1.0)

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
        return np.column_stack([mass, none, none, mass * self.radius**2]).ravel()

    def even_stiffnesses(self, masses: Floats) -> Floats:
        """Parameters of equal symmetric stories for which the Rayleigh quotient of mode 1 is its eigenvalue."""
        one = np.ones(self.stories)
        entries = np.column_stack([one, one, self.radius**2, *np.zeros((3, self.stories))]).ravel()
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

    @cached_property
    def soft_rows(self) -> Floats:
        """Rows of (J - r^2 m) / (plan_std J_even) for each floor with a plan, zero if uniform, shape (0 or N, 4 N)."""
        frame, floors = self.experiment.frame, np.eye(4 * self.stories).reshape(self.stories, 4, -1)
        if frame.plan is None:
            return np.zeros((0, 4 * self.stories))
        rows = floors[:, 3] - self.radius[:, None] ** 2 * floors[:, 0]
        return np.asarray(rows / (frame.plan_std * self.even_masses[3::4, None]))

    def one_shot_masses(self) -> LeastSquares:
        """Write the masses of the floors that make the modes orthogonal; see `programs.one_shot_masses`."""
        rows, frame, n = self.mass_rows(), self.experiment.frame, 4 * self.stories
        floors = np.eye(n).reshape(self.stories, 4, n)
        mass = floors[:, 0]
        R, s, W = rows.R, -rows.R @ self.added, rows.weights
        if frame.floor_masses is not None:
            A, b, sources = mass, frame.floor_masses, ("floor_masses",) * self.stories
        else:
            assert frame.total_mass is not None
            A, b = np.sum(mass, axis=0, keepdims=True), np.array([frame.total_mass])
            sources = (f"total_mass = {frame.total_mass:g} kg",)
        G, within = np.zeros((0, n)), tuple[str, ...]()
        if frame.plan is not None:
            a, b_of_plan = np.broadcast_to(frame.plan, (self.stories, 2)).T[:, :, None] / 2.0
            x, y = floors[:, 1], floors[:, 2]
            G = np.concatenate([x - a * mass, -x - a * mass, y - b_of_plan * mass, -y - b_of_plan * mass])
            within = ("the mass center lies within the plan",) * len(G)
        soft = self.soft_rows
        R, s = np.concatenate([R, soft]), np.concatenate([s, np.zeros(len(soft))])
        W = np.concatenate([W, np.ones(len(soft))])
        least = LEAST_POSITIVE * float(np.mean(self.even_masses[::4]))
        return LeastSquares(
            R, s, W, A, b, G, np.zeros(len(G)), names=self.names(THREE_MOTIONS.mass_names),
            sources={"A": sources, "G": within}, title=f"one-shot masses, {self.configuration.name}",
            lmi=self._positive(THREE_MOTIONS.mass_basis, "mass matrix of floor", least),
        )  # fmt: skip

    def story_stiffnesses(self, masses: Floats) -> LeastSquares:
        """Write the stiffnesses of the stories at the parameters of the floors; see `programs.story_stiffnesses`."""
        rows = self.stiffness_rows(masses)
        i, j = rows.pairs
        least = LEAST_POSITIVE * float(np.mean(masses[::4])) * float(self.eigenvalues[0])
        return LeastSquares(
            rows.R, np.where(i == j, self.eigenvalues[i], 0.0), rows.weights,
            names=self.names(THREE_MOTIONS.stiffness_names), title=f"story stiffnesses, {self.configuration.name}",
            lmi=self._positive(THREE_MOTIONS.stiffness_basis, "stiffness matrix of story", least),
        )  # fmt: skip

    def names(self, each: tuple[str, ...]) -> tuple[str, ...]:
        """Name the parameters of every floor or story."""
        return tuple(f"{name} {place}" for place in range(1, self.stories + 1) for name in each)

    def _positive(self, basis: Floats, what: str, least: float) -> tuple[MatrixInequality, ...]:
        """State that each matrix exceeds a multiple of the identity, with rotations times the radius as motions."""
        found = []
        for place, radius in enumerate(self.radius):
            unit = np.array([1.0, 1.0, 1.0 / radius])
            slopes = np.zeros((self.stories, len(basis), 3, 3))
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
