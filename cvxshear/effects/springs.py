"""Springs in addition to the stories: to the ground, and between floors that are not neighbors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, shown_states
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.quantities import scaled, with_std
from cvxshear.util.typing import Floats


class GroundSpring(Effect):
    """K + s e e' at one floor above the first; at the first floor the spring would equal story 1's own stiffness.

    Expected size: a tenth of the mean story stiffness. Cables, rods of shakers and touching neighbours are far softer
    than a story; a stiff brace would be noticed. The prior probability is therefore 5 %. With an attached mass on the
    same floor, the probability is one in five: most attached masses connect to one floor alone, but a neighbouring
    structure stands on the ground and acts exactly as both effects.
    """

    name = "ground_spring"
    summary = (
        "Something besides the frame holds one floor: a brace to the ground, a neighbour, a cable or a shaker's rod."
    )
    formula = "K + s e_j e_j'"
    source = "linear spring from floor j to the ground"
    stage = "spring"
    parameters = (Parameter("s", "N/m", lower=0.0),)
    probability = 0.05
    companion = "attached_mass"
    usual, usual_in = 0.1, "story_stiffness"
    sits_at = ("floor",)
    lowest_floor = 2

    def places(self, experiment: Experiment) -> list[Place]:
        return [
            Place(floor=floor, state=state)
            for state in _in_all_or_since(experiment)
            for floor in range(self.lowest_floor, experiment.stories + 1)
        ]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_stiffness(values, unit_springs([(0, place.floor_index + 1)], len(state.floor_mass)), own)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        factor, unit = scaled([float(values[0])], units[0])
        size = with_std(values[0], std[0], unit, factor)
        return f"a spring of {size} ties floor {place.floor} to the ground{place.in_state}"


class Spring(Effect):
    """K + s d d', d = e_to - e_floor, between two floors at least two levels apart.

    Between neighbors the spring would equal a story's own stiffness; a spring to the ground is ground_spring.

    Expected size: a fifth of the mean story stiffness. A brace over two stories is a member of the frame and has the
    stiffness of a story, a stair or a cable a tenth of it. Such members are visible, so one frame in thirty has an
    undeclared one.
    """

    name = "spring"
    summary = (
        "Something ties two floors that are not neighbors: a brace over several stories, a stair, a cable, a core."
    )
    formula = "K + s d d',  d = e_to - e_floor"
    source = "linear spring between two floors"
    stage = "spring"
    parameters = (Parameter("s", "N/m", lower=0.0),)
    sits_at = ("floor", "to")
    probability = 0.03
    usual, usual_in = 0.2, "story_stiffness"

    def places(self, experiment: Experiment) -> list[Place]:
        n = experiment.stories
        return [
            Place(floor=low, to=high, state=state)
            for state in _in_all_or_since(experiment)
            for low in range(1, n + 1)
            for high in range(low + 2, n + 1)
        ]

    def lacks(self, experiment: Experiment) -> str:
        return "" if experiment.stories > 2 else "three stories"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.to is not None
        return state.plus_stiffness(
            values, unit_springs([(place.floor_index + 1, place.to)], len(state.floor_mass)), own
        )

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        factor, unit = scaled([float(values[0])], units[0])
        size = with_std(values[0], std[0], unit, factor)
        return f"a spring of {size} ties floors {place.floor} and {place.to}{place.in_state}"


def _in_all_or_since(experiment: Experiment) -> list[str | None]:
    """List None for all states and, if a sound state is named, each other state: a prop, or a brace of a repair."""
    return [None] if experiment.frame.reference is None else [None, *shown_states(experiment)]


def unit_springs(pairs: Sequence[tuple[int, int]], stories: int) -> Floats:
    """Return d d' of a spring of unit stiffness between each pair of floors, 0 the ground, shape (p, N, N)."""
    ends = np.eye(stories + 1)[:, 1:]
    low, high = np.array(pairs).T
    d = ends[high] - ends[low]
    units: Floats = d[:, :, None] * d[:, None, :]
    return units
