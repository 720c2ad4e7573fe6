"""A multi-story plane frame of columns and beams, and its sway modes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tests.fe.elements import Floats, Section
from tests.fe.model import Model, Motion, Node

RIGID = np.inf
LEAST_IN_SWAY = 0.6
"""Smallest share of a sway mode's kinetic energy in sway. If two modes share one motion evenly, it is one half."""


@dataclass(frozen=True, eq=False)
class Building:
    """A frame of n stories; parts left at their defaults are rigid, fixed or absent: a shear frame. Units: m, N, kg."""

    heights: Floats
    story_stiffness: Floats
    """12 EI / h^3, summed over a story's columns. The columns' EI follows from it."""
    floor_mass: Floats
    """All mass that moves with a floor: added mass, and half the columns of either adjoining story."""
    column_x: tuple[float, ...] = (-0.25, 0.25)
    """Positions of the columns; at least two."""
    column_share: tuple[float, ...] = ()
    """The columns' shares of each story's stiffness, of its own mass and of the weight; equal if empty."""
    beam_bending: Floats | None = None
    """EI of a floor's beams, the same in every bay."""
    column_axial: Floats | None = None
    """EA of each column of a story."""
    rocking_stiffness: float = RIGID
    column_base: float = RIGID
    """Stiffness of the spring under each column's foot; 0 is a hinge."""
    ground_springs: Mapping[int, float] = field(default_factory=dict)
    column_mass: float = 0.0
    """Mass of all columns of one story, the same in every story."""
    gravity: float = 0.0
    on_frame: float = 1.0
    """Part of the weight on the frame's own columns. The rest stands on rigid props that lean with the floors."""
    vertical_inertia: bool = False
    """Whether floor masses also move up and down, distributed over the joints like the columns' shares."""
    pieces: int = 1
    """Number of elements per column."""
    connections: Mapping[int, float] = field(default_factory=dict)
    """For a floor: the spring between each column and the floor's beams."""
    ties: tuple[tuple[int, int, float], ...] = ()
    """Diagonals from the first column at a lower floor to the last column at a higher one: the floors and EA."""
    brace_axial: Floats | None = None
    """EA of each of the two crossing diagonals of a story, hinged between the first and the last column."""
    attached: tuple[tuple[int, float, float], ...] = ()
    """Masses on springs that floors carry: floor, mass and spring."""
    wall_bending: float = 0.0
    """EI of a wall without mass, clamped at the ground, with nodes that sway with the floors."""
    wall_top: int | None = None
    """Floor at the top of the wall; the roof by default."""

    @property
    def stories(self) -> int:
        return len(self.heights)

    @property
    def shares(self) -> tuple[float, ...]:
        """The columns' shares, with a sum of one."""
        count = len(self.column_x)
        return self.column_share or (1.0 / count,) * count

    @property
    def weight(self) -> Floats:
        """Weight of all mass at and above each floor, shape (n,), N."""
        return self.gravity * np.cumsum(self.floor_mass[::-1])[::-1]


class SwayModes(NamedTuple):
    """The n sway modes of a frame, in ascending order: frequencies in Hz, and sway of the floors.

    Shapes have one column per mode, are normalized by all mass of the frame, and have a positive largest entry.
    """

    frequencies: Floats
    shapes: Floats


def sway_modes(building: Building) -> SwayModes:
    """Return the n modes with the largest share of kinetic energy in sway.

    An unstable frame, or sway modes mixed with other motion, are a ValueError.
    """
    model = assemble(building)
    eigenvalues, shapes = model.modes()
    if eigenvalues[0] <= 0:
        raise ValueError(f"the frame buckles: lowest eigenvalue {eigenvalues[0]:g}")
    floors = shapes[[model.coordinates["sway", floor] for floor in range(1, building.stories + 1)]]
    in_sway = building.floor_mass @ floors**2
    chosen = np.sort(np.argsort(in_sway)[-building.stories :])
    if in_sway[chosen].min() < LEAST_IN_SWAY:
        raise ValueError("a sway mode is mixed with motion of another kind")
    floors = floors[:, chosen]
    largest = floors[np.argmax(np.abs(floors), axis=0), np.arange(building.stories)]
    return SwayModes(np.sqrt(eigenvalues[chosen]) / (2 * np.pi), floors * np.sign(largest))


def assemble(building: Building) -> Model:
    """Return the finite-element model of a building; the coordinate ("sway", i) is the sway of floor i."""
    model = Model()
    joints = [[joint(building, floor, x) for x in building.column_x] for floor in range(building.stories + 1)]
    for floor, (below, above) in enumerate(pairwise(joints), 1):
        for column in range(len(building.column_x)):
            stand_column(model, building, (floor, column), below[column], above[column])
        lay_beams(model, building, floor, held_joints(model, building, floor, above))
        load_floor(model, building, floor, above)
        if building.brace_axial is not None:
            section = Section(bending=0.0, axial=float(building.brace_axial[floor - 1]))
            model.member(below[0], above[-1], section)
            model.member(below[-1], above[0], section)
    for low, high, axial in building.ties:
        model.member(joints[low][0], joints[high][-1], Section(bending=0.0, axial=axial))
    if building.wall_bending:
        levels = range((building.wall_top or building.stories) + 1)
        nodes = [
            Node(0.0, elevation(building, level), {("sway", level): 1.0}, {}, {("wall", level): 1.0})
            for level in levels
        ]
        nodes[0] = Node(0.0, 0.0, {}, {}, {})
        for below, above in pairwise(nodes):
            model.member(below, above, Section(bending=building.wall_bending, axial=0.0))
    hold_base(model, building, joints[0])
    return model


def elevation(building: Building, floor: int) -> float:
    """Return the elevation of a floor above the ground, m."""
    return float(building.heights[:floor].sum())


def joint(building: Building, floor: int, x: float) -> Node:
    """Return the joint of a column at x with a floor, or the column's foot for floor 0."""
    y = elevation(building, floor)
    rises, turns = rigid_base(building, x)
    if floor == 0:
        foot: Motion = turns if building.column_base == RIGID else {("foot", x): 1.0}
        return Node(x, y, {}, rises, foot)
    sway: Motion = {("sway", floor): 1.0}
    if building.beam_bending is None:
        if floor in building.connections:
            turns = {("turn", floor, x): 1.0}
        if building.column_axial is None:
            return Node(x, y, sway, rises, turns)
        return Node(x, y, sway, {("heave", floor): 1.0, ("tilt", floor): x}, {("tilt", floor): 1.0})
    if building.column_axial is not None:
        rises = {("rise", floor, x): 1.0}
    return Node(x, y, sway, rises, {("turn", floor, x): 1.0})


def rigid_base(building: Building, x: float) -> tuple[Motion, Motion]:
    """Return the vertical displacement and the rotation at x of a base that rocks."""
    if building.rocking_stiffness == RIGID:
        return {}, {}
    return {"rock": x}, {"rock": 1.0}


def stand_column(model: Model, building: Building, place: tuple[int, int], foot: Node, head: Node) -> None:
    """Add one column, given by story and column number, with the building's number of elements."""
    story, column = place
    height = float(building.heights[story - 1])
    share = building.shares[column]
    section = Section(
        bending=share * building.story_stiffness[story - 1] * height**3 / 12,
        axial=0.0 if building.column_axial is None else float(building.column_axial[story - 1]),
        line_mass=share * building.column_mass / height,
    )
    force = share * building.on_frame * float(building.weight[story - 1])
    for near, far in pairwise([foot, *within(building, place, foot, head), head]):
        model.member(near, far, section, compression=force)


def within(building: Building, place: tuple[int, int], foot: Node, head: Node) -> list[Node]:
    """Return the nodes of a column between its ends."""
    nodes = []
    for part in range(1, building.pieces):
        y = foot.y + (head.y - foot.y) * part / building.pieces
        rises: Motion = foot.uy if building.column_axial is None else {("rise", *place, part): 1.0}
        nodes.append(Node(foot.x, y, {("sway", *place, part): 1.0}, rises, {("turn", *place, part): 1.0}))
    return nodes


def lay_beams(model: Model, building: Building, floor: int, joints: list[Node]) -> None:
    """Add the beams of a floor, which keep their length. Rigid beams need no elements."""
    if building.beam_bending is None:
        return
    section = Section(bending=float(building.beam_bending[floor - 1]), axial=0.0)
    for left, right in pairwise(joints):
        model.member(left, right, section)


def held_joints(model: Model, building: Building, floor: int, joints: list[Node]) -> list[Node]:
    """Return the end nodes of a floor's beams: at the columns, or behind the connecting springs."""
    if floor not in building.connections:
        return joints
    rigid = building.beam_bending is None
    ends: list[Node] = []
    for node in joints:
        turn: Motion = {} if rigid else {("beam", floor, node.x): 1.0}
        model.spring({**node.turn, **dict.fromkeys(turn, -1.0)}, building.connections[floor])
        ends.append(dataclasses.replace(node, turn=turn))
    return ends


def load_floor(model: Model, building: Building, floor: int, joints: list[Node]) -> None:
    """Add a floor's mass, its spring, and the props that carry their part of the weight."""
    sway: Motion = {("sway", floor): 1.0}
    # floor_mass includes a part of the columns' mass, which the consistent mass already contains.
    columns = building.column_mass * (1.0 if floor < building.stories else 0.5)
    lumped = float(building.floor_mass[floor - 1]) - columns
    model.mass(sway, lumped)
    if building.vertical_inertia:
        for node, share in zip(joints, building.shares, strict=True):
            model.mass(node.uy, share * lumped)
    if floor in building.ground_springs:
        model.spring(sway, building.ground_springs[floor])
    for number, (carrier, mass, spring) in enumerate(building.attached):
        if carrier == floor:
            own: Motion = {("attached", number): 1.0}
            model.mass(own, mass)
            model.spring({**own, ("sway", floor): -1.0}, spring)
    on_props = (1.0 - building.on_frame) * float(building.weight[floor - 1])
    if on_props:
        # A rigid prop that leans by d over its height h falls by d^2 / 2h.
        lean: Motion = {**sway, ("sway", floor - 1): -1.0} if floor > 1 else sway
        model.spring(lean, -on_props / float(building.heights[floor - 1]))


def hold_base(model: Model, building: Building, feet: list[Node]) -> None:
    """Add the springs under the base and under each column's foot."""
    _, turns = rigid_base(building, 0.0)
    if turns:
        model.spring(turns, building.rocking_stiffness)
    if building.column_base != RIGID:
        for foot in feet:
            model.spring({**foot.turn, **{name: -factor for name, factor in turns.items()}}, building.column_base)
