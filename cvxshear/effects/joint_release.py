"""Joints of one floor that came loose in one state."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.util.typing import Floats


class JointRelease(Effect):
    """The joints of one floor, or the feet, turn more easily in one state.

    The columns stay continuous; what holds them against turning has the flexibility rho / mean(k h^2) more, in
    series with the floor's beams (joint_rotation). So both adjoining stories soften, by up to three eighths each where
    they are alike, and the base softens story 1 alone. Only the ratios of the heights matter.

    Expected size 0.5, which costs adjoining stories of equal stiffness 9 %: bolts that lost their preload leave a
    connection some ten times as stiff against turning as its column (Chen and Lui, Stability Design of Steel Frames,
    on semi-rigid connections), a plate whose screws are loose about as stiff. One frame in thirty that is tested in
    several states.
    """

    name = "joint_release"
    summary = "The joints between the columns and one floor, or the feet, came loose in one state."
    formula = "flexibility of the joints of one floor + rho / mean(k h^2), in one state, rotations condensed"
    source = "rotational spring in series with the beams, Bernoulli beam element, static condensation"
    stage = "joint"
    parameters = (Parameter("rho", "", lower=0.0, upper=100.0, start=0.05),)
    sits_at = ("floor", "state")
    needs = ("several states",)
    lowest_floor = 0
    probability = 0.03
    uses_heights = True

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.floor is not None
        softer, d_softer = state.joint_flexibility.copy(), state.d_joint_flexibility.copy()
        unit, d_unit = state.usual_flexibility()
        softer[place.floor] += values[0] * unit
        d_softer[:, place.floor] += values[0] * d_unit
        d_softer[own, place.floor] += unit
        return dataclasses.replace(state, joint_flexibility=softer, d_joint_flexibility=d_softer)

    def sizes(self, of: Scale) -> Floats:
        return np.array([0.5])

    def phrase(self, place: Place, values: Floats, std: Floats, of: Scale, units: Sequence[str]) -> str:
        assert place.floor is not None
        # One floor's joints in a frame of equal stories: a story loses rho/4 / (1 + c rho), c = 1/3 a column.
        top = len(of.heights)
        columns = 1 if place.floor in (0, top) else 2
        denominator = 1.0 + columns * values[0] / 3.0
        lost, error = values[0] / 4.0 / denominator, std[0] / 4.0 / denominator**2
        size = in_percent(lost, error)
        where = f'in "{place.state}"'
        if place.floor == 0:
            return f"the feet of the columns are loose {where}, which costs story 1 {size} of its stiffness"
        if place.floor == top:
            return f"the joints of floor {top} are loose {where}, which costs story {top} {size} of its stiffness"
        return (
            f"the joints of floor {place.floor} are loose {where}, which costs stories {place.floor} and "
            f"{place.floor + 1} about {size} of their stiffness"
        )
