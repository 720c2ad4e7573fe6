"""A state whose stories differ from the frame's in no pattern that the catalogue has."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.effects.story_change import with_changed_story
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class OtherChanges(OpenClass):
    """k_i (1 + c_i) for every story i in one state.

    Expected size: 10 % of each story's stiffness, between 2 and 45 % in two thirds of all cases.
    """

    name = "other_changes"
    summary = "In one state every story is softer or stiffer than in the others, each by its own share."
    formula = "k_i (1 + c_i) for every story i, in one state"
    source = "a repair, a rebuilt frame, another day: each story by itself"
    stage = "story"
    probability = 0.01
    sits_at = ("state",)
    needs = ("several states",)
    holds_in_words = "that the stories are those of the other states"
    place_in_words = "what changed most is"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"story {i}", "", lower=-0.99) for i in range(1, experiment.stories + 1)]

    def usual_size(self, scale: Scale) -> float:
        return 0.1

    def cause_at(self, entry: int, place: Place, experiment: Experiment) -> tuple[str, Place]:
        return "story_change", Place(story=entry + 1, state=place.state)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        for at, change in enumerate(values):
            state = with_changed_story(state, at, float(change), own.start + at)
        return state
