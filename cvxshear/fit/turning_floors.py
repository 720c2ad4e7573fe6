"""The one-shot identification of a frame whose floors turn, with deviations and what its data leave open.

Deviations follow by linear propagation of the noise of readings and frequencies through both programs, with their
active constraints. The rows of a program hold the noise of the shapes, too: on average, R'R is the
product of the true rows plus the noise's own product N. A direction v is open where the noise is at least as large as
what the rows tell, v'R'R v <= 2 v'N v. Exact modes without eccentricity leave such directions, and noise does not hide
them. The values along them are held at even floors and stories, and are not reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import State
from cvxshear.fit.domain import null_space
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.results import IdentifiedFrame, SingleIdentification, predictions, priced, quality
from cvxshear.measurement.experiment import Experiment
from cvxshear.motions import THREE_MOTIONS, blocks, center, center_slopes, products
from cvxshear.programs import ActiveConstraint, LeastSquares, Solution
from cvxshear.programs.turning import Rows, TurningTest, turning_tests
from cvxshear.util.quantities import NEGLIGIBLE_STD
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class TurningFrame(IdentifiedFrame):
    """Floors and stories of a frame that turns; nan where the data do not determine a value.

    Parameters
    ----------
    floor_mass : ndarray, shape (N,)
        kg, without added mass.
    mass_center : ndarray, shape (N, 2)
        x and y of each floor's mass center, m.
    inertia : ndarray, shape (N,)
        Polar inertia about the mass center, kg m2.
    story_stiffness : ndarray, shape (N, 3, 3)
        For motions in x, y and rotation at the reference point, N/m, N and N m.
    stiffness_center : ndarray, shape (N, 2)
        x and y of each story's center of stiffness, m: a force there does not turn the floor above.
    floor_mass_std, mass_center_std, inertia_std, story_stiffness_std, stiffness_center_std : ndarray
        Standard deviations, of the same shapes.
    unseen : tuple of str
        Motions that no sensor sees; the floors are taken as symmetric, so that these are not coupled to the others.
    undetermined : tuple of tuple of str
        Groups of values that the data leave open together.
    """

    mass_center: Floats
    inertia: Floats
    stiffness_center: Floats
    mass_center_std: Floats
    inertia_std: Floats
    stiffness_center_std: Floats
    unseen: tuple[str, ...] = ()
    undetermined: tuple[tuple[str, ...], ...] = ()

    json_keys = (
        "floor_mass floor_mass_std mass_center mass_center_std inertia inertia_std story_stiffness story_stiffness_std "
        "stiffness_center stiffness_center_std unseen undetermined"
    )

    @property
    def columns(self) -> Iterator[tuple[str, str, Floats, Floats]]:
        """Name, unit, values and deviations of each quantity with one number for each floor or story, shape (N,).

        Coordinates and coupled entries that are zero but for rounding are zero.
        """
        mass, stiffness, inertia = (
            float(np.max(np.nan_to_num(each), initial=0.0))
            for each in (self.floor_mass, self.story_stiffness, self.inertia)
        )
        radius = float(np.sqrt(inertia / mass)) if inertia and mass else 1.0
        sizes = {"kg": mass, "m": radius, "kg m2": mass * radius**2}
        sizes |= {"N/m": stiffness, "N": stiffness * radius, "N m": stiffness * radius**2}
        for name, unit, *columns in self._columns():
            values, std = (np.where(np.abs(each) < NEGLIGIBLE_STD * sizes[unit], 0.0, each) for each in columns)
            yield name, unit, values, std

    def _columns(self) -> Iterator[tuple[str, str, Floats, Floats]]:
        yield "floor_mass", "kg", self.floor_mass, self.floor_mass_std
        for place, axis in enumerate("xy"):
            yield f"mass_center_{axis}", "m", self.mass_center[:, place], self.mass_center_std[:, place]
        yield "inertia", "kg m2", self.inertia, self.inertia_std
        for name, (row, column) in zip(THREE_MOTIONS.stiffness_names, ENTRIES, strict=True):
            unit = ("N/m", "N", "N m")[(row, column).count(2)]
            values, std = (each[:, row, column] for each in (self.story_stiffness, self.story_stiffness_std))
            yield name.replace(" ", "_"), unit, values, std
        for place, axis in enumerate("xy"):
            yield f"stiffness_center_{axis}", "m", self.stiffness_center[:, place], self.stiffness_center_std[:, place]


#: Row and column of the entries xx, yy, rr, xy, xr and yr of a story's matrix.
ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class HeldProgram:
    """A solved program, with its response to noise and the directions that it leaves open.

    Parameters
    ----------
    solution : Solution
    response : ndarray, shape (n, r)
        H: change of the solution by a change of the weighted right side.
    open : ndarray, shape (n, k)
    """

    solution: Solution
    response: Floats
    open: Floats

    @staticmethod
    def of(program: LeastSquares, rows: Rows, at: Floats, unit: Floats, backend: Backend) -> HeldProgram:
        """Solve a program with its open directions held.

        Parameters
        ----------
        program : LeastSquares
        rows : Rows
            Of the modes, the first of the program.
        at : ndarray, shape (n,)
            Values along the open directions.
        unit : ndarray, shape (n,)
            Sizes of the unknowns.
        backend : Backend
        """
        R, s = program.weighted
        A, _ = program.equalities
        free = null_space(A * unit)
        signal, noise = (free.T @ (unit[:, None] * each * unit) @ free for each in (R.T @ R, rows.noise))
        # Neither rows nor noise tell of a motion that no sensor sees.
        rounding = len(signal) * np.finfo(float).eps * float(np.trace(signal)) * np.eye(len(signal))
        share, found = linalg.eigh(noise + rounding, signal + noise + rounding)
        directions = linalg.orth(free @ found[:, share >= 1.0 / 3.0])
        # Rows as heavy as all others together. Equalities would have multipliers of rounding alone.
        heavy = np.linalg.norm(R * unit) * directions.T / unit
        held = program.replace(R=np.concatenate([R, heavy]), s=np.concatenate([s, heavy @ at]), W=None)
        solution = backend.solve(held)
        fixed = null_space(np.concatenate([A, directions.T / unit, _active(solution)]) * unit)
        response = unit[:, None] * (fixed @ np.linalg.pinv(R @ (unit[:, None] * fixed)))
        return HeldProgram(solution, response, unit[:, None] * directions)


def _active(solution: Solution) -> Floats:
    """Collect the rows of active inequalities; a singular matrix stays so to first order, shape (c, n)."""
    program, rows = solution.program, [np.zeros((0, solution.program.unknowns))]
    for each in solution.active:
        if each.constraint == "G" and program.G is not None:
            rows.append(program.G[each.index : each.index + 1])
        if each.constraint in ("lower", "upper"):
            rows.append(np.eye(program.unknowns)[each.index : each.index + 1])
        if each.constraint == "lmi":
            inequality = program.lmi[each.index]
            _, vectors = np.linalg.eigh(inequality.at(solution.x))
            rows.append(inequality.products(np.outer(vectors[:, 0], vectors[:, 0]))[None])
    return np.concatenate(rows)


@dataclass(frozen=True, eq=False)
class OneShot:
    """The one-shot solution of one configuration.

    Parameters
    ----------
    theta : ndarray, shape (10 N,)
        Parameters of the floors, then of the stories.
    spread : ndarray, shape (10 N, d)
        Their change by one deviation of each datum; its product with its transpose is the covariance.
    open : ndarray, shape (10 N, k)
        Directions that the data leave open.
    active : tuple of ActiveConstraint
    """

    theta: Floats
    spread: Floats
    open: Floats
    active: tuple[ActiveConstraint, ...]

    @staticmethod
    def of(test: TurningTest, backend: Backend) -> OneShot:
        """Identify floors from the orthogonality of the modes and the total mass, then stories, without iteration."""
        experiment, even = test.experiment, test.even_masses
        units = experiment.units(1.0, 1.0)
        unit = float(np.mean(even[::4])) * units[experiment.of_floors]
        of_floors = HeldProgram.of(test.one_shot_masses(), test.mass_rows(), even, unit, backend)
        masses = of_floors.solution.x
        even = test.even_stiffnesses(masses)
        unit = even[0] * units[experiment.of_stories]
        of_stories = HeldProgram.of(test.story_stiffnesses(masses), test.stiffness_rows(masses), even, unit, backend)
        active = priced([*of_floors.solution.active, *of_stories.solution.active])
        theta = np.concatenate([masses, of_stories.solution.x])
        return OneShot(theta, *_propagated(test, of_floors, of_stories), active)


def one_shot_turning(test: TurningTest, backend: Backend) -> SingleIdentification:
    """Identify a frame whose floors turn from one configuration, without iteration."""
    found, experiment = OneShot.of(test, backend), test.experiment
    frame = reported(experiment, found.theta, found.spread, found.open, test.unseen)
    declared = replace(experiment.frame, reference=None)
    misfit = Misfit(replace(experiment, frame=declared, configurations=(test.configuration,)))
    at = misfit.evaluate(found.theta, derivatives=False)
    free = len(found.theta) - found.open.shape[1]
    free -= test.stories if experiment.frame.floor_masses is not None else 1
    dof, noise_declared = misfit.count(found.theta) - free, test.configuration.noise_declared
    fit = quality(misfit.data, at.models, at.chi2, dof, declared=noise_declared)
    return SingleIdentification(test.configuration.name, 1, frame, fit, predictions(at.models), active=found.active)


def one_shot_open(experiment: Experiment) -> Floats:
    """Find the directions that every one-shot solution leaves open: those of the one with the fewest, (10 N, k)."""
    found = [OneShot.of(test, backends.get("auto")).open for test in turning_tests(experiment)]
    return min(found, key=lambda each: each.shape[1])


def _propagated(test: TurningTest, of_floors: HeldProgram, of_stories: HeldProgram) -> tuple[Floats, Floats]:
    """Return the change of all parameters by each reading, soft prior and frequency, and their open directions."""
    masses, stiffnesses = of_floors.solution.x, of_stories.solution.x
    by_readings = test.mass_rows().slopes(masses + test.added)
    soft = of_floors.response.shape[1] - len(by_readings)
    floors = -of_floors.response @ linalg.block_diag(by_readings, np.eye(soft))
    rows, eigenvalues = test.stiffness_rows(masses), test.eigenvalues
    i, j = rows.pairs
    phi = test.normalized(masses)
    stories = rows.slopes(stiffnesses, own=2.0 * eigenvalues * test.modal(masses))
    # Heavier floors scale a mode down: phi' K phi changes by -lambda phi' dM phi, and stays on the diagonal.
    own = np.flatnonzero(i == j)
    by_masses, by_frequencies = np.zeros((len(i), len(masses))), np.zeros((len(i), len(eigenvalues)))
    scaled = rows.weights[own, None] * eigenvalues[:, None]
    by_masses[own] = -scaled * products(phi, phi, THREE_MOTIONS.mass_basis)[i[own], j[own]]
    by_frequencies[own] = -2.0 * scaled * np.diag(test.configuration.log_frequency_std)
    changes = np.hstack([stories, np.zeros((len(i), soft))]) + by_masses @ floors
    changes = -of_stories.response @ np.hstack([changes, by_frequencies])
    spread = np.vstack([np.hstack([floors, np.zeros((len(masses), len(eigenvalues)))]), changes])
    own_stories = np.vstack([np.zeros((len(masses), of_stories.open.shape[1])), of_stories.open])
    from_floors = np.vstack([of_floors.open, -of_stories.response @ by_masses @ of_floors.open])
    return spread, np.hstack([from_floors, own_stories])


def general_parameters(state: State) -> tuple[Floats, Floats]:
    """Read the parameters of `THREE_MOTIONS` off a state without added mass.

    Returns
    -------
    theta : ndarray, shape (10 N,)
    slopes : ndarray, shape (10 N, P)
        By the parameters of the fit.
    """
    n, system = state.experiment.stories, state.system
    at = 3 * np.arange(n)
    floors, d_floors = (
        np.stack([M[..., at, at], M[..., at + 1, at + 2], -M[..., at, at + 2], M[..., at + 2, at + 2]], axis=-1)
        for M in (system.M, system.dM)
    )
    slopes = np.hstack([d_floors.reshape(len(d_floors), -1), state.d_story_stiffness])
    return np.concatenate([floors.ravel(), state.story_stiffness]), slopes.T


def reported(
    experiment: Experiment, theta: Floats, spread: Floats, directions: Floats, unseen: tuple[str, ...]
) -> TurningFrame:
    """Turn parameters to masses, centers, inertias and matrices, with deviations; nan for what is open.

    Parameters
    ----------
    experiment : Experiment
    theta : ndarray, shape (10 N,)
    spread : ndarray, shape (10 N, d)
        Its product with its transpose is the covariance.
    directions : ndarray, shape (10 N, k)
        What the data leave open.
    unseen : tuple of str
        Motions that no sensor sees.
    """
    n, radius = experiment.stories, experiment.radius[:, None]
    masses, stiffnesses = theta[: 4 * n], theta[4 * n :]
    mass_blocks, story_blocks = (
        blocks(masses, THREE_MOTIONS.mass_basis),
        blocks(stiffnesses, THREE_MOTIONS.stiffness_basis),
    )
    mass_center, inertia = center(mass_blocks)
    stiffness_center, _ = center(story_blocks)
    entries, none = stiffnesses.reshape(n, 6), np.zeros((n, 1))
    # A value near zero counts by the size of the others: its own would hide what else a direction moves.
    mass, inertia_size = (np.maximum(each, each.mean())[:, None] for each in (masses[::4], inertia))
    diagonal = np.maximum(entries[:, :3], entries[:, :3].mean(axis=0))
    level = np.sqrt(diagonal[:, :1] * diagonal[:, 1:2])
    values = np.hstack([masses[::4, None], mass_center, inertia[:, None], entries, stiffness_center])
    sizes = np.hstack([
        mass, radius + none, radius + none, inertia_size, diagonal, level, level * radius, level * radius,
        radius + none, radius + none,
    ])  # fmt: skip
    by_mass = center_slopes(mass_blocks, THREE_MOTIONS.mass_basis)
    slopes = np.zeros((n, 12, 10))
    slopes[:, 0, 0] = 1.0
    slopes[:, 1:3, :4], slopes[:, 3, :4] = by_mass
    slopes[:, 4:10, 4:] = np.eye(6)
    slopes[:, 10:, 4:] = center_slopes(story_blocks, THREE_MOTIONS.stiffness_basis)[0]

    def changed(by: Floats) -> Floats:
        floors, stories = by[: 4 * n].reshape(n, 4, by.shape[1]), by[4 * n :].reshape(n, 6, by.shape[1])
        return np.asarray(slopes @ np.concatenate([floors, stories], axis=1))

    std = np.linalg.norm(changed(spread), axis=2)
    groups, left_open = open_groups(changed(directions) / sizes[:, :, None], std / sizes)
    known, known_std = np.where(left_open, np.nan, values), np.where(left_open, np.nan, std)
    matrices, matrices_std = _matrices(known[:, 4:10]), _matrices(known_std[:, 4:10])
    return TurningFrame(
        known[:, 0], matrices, known_std[:, 0], matrices_std,
        mass_center=known[:, 1:3], inertia=known[:, 3], stiffness_center=known[:, 10:],
        mass_center_std=known_std[:, 1:3], inertia_std=known_std[:, 3], stiffness_center_std=known_std[:, 10:],
        unseen=unseen, undetermined=groups,
    )  # fmt: skip


def _matrices(entries: Floats) -> Floats:
    """Write the entries xx, yy, rr, xy, xr and yr of each story as a matrix, shape (N, 3, 3)."""
    return np.asarray(entries[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]])


#: Names of the reported values of each floor and story.
VALUE_NAMES = (
    "floor_mass", "mass_center_x", "mass_center_y", "inertia", *THREE_MOTIONS.stiffness_names, "stiffness_center_x",
    "stiffness_center_y",
)  # fmt: skip


def open_groups(changes: Floats, std: Floats) -> tuple[tuple[tuple[str, ...], ...], Floats]:
    """Group the values that open directions move together.

    A direction is scaled so that its largest relative change is 1. A value takes part if its change is nearer to 1 than
    to its own relative deviation, on a logarithmic scale.

    Parameters
    ----------
    changes : ndarray, shape (N, v, k)
        Relative changes of the values along each direction.
    std : ndarray, shape (N, v)
        Relative deviations.

    Returns
    -------
    groups : tuple of tuple of str
        Names of values and numbers of floors, such as "inertia 1".
    left_open : ndarray of bool, shape (N, v)
    """
    largest = np.max(np.abs(changes), axis=(0, 1), initial=0.0)
    part = np.abs(changes) / largest >= np.sqrt(np.clip(std, np.finfo(float).eps, 1.0))[:, :, None]
    groups: list[Floats] = []
    for each in np.moveaxis(part, 2, 0):
        joined = np.any([each, *(other for other in groups if np.any(other & each))], axis=0)
        groups = [*(other for other in groups if not np.any(other & each)), joined]
    return (
        tuple(
            tuple(f"{VALUE_NAMES[value]} {floor + 1}" for value, floor in np.argwhere(each.T).tolist())
            for each in groups
        ),
        np.any(part, axis=2),
    )
