"""Model a plane frame with displacements that are linear in coordinates; compute its matrices and its modes.

Every displacement of a node is a linear combination of named coordinates. Supports, rigid diaphragms, rigid beams and a
rocking base are therefore exact and need no penalty.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from tests.fe.elements import Floats, Section, consistent_mass, geometric_stiffness, own_axes, stiffness

Motion = dict[Hashable, float]
"""Coordinate names and their factors; empty for no motion."""


@dataclass(frozen=True)
class Node:
    """A point of the frame, m, and its displacements and anticlockwise rotation in terms of the coordinates."""

    x: float
    y: float
    ux: Motion
    uy: Motion
    turn: Motion


@dataclass
class Model:
    """Members, springs and masses between them, assembled over named coordinates."""

    coordinates: dict[Hashable, int] = field(default_factory=dict)
    _stiff: list[tuple[Floats, list[Motion]]] = field(default_factory=list)
    _heavy: list[tuple[Floats, list[Motion]]] = field(default_factory=list)

    def member(self, near: Node, far: Node, section: Section, *, compression: float = 0.0) -> None:
        """Add a beam-column between two nodes, under a compressive force, N."""
        run, rise = far.x - near.x, far.y - near.y
        length = float(np.hypot(run, rise))
        axes = own_axes(run, rise)
        motions = [near.ux, near.uy, near.turn, far.ux, far.uy, far.turn]
        local = stiffness(section, length) + geometric_stiffness(compression, length)
        self._gather(self._stiff, axes.T @ local @ axes, motions)
        if section.line_mass:
            self._gather(self._heavy, axes.T @ consistent_mass(section, length) @ axes, motions)

    def spring(self, motion: Motion, constant: float) -> None:
        """Add a spring that this motion stretches, N/m (N m/rad if the motion is a rotation)."""
        self._gather(self._stiff, np.array([[constant]]), [motion])

    def stiffness(self, matrix: Floats, motions: list[Motion]) -> None:
        """Add a stiffness matrix between these motions."""
        self._gather(self._stiff, matrix, motions)

    def mass(self, motion: Motion, amount: float) -> None:
        """Add a mass with this motion, kg (kg m2 if the motion is a rotation)."""
        self._gather(self._heavy, np.array([[amount]]), [motion])

    def _gather(self, where: list[tuple[Floats, list[Motion]]], matrix: Floats, motions: list[Motion]) -> None:
        for name in (name for motion in motions for name in motion):
            self.coordinates.setdefault(name, len(self.coordinates))
        where.append((matrix, motions))

    def matrices(self) -> tuple[Floats, Floats]:
        """Return M and K over the coordinates, each of shape (n, n)."""
        return self._sum(self._heavy), self._sum(self._stiff)

    def _sum(self, parts: list[tuple[Floats, list[Motion]]]) -> Floats:
        size = len(self.coordinates)
        total = np.zeros((size, size))
        for matrix, motions in parts:
            names = sorted({self.coordinates[name] for motion in motions for name in motion})
            C = np.zeros((len(motions), len(names)))
            for row, motion in enumerate(motions):
                for name, factor in motion.items():
                    C[row, names.index(self.coordinates[name])] += factor
            total[np.ix_(names, names)] += C.T @ matrix @ C
        return total

    def modes(self) -> tuple[Floats, Floats]:
        """Return eigenvalues, (rad/s)^2, ascending, and mass-normalized shapes, one column per mode, over the
        coordinates.

        Coordinates without mass follow the others statically, which is exact.
        """
        M, K = self.matrices()
        moving = np.flatnonzero(np.diag(M) > 0)
        still = np.flatnonzero(np.diag(M) == 0)
        follow = np.zeros((len(M), len(moving)))
        follow[moving, np.arange(len(moving))] = 1.0
        if len(still):
            follow[still] = -linalg.solve(K[np.ix_(still, still)], K[np.ix_(still, moving)], assume_a="sym")
        eigenvalues, shapes = linalg.eigh(follow.T @ K @ follow, M[np.ix_(moving, moving)])
        return eigenvalues, follow @ shapes
