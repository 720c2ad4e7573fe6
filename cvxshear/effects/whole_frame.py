"""The frame as a whole and what stands beside it: weight, axial strain of columns, base, wall, springs."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, shown_states
from cvxshear.effects.state import Scale, State, summed
from cvxshear.measurement.experiment import Experiment
from cvxshear.model import transformation
from cvxshear.motions import THREE_MOTIONS, entries_of, unit_derivatives
from cvxshear.util.quantities import per_force, scaled, significant, with_std
from cvxshear.util.typing import Floats

#: Largest number of stories for springs or masses between all pairs of floors. In taller frames their N(N-1)/2
#: parameters make every fit take minutes.
MOST_JOINED = 40


class Gravity(Effect):
    """K - gamma T diag(P_i / h_i) T', with P_i the weight of all mass at and above floor i.

    gamma is 1 for columns that stay straight (a string of rigid links: P/h a story) and 6/5 for columns clamped at both
    ends that bend (the consistent geometric stiffness of a cubic: 6 P / 5 h).

    Weight always acts. The effect shows only if the stiffness of a test was declared without the weight (weights that
    changed between tests): even odds. The prior of gamma is uniform over the interval.
    """

    name = "gravity"
    summary = "The weight above each story pulls the leaning frame over and so reduces its sway stiffness (P-delta)."
    formula = "K - gamma T diag(P_i / h_i) T',  P_i = g (mass at and above floor i)"
    source = "Clough and Penzien, Dynamics of Structures: geometric stiffness, linear (1) and consistent cubic (6/5)"
    stage = "gravity"
    floors_move = ("one", "three")
    parameters = (Parameter("gamma", "", lower=1.0, upper=1.2, null=0.0, start=1.1),)
    needs = ("heights",)
    probability = 0.5

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        gamma, system = values[0], state.system
        unit, d_unit = (self._softening(state, each) for each in (system.M, system.dM))
        dK = system.dK - gamma * d_unit
        dK[own] -= unit
        return state.with_stiffness(system.K - gamma * unit, dK)

    def _softening(self, state: State, M: Floats) -> Floats:
        """Compute T diag(P_i / h_i) T', linear in M: loads follow from the sums of its rows, added up from the top.

        Of floors that turn, each weight softens the columns under it: P_i is then the matrix of the masses above.
        """
        heights, g = state.heights, state.experiment.frame.gravity
        if state.experiment.frame.turns:
            n = len(heights)
            loads = M.reshape(*M.shape[:-2], n, 3, n, 3).sum(axis=-2)[..., ::-1, :, :].cumsum(axis=-3)[..., ::-1, :, :]
            entries = entries_of(g * loads / heights[:, None, None]).reshape(*M.shape[:-2], -1)
            _, dK = unit_derivatives(THREE_MOTIONS, n)
            return summed(entries, dK[-6 * n :])
        T = transformation(len(heights))
        loads = g * np.cumsum(M.sum(axis=-1)[..., ::-1], axis=-1)[..., ::-1]
        return np.asarray((T * (loads / heights)[..., None, :]) @ T.T)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            f"the weight above takes {with_std(values[0], std[0])} times P/h from every story's stiffness (gravity; "
            "1 for columns that stay straight, 1.2 for columns clamped at both ends)"
        )

    def known_anyway(self, experiment: Experiment, floor_mass: Floats, story_stiffness: Floats) -> str:
        """State the share of a story's stiffness that the weight above cancels, if heights are declared."""
        heights = experiment.frame.story_heights
        if heights is None:
            return ""
        shares = []
        for each in experiment.tested:
            load = experiment.frame.gravity * np.cumsum((floor_mass + each.added_mass)[::-1])[::-1] / heights
            shares.append(float(np.max(load / (story_stiffness + load))))
        return (
            f"the weight above takes up to {100 * max(shares):.2g} % of a story's stiffness (P/h, up to 6/5 of it for "
            "columns that bend); the stiffnesses given are what is left"
        )


class _Flexible(Effect):
    """Flexibility + p D of the frame as a whole.

    The expected size is 15 % of the sway of the top under a force there.

    Undeclared heights are assumed equal; the parameter then counts lengths in stories.
    """

    stage = "flexibility"
    uses_heights = True
    cause: ClassVar[str]
    constant: ClassVar[str]

    @abstractmethod
    def pattern(self, heights: Floats) -> Floats:
        """Return D for a parameter of 1, shape (N, N), from the story heights."""

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_flexibility(values[0], self.pattern(state.heights), own)

    def _of_the_sway(self, scale: Scale) -> float:
        """Return the increase of the top's sway under a force there by a parameter of 1, relative to this sway."""
        return float(self.pattern(scale.heights)[-1, -1] / scale.sway)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 / self._of_the_sway(scale)])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            f"{self.cause}, which adds {significant(100 * values[0] * self._of_the_sway(scale), 2)} % to the sway of "
            f"the top under a force there ({self.constant} = {per_force(values[0], std[0], units[0])})"
        )


class AxialColumns(_Flexible):
    """Flexibility + D / EI, with D_ij = sum over stories s of M_is M_js h_s.

    M_is = max(z_i - (elevation of story s's mid-height), 0) is the moment of a unit force on floor i in story s.
    Columns clamped at both ends have their inflection at mid-height. So their axial forces, and with them the curvature
    of the frame as a whole, are constant over a story. Undeclared heights are assumed equal; then 1/EI counts lengths
    in stories.

    Expected size: 15 % of the sway of the top under a force there; chord drift is a tenth of the drift of frames of
    some ten stories, and more of taller ones (Taranath, Structural Analysis and Design of Tall Buildings). Only few
    frames, tall and slender ones, show the effect: 3 %.
    """

    name = "axial_columns"
    summary = "The columns stretch on one side and shorten on the other: the whole frame bends like a cantilever."
    formula = "flexibility + sum over stories s of M_is M_js h_s / EI,  M_is = max(z_i - mid-height of story s, 0)"
    source = "principle of virtual forces, columns with their inflection at mid-height"
    parameters = (Parameter("inverse_EI", "1/(N m2)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.03
    cause = "the frame bends as a whole, by columns that stretch and shorten or a wall"
    constant = "1/EI"

    def pattern(self, heights: Floats) -> Floats:
        z = np.cumsum(heights)
        moment = np.maximum(z[:, None] - (z - 0.5 * heights), 0.0)
        return np.asarray((moment * heights) @ moment.T)


class BaseRocking(_Flexible):
    """Flexibility + z z' / k_theta.

    Undeclared heights are assumed equal; then 1/k_theta counts lengths in stories.

    Expected size: 15 % of the sway of the top under a force there. Soil and base plates of this flexibility soften the
    first mode of frames by a few percent (Stewart, Fenves and Seed 1999); frames bolted to a floor or a table seldom
    show it: 5 %.
    """

    name = "base_rocking"
    summary = "The base turns under the overturning moment: the frame rocks as a rigid body on top of its sway."
    formula = "flexibility + z z' / k_theta"
    source = "rigid-body rotation about the base against a rotational spring"
    parameters = (Parameter("inverse_k_theta", "rad/(N m)", lower=0.0, unit_in_stories="m/N"),)
    probability = 0.05
    cause = "the base turns"
    constant = "1/k_theta"

    def pattern(self, heights: Floats) -> Floats:
        z = np.cumsum(heights)
        return np.outer(z, z)


class Wall(Effect):
    """K + EI F^-1 at the floors of a wall in bending, from the base to the top or to one floor above the first.

    F / EI is the flexibility of a cantilever in bending, clamped at the base. Its floors join frame and wall, so that
    both have the same sway. The parameter is w = EI / (H^2 mean(k h)) = 1 / (lambda H)^2, with H the height of the wall
    and k the stiffness of the columns beside it in this state: only the ratios of the heights matter. A wall in one
    story would equal the stiffness of that story.

    Expected size 0.36: with the tail of Student's t, nine in ten values of lambda H then lie between 1 and 6, as in
    most dual systems (Miranda 1999; a smaller lambda H is a wall, a larger one a frame). Most tall buildings have walls
    or cores, but an undeclared one beside a frame that is tested as a shear frame is rare: 5 %.
    """

    name = "wall"
    summary = "A shear wall or core beside the frame bends like a cantilever and sways with the floors."
    formula = "K + EI F^-1,  F_ij = z_i^2 (3 z_j - z_i) / 6 for z_i <= z_j <= H,  EI = w H^2 mean(k h)"
    source = "wall and frame in parallel, Heidebrecht and Stafford Smith 1973; deflection of a cantilever, Bernoulli"
    stage = "spring"
    parameters = (Parameter("w", "", lower=0.0, start=0.05),)
    uses_heights = True
    usual = 0.36
    probability = 0.05

    def places(self, experiment: Experiment) -> list[Place]:
        return [Place(), *(Place(floor=top) for top in range(2, experiment.stories))]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        heights = state.heights[: place.floor]
        floors = len(heights)
        bent = np.zeros(state.system.K.shape)
        bent[:floors, :floors] = cantilever(tuple(heights.tolist()))
        unit = float(np.mean(state.column_stiffness[:floors] * heights))
        d_unit = np.mean(state.d_column_stiffness[:, :floors] * heights, axis=1)
        dK = state.system.dK + values[0] * d_unit[:, None, None] * bent
        dK[own] += unit * bent
        return state.with_stiffness(state.system.K + values[0] * unit * bent, dK)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        w = float(values[0])
        slenderness = 1.0 / np.sqrt(w) if w > 0 else np.inf
        up_to = "" if place.floor is None else f" up to floor {place.floor}"
        return (
            f"a wall or core bends beside the frame{up_to}, with EI = {with_std(w, std[0])} times H^2 mean(k h) "
            f"(lambda H = {slenderness:.2g})"
        )


@lru_cache(maxsize=64)
def cantilever(heights: tuple[float, ...]) -> Floats:
    """Return the stiffness H^2 F^-1 of a cantilever clamped at the base at the floors, for EI = 1, shape (N, N), 1/m.

    Parameters
    ----------
    heights : tuple of float
        Story heights, m.
    """
    z = np.cumsum(heights)
    low, high = np.minimum.outer(z, z), np.maximum.outer(z, z)
    stiffness: Floats = z[-1] ** 2 * np.linalg.inv(low**2 * (3 * high - low) / 6)
    return 0.5 * (stiffness + stiffness.T)


class _Tie(Effect):
    """K + s d d', d = e_to - e_floor: a linear spring between two levels, in all states or in one."""

    stage = "spring"
    parameters = (Parameter("s", "N/m", lower=0.0),)
    usual_in = "story_stiffness"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        floor = place.floor_index + 1
        ends = (0, floor) if place.to is None else (floor, place.to)
        return state.plus_stiffness(values, unit_springs([ends], len(state.floor_mass)), own)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        factor, unit = scaled([float(values[0])], units[0])
        where = f"floor {place.floor} to the ground" if place.to is None else f"floors {place.floor} and {place.to}"
        return f"a spring of {with_std(values[0], std[0], unit, factor)} ties {where}{place.in_state}"


class GroundSpring(_Tie):
    """K + s e e' at one floor above the first; at the first floor the spring would equal story 1's own stiffness.

    Expected size: a tenth of the mean story stiffness. Cables, rods of shakers and touching neighbours are far softer
    than a story; a stiff brace would be noticed. The prior probability is therefore 5 %. With an attached mass on the
    same floor, the probability is one in five: most attached masses connect to one floor alone, but a neighbouring
    structure stands on the ground and acts exactly as both effects.
    """

    name = "ground_spring"
    summary = "Something beside the frame holds one floor: a brace to the ground, a neighbour, a cable, a shaker's rod."
    formula = "K + s e_j e_j'"
    source = "linear spring from floor j to the ground"
    probability = 0.05
    companion = "attached_mass"
    usual = 0.1
    sits_at = ("floor",)
    lowest_floor = 2

    def places(self, experiment: Experiment) -> list[Place]:
        floors = super().places(experiment)
        return [replace(at, state=state) for state in _in_all_or_since(experiment) for at in floors]


class Spring(_Tie):
    """K + s d d', d = e_to - e_floor, between two floors at least two levels apart.

    Between neighbors the spring would equal a story's own stiffness; a spring to the ground is ground_spring.

    Expected size: a fifth of the mean story stiffness. A brace over two stories is a member of the frame and has the
    stiffness of a story, a stair or a cable a tenth of it. Such members are visible, so one frame in thirty has an
    undeclared one.
    """

    name = "spring"
    summary = "Something ties two floors that are no neighbors: a brace over several stories, a stair, a cable, a core."
    formula = "K + s d d',  d = e_to - e_floor"
    source = "linear spring between two floors"
    sits_at = ("floor", "to")
    probability = 0.03
    usual = 0.2

    def places(self, experiment: Experiment) -> list[Place]:
        ties = [Place(low, to=high) for low, high in separate_levels(experiment.stories) if low]
        return [replace(at, state=state) for state in _in_all_or_since(experiment) for at in ties]

    def lacks(self, experiment: Experiment) -> str:
        return "" if 2 < experiment.stories <= MOST_JOINED else f"three to {MOST_JOINED} stories"


def _in_all_or_since(experiment: Experiment) -> list[str | None]:
    """List None for all states and, if a sound state is named, each other state: a prop, or a brace of a repair."""
    return [None] if experiment.frame.reference is None else [None, *shown_states(experiment)]


def separate_levels(stories: int) -> list[tuple[int, int]]:
    """List the pairs of levels that no story joins, the lower first, 0 the ground."""
    return [(low, high) for low in range(stories + 1) for high in range(low + 2, stories + 1)]


def unit_springs(pairs: Sequence[tuple[int, int]], stories: int) -> Floats:
    """Return d d' of a spring of unit stiffness between each pair of floors, 0 the ground, shape (p, N, N)."""
    ends = np.eye(stories + 1)[:, 1:]
    low, high = np.array(pairs).T
    d = ends[high] - ends[low]
    return np.asarray(d[:, :, None] * d[:, None, :])
