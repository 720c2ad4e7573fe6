"""A floor that is held by something else than the frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.util.quantities import scaled, with_std
from cvxshear.util.typing import Floats


class GroundSpring(Effect):
    """K + s e e' at one floor above the first, where it would be story 1's own stiffness.

    Expected size: a tenth of the mean story stiffness. Cables, rods of shakers and neighbours that touch are far
    softer than a story; a brace that is not would have been seen, which leaves 5 %.
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
    sits_at = ("floor",)
    lowest_floor = 2

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        at = place.floor - 1
        K, dK = state.system.K.copy(), state.system.dK.copy()
        K[at, at] += values[0]
        dK[own, at, at] += 1.0
        return state.with_stiffness(K, dK)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.1 * scale.story_stiffness])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        factor, unit = scaled([float(values[0])], units[0])
        return f"a spring of {with_std(values[0], std[0], unit, factor)} ties floor {place.floor} to the ground"
