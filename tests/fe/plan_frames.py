"""Frames of columns at places of the plan, on rigid floors that carry point masses; assembled member by member.

Nothing here knows of a 3 x 3 matrix of a floor or a story: each column is two springs between the places where it meets
its floors, and each mass has the kinetic energy of its own place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

import cvxshear

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlanFrame:
    """A frame of rigid floors with a plan of two sizes, m.

    Each story has columns, rows of x, y, stiffness along and across an axis, N/m, and the angle of that axis from x.
    Each floor has weights, rows of x, y and kg.
    """

    plan: tuple[float, float]
    columns: list[Floats]
    weights: list[Floats]

    @property
    def stories(self) -> int:
        return len(self.columns)

    def place(self, floor: int, x: float, y: float) -> Floats:
        """Return the rows that turn motions of all floors into the displacement of a place, shape (2, 3 N)."""
        rows = np.zeros((2, 3 * self.stories))
        if floor >= 0:
            rows[:, 3 * floor : 3 * floor + 3] = [[1.0, 0.0, -y], [0.0, 1.0, x]]
        return rows

    @property
    def matrices(self) -> tuple[Floats, Floats]:
        n = 3 * self.stories
        M, K = np.zeros((n, n)), np.zeros((n, n))
        for floor, weights in enumerate(self.weights):
            for x, y, mass in weights:
                rows = self.place(floor, x, y)
                M += mass * rows.T @ rows
        for story, columns in enumerate(self.columns):
            for x, y, along, across, angle in columns:
                drift = self.place(story, x, y) - self.place(story - 1, x, y)
                axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
                K += drift.T @ axes.T @ np.diag([along, across]) @ axes @ drift
        return M, K

    @property
    def floor_mass(self) -> Floats:
        return np.array([weights[:, 2].sum() for weights in self.weights])

    @property
    def mass_center(self) -> Floats:
        return np.array([np.average(weights[:, :2], axis=0, weights=weights[:, 2]) for weights in self.weights])

    @property
    def inertia(self) -> Floats:
        """Polar inertia about each floor's own mass center, kg m2."""
        return np.array(
            [
                np.sum(weights[:, 2] * np.sum((weights[:, :2] - center) ** 2, axis=1))
                for weights, center in zip(self.weights, self.mass_center, strict=True)
            ]
        )

    def story(self, story: int) -> Floats:
        """Return the forces and the moment on a unit motion of one floor above fixed ground, shape (3, 3)."""
        alone = PlanFrame(self.plan, [self.columns[story]], [self.weights[story]])
        return alone.matrices[1]

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """Return mass, first moments and inertia of each floor, and entries xx, yy, rr, xy, xr, yr of each story."""
        moments = self.floor_mass[:, None] * self.mass_center
        inertia = self.inertia + self.floor_mass * np.sum(self.mass_center**2, axis=1)
        stories = [self.story(story) for story in range(self.stories)]
        entries = [[K[0, 0], K[1, 1], K[2, 2], K[0, 1], K[0, 2], K[1, 2]] for K in stories]
        return np.column_stack([self.floor_mass, moments, inertia]).ravel(), np.ravel(entries)

    def sensors(self, directions: tuple[float, ...] = (0.0, 90.0, 0.0)) -> list[dict[str, object]]:
        """Return three sensors a floor, two at a corner and one at the opposite corner."""
        a, b = 0.5 * self.plan[0], 0.5 * self.plan[1]
        places = ([a, b], [a, b], [-a, -b])
        return [
            {"floor": floor, "position": place, "direction": direction}
            for floor in range(1, self.stories + 1)
            for place, direction in zip(places, directions, strict=True)
        ]

    def experiment(
        self, modes: int | None = None, noise: float = 0.0, seed: int = 0, *, plan: bool = False, std: float = 1e-6,
        **configuration: object,
    ) -> cvxshear.Experiment:  # fmt: skip
        """Measure the lowest modes, entries off by `noise` of the largest, frequencies by a fifth of that."""
        rng = np.random.default_rng(seed)
        values, vectors = linalg.eigh(self.matrices[1], self.matrices[0])
        sensors = configuration.get("sensors", self.sensors())
        rows = []
        for sensor in sensors:
            angle = np.deg2rad(sensor["direction"])
            place = self.place(sensor["floor"] - 1, *sensor["position"])
            rows.append(np.cos(angle) * place[0] + np.sin(angle) * place[1])
        shapes = (np.array(rows) @ vectors[:, :modes]).T
        shapes *= 1.0 + 3.0 * rng.random((len(shapes), 1))
        shapes += noise * np.max(np.abs(shapes), axis=1, keepdims=True) * rng.standard_normal(shapes.shape)
        frequencies = np.sqrt(values[:modes]) / (2 * np.pi)
        frequencies *= 1.0 + 0.2 * noise * rng.standard_normal(len(frequencies))
        order = np.argsort(frequencies)
        tested = {
            "name": "test", "frequencies": frequencies[order], "mode_shapes": shapes[order], "sensors": sensors,
            "mode_shape_std": std, "frequency_std": 0.2 * std, **configuration,
        }  # fmt: skip
        frame = {"motions": ["x", "y", "rotation"], "total_mass": self.floor_mass.sum()}
        return cvxshear.Experiment.from_dict(
            {"frame": frame | ({"plan": list(self.plan)} if plan else {}), "configuration": [tested]}
        )


def random_frame(stories: int, seed: int, *, symmetric: bool = False) -> PlanFrame:
    """Draw a frame of nine columns and two walls a story; its masses and walls are eccentric unless `symmetric`."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(8.0, 16.0), rng.uniform(6.0, 12.0)
    grid = np.array([[x, y] for x in (-a / 2, 0.0, a / 2) for y in (-b / 2, 0.0, b / 2)])
    columns, weights = [], []
    for _ in range(stories):
        stiffness = rng.uniform(2e6, 6e6, 2) * np.ones((9, 2)) * (1.0 if symmetric else rng.uniform(0.5, 1.5, (9, 2)))
        placed = np.column_stack([grid, stiffness, np.zeros(9)])
        if not symmetric:
            wall = [0.4 * a, rng.uniform(-0.3, 0.3) * b, rng.uniform(1e7, 3e7), 1e5, rng.uniform(0.0, np.pi)]
            placed = np.vstack([placed, wall])
        columns.append(placed)
        mass = rng.uniform(2e3, 4e3) * np.ones(9) * (1.0 if symmetric else rng.uniform(0.3, 1.7, 9))
        weights.append(np.column_stack([grid, mass]))
    return PlanFrame((a, b), columns, weights)
