"""Frames in space: beams, columns and braces on floors that are rigid in their plane, assembled member by member.

The model of the IASC-ASCE benchmark, phase I, is one of them: 3 coordinates a floor, and the rise and two rotations of
each of its 9 joints, 120 in all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy import linalg

from cvxshear import Experiment
from tests.fe.elements import Floats, hermite, integral, linear
from tests.fe.model import Model, Motion


@dataclass(frozen=True)
class Bar:
    """Cross section of a member in space, including its material.

    It has EA, N; EI for displacements along the second and the third axis of the member, N m2; GJ, N m2; and kg/m.
    """

    axial: float
    bending: tuple[float, float] = (0.0, 0.0)
    torsion: float = 0.0
    line_mass: float = 0.0


def bar_stiffness(bar: Bar, near: Floats, far: Floats, second: Floats, hinged: bool = False) -> Floats:
    """Return the stiffness for displacements and rotations (x, y, z each) of both ends, shape (12, 12).

    `second` is a unit vector across the member. The near end of a hinged member carries no moments.
    """
    length = float(np.linalg.norm(far - near))
    first = (far - near) / length
    axes = np.array([first, second, np.cross(first, second)])
    own = np.zeros((12, 12))
    stretch, bend = integral(linear, 1, length), integral(hermite, 2, length)
    own[np.ix_([0, 6], [0, 6])] = bar.axial * stretch
    own[np.ix_([3, 9], [3, 9])] = bar.torsion * stretch
    own[np.ix_([1, 5, 7, 11], [1, 5, 7, 11])] = bar.bending[0] * bend
    # A rotation about the second axis lowers the third displacement.
    turned = np.array([1.0, -1.0, 1.0, -1.0])
    own[np.ix_([2, 4, 8, 10], [2, 4, 8, 10])] = bar.bending[1] * bend * np.outer(turned, turned)
    if hinged:
        free, kept = [3, 4, 5], [0, 1, 2, 6, 7, 8, 9, 10, 11]
        follow = np.linalg.solve(own[np.ix_(free, free)], own[np.ix_(free, kept)])
        held = own[np.ix_(kept, kept)] - own[np.ix_(kept, free)] @ follow
        own = np.zeros((12, 12))
        own[np.ix_(kept, kept)] = held
    turn = np.kron(np.eye(4), axes)
    return np.asarray(turn.T @ own @ turn)


UP = np.array([0.0, 0.0, 1.0])
ALONG_X = np.array([1.0, 0.0, 0.0])

Place = tuple[int, float, float]
"""Floor, 0 for the ground, and x and y from the center of the plan, m."""


@dataclass
class SpaceFrame:
    """Members between joints of floors that are rigid in their plane; each story has this height, m.

    Coordinates ("x", i), ("y", i) and ("rotation", i) move floor i at the center of its plan. If `upright`, joints
    neither rise nor turn about x and y: floors and beams are rigid.
    """

    height: float
    stories: int
    upright: bool = False
    model: Model = field(default_factory=Model)

    def joint(self, place: Place) -> list[Motion]:
        """Return displacements and rotations of a joint, x, y and z each."""
        floor, x, y = place
        if floor == 0:
            return [{}] * 6
        across = {("x", floor): 1.0, ("rotation", floor): -y}, {("y", floor): 1.0, ("rotation", floor): x}
        free = [{} if self.upright else {(kind, *place): 1.0} for kind in ("rise", "turn x", "turn y")]
        return [*across, *free, {("rotation", floor): 1.0}]

    def lay(
        self, near: Place, far: Place, bar: Bar, second: Floats = UP, *, left: float = 1.0, hinged: bool = False
    ) -> None:
        """Add a member with its mass at its ends; damage leaves a part of its stiffness."""
        ends = [np.array([x, y, floor * self.height]) for floor, x, y in (near, far)]
        motions = [*self.joint(near), *self.joint(far)]
        self.model.stiffness(left * bar_stiffness(bar, *ends, second, hinged), motions)
        half = 0.5 * bar.line_mass * float(linalg.norm(ends[1] - ends[0]))
        for motion in (*motions[:3], *motions[6:9]):
            self.model.mass(motion, half)

    def load(self, place: Place, mass: float, inertia: float = 0.0) -> None:
        """Add a mass that moves in the plane of its floor, with an inertia about its own center."""
        x, y, *_, turn = self.joint(place)
        for motion, amount in ((x, mass), (y, mass), (turn, inertia)):
            self.model.mass(motion, amount)

    def experiment(
        self, sides: tuple[float, float], noise: float = 0.0, seed: int = 0, std: float = 0.01, **frame: object
    ) -> Experiment:
        """Measure the lowest modes, three a floor, entries off by `noise` of the largest, frequencies by a fifth.

        Each floor has two sensors of each direction, at the middle of its sides. `std` is declared for the entries, a
        fifth of it for the frequencies.
        """
        rng = np.random.default_rng(seed)
        a, b = 0.5 * sides[0], 0.5 * sides[1]
        places = (([0.0, -b], 0.0), ([0.0, b], 0.0), ([-a, 0.0], 90.0), ([a, 0.0], 90.0))
        sensors, rows, modes = [], [], 3 * self.stories
        eigenvalues, vectors = self.model.modes()
        for floor in range(1, self.stories + 1):
            for place, direction in places:
                sensors.append({"floor": floor, "position": place, "direction": direction})
                motion = self.joint((floor, *place))[round(direction / 90)]
                rows.append(sum(part * vectors[self.model.coordinates[name], :modes] for name, part in motion.items()))
        shapes = np.array(rows).T
        shapes += noise * np.max(np.abs(shapes), axis=1, keepdims=True) * rng.standard_normal(shapes.shape)
        frequencies = np.sqrt(eigenvalues[:modes]) / (2 * np.pi) * (1 + 0.2 * noise * rng.standard_normal(modes))
        order = np.argsort(frequencies)
        tested = {
            "name": "test", "frequencies": frequencies[order], "mode_shapes": shapes[order], "sensors": sensors,
            "mode_shape_std": std, "frequency_std": 0.2 * std,
        }  # fmt: skip
        return Experiment.from_dict({"frame": {"motions": ["x", "y", "rotation"], **frame}, "configuration": [tested]})


SIDE = 1.25
"""Length of a bay of the benchmark, m; two bays a direction."""
YOUNG, SHEAR, DENSITY = 200e9, 200e9 / 2.6, 7800.0
COLUMN = Bar(YOUNG * 1.133e-3, (YOUNG * 1.97e-6, YOUNG * 0.664e-6), SHEAR * 8.01e-9, DENSITY * 1.133e-3)
BEAM = Bar(YOUNG * 1.43e-3, (YOUNG * 1.22e-6, YOUNG * 0.249e-6), SHEAR * 3.82e-8, DENSITY * 1.43e-3)
BRACE = Bar(YOUNG * 0.141e-3, line_mass=DENSITY * 0.141e-3)
SLABS = (800.0, 600.0, 600.0, 400.0)
HEAVY_SLAB = 550.0
"""Slab of the roof at negative x and y in the asymmetric cases, kg."""
BRACE_OF_3 = ((0, SIDE, -SIDE), (1, SIDE, 0.0))
BRACE_OF_4 = ((2, SIDE, -SIDE), (3, 0.0, -SIDE))
LOOSE_BEAM = ((1, 0.0, -SIDE), (1, 0.0, 0.0))
"""The beam of pattern 5, its loose end first."""


def iasc_asce(pattern: int = 0, *, heavy_slab: bool = True, rigid: bool = False) -> SpaceFrame:
    """Build the benchmark of the IASC-ASCE task group, phase I: 12 degrees of freedom if `rigid`, otherwise 120.

    The patterns of damage are 0 to 6. In cases 4 (`rigid`) and 5 one slab of the roof weighs 550 kg.
    """
    frame = SpaceFrame(0.9, 4, upright=rigid)
    grid, edges = (-SIDE, 0.0, SIDE), (-SIDE, SIDE)
    for story, slab in enumerate(SLABS, 1):
        for x, y in product(grid, grid):
            frame.lay((story - 1, x, y), (story, x, y), COLUMN, ALONG_X)
        for at, start in product(grid, grid[:2]):
            along_y = (story, at, start), (story, at, start + SIDE)
            frame.lay(*along_y, BEAM, hinged=pattern == 5 and along_y == LOOSE_BEAM)
            frame.lay((story, start, at), (story, start + SIDE, at), BEAM)
        for edge, corner in product(edges, edges):
            for foot, head in (((corner, edge), (0.0, edge)), ((edge, corner), (edge, 0.0))):
                brace = (story - 1, *foot), (story, *head)
                frame.lay(*brace, BRACE, left=left(brace, pattern))
        for x, y in product(edges, edges):
            mass = HEAVY_SLAB if heavy_slab and story == 4 and x < 0 and y < 0 else slab
            frame.load((story, x / 2, y / 2), mass, mass * 2 * SIDE**2 / 12)
    return frame


def left(brace: tuple[Place, Place], pattern: int) -> float:
    """Return the part of a brace's stiffness that a pattern leaves."""
    if (pattern in (1, 2) and brace[1][0] == 1) or (pattern == 2 and brace[1][0] == 3):
        return 0.0
    if brace == BRACE_OF_3:
        return {3: 0.0, 4: 0.0, 5: 0.0, 6: 2 / 3}.get(pattern, 1.0)
    return 0.0 if pattern in (4, 5) and brace == BRACE_OF_4 else 1.0


WALLED_PLAN = (12.0, 9.0)
MACHINE = ((1, -4.0, 3.0), 30e3)
"""Place and mass, kg, of what stands on floor 1 of `walled`."""


def walled() -> SpaceFrame:
    """Build three stories of concrete columns and beams, with a wall of 1.2 m along y amid the side x = 6 m.

    Each floor has slabs of 400 kg/m2 in four quadrants; a machine of 30 t stands on floor 1, off its center.
    """
    young, shear, density = 30e9, 12.5e9, 2500.0
    frame = SpaceFrame(3.5, 3)
    column = Bar(young * 0.25, (young * 5.2e-3, young * 5.2e-3), shear * 8.8e-3, density * 0.25)
    beam = Bar(young * 0.24, (young * 12.8e-3, young * 1.8e-3), shear * 5e-3, density * 0.24)
    wall = Bar(young * 0.24, (young * 0.8e-3, young * 28.8e-3), shear * 3e-3, density * 0.24)
    a, b = WALLED_PLAN[0] / 2, WALLED_PLAN[1] / 2
    for story in (1, 2, 3):
        for x, y in product((-a, 0.0, a), (-b, 0.0, b)):
            frame.lay((story - 1, x, y), (story, x, y), wall if (x, y) == (a, 0.0) else column, ALONG_X)
        for x, y in product((-a, 0.0, a), (-b, 0.0)):
            frame.lay((story, x, y), (story, x, y + b), beam)
        for x, y in product((-a, 0.0), (-b, 0.0, b)):
            frame.lay((story, x, y), (story, x + a, y), beam)
        for x, y in product((-a / 2, a / 2), (-b / 2, b / 2)):
            frame.load((story, x, y), 400.0 * a * b, 400.0 * a * b * (a**2 + b**2) / 12)
    frame.load(*MACHINE)
    return frame
