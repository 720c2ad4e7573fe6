"""Centers of mass and of stiffness of floors that turn, away from the axis of the symmetric frame.

A floor with mass m and inertia J about its center c has, at the reference point, the matrix S' diag(m, m, J) S; S turns
the motion of the reference point into that of the center. A story whose center of stiffness is c has S' K_s S.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.configuration import Configuration
from cvxshear.measurement.experiment import Experiment
from cvxshear.motions import THREE_MOTIONS, blocks, entries_of
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats

#: dS / dc of a center that moves in x, and in y.
MOVED = {
    "in x": np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
    "in y": np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
}


class _Asymmetric(Effect):
    """A lack of symmetry of all floors or stories together, or of one of them."""

    stage = "center"
    floors_move = ("three",)

    def places(self, experiment: Experiment) -> list[Place]:
        return [Place(), *super().places(experiment)]

    def weight(self, place: Place, experiment: Experiment) -> float:
        """Return as much for all floors or stories together as for each of them alone."""
        return float(experiment.stories) if place.floor is place.story is None else 1.0


class _Eccentric(_Asymmetric):
    """Center of every floor or story, or of one, at a distance e from the axis of the symmetric frame.

    Expected size: 0.12 radii of gyration, which are 5 % of the side of a square floor, the accidental eccentricity of
    EN 1998-1, 4.3.2. Floors are drawn symmetric more often than they are: three in ten frames have the effect.
    """

    source = "parallel shift of the reference point of a rigid floor"
    parameters = (Parameter("e", "m"),)
    usual, usual_in = 0.12, "mean_radius"
    probability = 0.3

    def places(self, experiment: Experiment) -> list[Place]:
        return [replace(at, part=axis) for at in super().places(experiment) for axis in MOVED]

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        coordinate = f"{str(place.part)[-1]} = {with_std(values[0], std[0], 'm')}"
        return f"the {self.center} of {_levels(place, self.sits_at[0])} is at {coordinate}"

    center: ClassVar[str]
    """The center in words."""


class EccentricMass(_Eccentric):
    """M_i at the reference point of a floor whose mass center is e from it; the inertia is about the center."""

    name = "eccentric_mass"
    summary = "The mass center of a floor, or of all floors, is beside the axis of the symmetric frame."
    formula = "M_i = S' diag(m, m, J) S,  S = [[1, 0, -e_y], [0, 1, e_x], [0, 0, 1]]"
    sits_at = ("floor",)
    center = "mass center"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return with_moved_masses(state, str(place.part), values, _pattern(place.floor, len(state.heights)), own)


class EccentricStiffness(_Eccentric):
    """K_s at the reference point of a story whose center of stiffness is e from it."""

    name = "eccentric_stiffness"
    summary = "The center of stiffness of a story, or of all stories, is beside the axis of the symmetric frame."
    formula = "K_s = S' diag(k_x, k_y, k_r) S,  S = [[1, 0, -e_y], [0, 1, e_x], [0, 0, 1]]"
    sits_at = ("story",)
    center = "center of stiffness"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return with_moved_stories(state, str(place.part), values, _pattern(place.story, len(state.heights)), own)


class TurnedAxes(_Asymmetric):
    """K_xy = o (k_x + k_y) / 2 for all stories, or for one: their principal axes are not x and y.

    Nearly equal frequencies in x and y let modes sway in any direction, and a small o says in which.

    Expected size: 12 % of the mean stiffness; where x is a third stiffer than y, that turns the axes by 12 degrees.
    Members are seldom oblique, and sensors are aligned with them: one in ten frames has the effect.
    """

    name = "turned_axes"
    summary = "The principal axes of a story, or of all stories, are not x and y: oblique walls, or a turned frame."
    formula = "K_s + o (k_x + k_y) / 2 between x and y"
    source = "a symmetric matrix of two motions has principal axes"
    stage = "axes"
    parameters = (Parameter("o", "", lower=-1.0, upper=1.0),)
    sits_at = ("story",)
    usual = 0.12

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return with_turned_axes(state, values, _pattern(place.story, len(state.heights)), own)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size, whose = with_std(values[0], std[0], "%", 0.01), _levels(place, "story")
        return f"the axes of {whose} are not x and y: the stiffness between these is {size} of their mean"


def _pattern(level: int | None, stories: int) -> Floats:
    """Return the part of a parameter for each floor or story, shape (1, N): all of them, or one."""
    return np.ones((1, stories)) if level is None else np.eye(stories)[level - 1 : level]


def _levels(place: Place, kind: str) -> str:
    """Name the floor or story of a place, or all of them."""
    level = place.floor or place.story
    return {"floor": "all floors", "story": "all stories"}[kind] if level is None else f"{kind} {level}"


class OtherCenters(OpenClass):
    """Every center of mass and of stiffness at its own place, and principal axes of its own for every story.

    Expected size: 0.12 radii of gyration for every center, and an entry xy of 0.12 of the mean stiffness.
    """

    name = "other_centers"
    summary = "Every floor and every story has its own center, and every story its own axes."
    formula = "M_i and K_s about any center; K_xy = o (k_x + k_y) / 2 for every story"
    source = "a symmetric positive matrix of three motions has a center and an angle of its axes"
    stage = "center"
    floors_move = ("three",)
    usual, usual_in = 0.12, "mean_radius"
    probability = 0.1
    holds_in_words = "that floors and stories are symmetric about one axis"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        levels = range(1, experiment.stories + 1)
        return [
            *(Parameter(f"floor {i} {axis}", "m") for axis in MOVED for i in levels),
            *(Parameter(f"story {i} {axis}", "m") for axis in MOVED for i in levels),
            *(Parameter(f"story {i} between x and y", "") for i in levels),
        ]

    def sizes(self, scale: Scale) -> Floats:
        stories = len(scale.heights)
        return self.usual * np.repeat([scale.mean_radius, 1.0], [4 * stories, stories])

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        n = len(state.heights)
        parts = [(part, slice(own.start + n * i, own.start + n * i + n)) for i, part in enumerate(np.split(values, 5))]
        for axis, (moved, rows) in zip(MOVED, parts[:2], strict=True):
            state = with_moved_masses(state, axis, moved, np.eye(n), rows)
        state = with_turned_axes(state, parts[-1][0], np.eye(n), parts[-1][1])
        for axis, (moved, rows) in zip(MOVED, parts[2:4], strict=True):
            state = with_moved_stories(state, axis, moved, np.eye(n), rows)
        return state


def with_moved_masses(state: State, axis: str, values: Floats, pattern: Floats, own: slice) -> State:
    """Move the mass center of each floor along an axis by values @ pattern; declared added mass stays in its place.

    Parameters
    ----------
    state : State
    axis : str
        Of `MOVED`.
    values : ndarray, shape (p,)
    pattern : ndarray, shape (p, N)
    own : slice
        Rows of the derivatives by the values.
    """
    test = state.tested
    assert isinstance(test, Configuration)
    loads = THREE_MOTIONS.loads(test.added_mass, test.added_mass_position)
    moves = [np.kron(np.diag(each), MOVED[axis]) for each in pattern]
    S = np.eye(len(loads)) + np.tensordot(values, np.array(moves), 1)
    left = (state.system.M - loads) @ S
    dM = S.T @ state.system.dM @ S
    for row, move in zip(range(own.start, own.stop), moves, strict=True):
        dM[row] += move.T @ left + left.T @ move
    return state.with_mass(S.T @ left + loads, dM)


def with_moved_stories(state: State, axis: str, values: Floats, pattern: Floats, own: slice) -> State:
    """Move the center of stiffness of each story, as `with_moved_masses` does with floors."""
    n, move = len(state.heights), MOVED[axis]
    S = np.eye(3) + (values @ pattern)[:, None, None] * move
    K = blocks(state.story_stiffness, THREE_MOTIONS.stiffness_basis)
    dK = blocks(state.d_story_stiffness, THREE_MOTIONS.stiffness_basis).reshape(-1, n, 3, 3)
    left, turned = K @ S, np.swapaxes(S, 1, 2)
    slopes = turned @ dK @ S
    by_move = move.T @ left
    slopes[own] += pattern[:, :, None, None] * (by_move + np.swapaxes(by_move, 1, 2))
    return _with_stories(state, entries_of(turned @ left), entries_of(slopes).reshape(len(slopes), -1))


def with_turned_axes(state: State, values: Floats, pattern: Floats, own: slice) -> State:
    """Add a stiffness between x and y to each story, values @ pattern of the mean of x and y."""
    k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
    mean, d_mean = (0.5 * (each[..., 0::6] + each[..., 1::6]) for each in (k, dk))
    k[3::6] += (values @ pattern) * mean
    dk[:, 3::6] += (values @ pattern) * d_mean
    dk[own, 3::6] += pattern * mean
    return _with_stories(state, k, dk)


def _with_stories(state: State, k: Floats, dk: Floats) -> State:
    """Return the same state with other stories, which changes in single states start from."""
    return state.having(story_stiffness=k, d_story_stiffness=dk, column_stiffness=k, d_column_stiffness=dk)
