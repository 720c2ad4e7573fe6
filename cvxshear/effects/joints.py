"""Flexible joints: the beams bend, or the joints came loose."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, in_percent
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class JointRotation(Effect):
    """Columns that bend between rotating joints, with the rotations condensed out.

    A story of stiffness k = 12 E I / h^3 and height h, with sway u and joint rotation theta at either end, has the
    stiffness of the Bernoulli beam, k [1, h/2; h^2/3, h^2/6 coupling]. The beams of each floor resist with r, N m/rad;
    the columns are clamped at the ground. eta = mean(k h^2) / r, zero for rigid beams. In a tall frame of equal stories
    under equal shears V, every joint turns by V h / r. This adds V h^2 / r, eta times V / k, to the sway of each story.
    Only the ratios of the heights matter.

    Expected size 0.5: with beams and columns of equal stiffness, I_b / L = I_c / h, one bay has r = 12 E I_b / L and k
    h^2 = 24 E I_c / h, so eta = 2; frames tested as shear frames have beams several times stiffer (Chopra, Dynamics of
    Structures, on the beam-to-column stiffness ratio, 1 / eta for one bay). Bound 10: with a ratio below 0.1 the
    columns have no inflection in most stories and bend as cantilevers (Blume 1968), and the frame is no shear frame.
    """

    name = "joint_rotation"
    summary = "The beams bend, so that the joints turn and each story is softer than columns clamped at both ends."
    formula = (
        "story element k [[1, h/2], [h/2, h^2/3]] with coupling h^2/6, plus r = mean(k h^2) / eta a floor, "
        "rotations condensed"
    )
    source = (
        "Bernoulli beam element, Przemieniecki, Theory of Matrix Structural Analysis; static condensation, Guyan 1965"
    )
    stage = "joint"
    parameters = (Parameter("eta", "", lower=0.0, upper=10.0, null=0.0, start=0.05),)
    uses_heights = True
    usual = 0.5

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            "the beams bend and the joints turn, which adds "
            f"{in_percent(values[0], std[0])} to the sway of a story among equal ones (eta = {values[0]:.2g})"
        )

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_softer_joints(slice(1, None), values[0], own.start)


class SoftFeet(Effect):
    """Column bases that rotate, in a frame with rotating joints.

    The base has a rotational flexibility rho / mean(k h^2); the shear model clamps the columns there. Between floors
    with rigid joints a flexible base only makes story 1 softer, so the data cannot distinguish it from a softer story.

    Expected size 0.5: Eurocode 3 (EN 1993-1-8, 5.2.2.5) calls the column bases of sway frames rigid above 30 E I / h,
    which corresponds to rho = 0.4. The prior probability is one in three for frames with measurable bending of the
    beams.
    """

    name = "soft_feet"
    summary = "The feet of the columns turn, where the shear model clamps them."
    formula = "flexibility of the joints at the base + rho / mean(k h^2), rotations condensed, beside joint_rotation"
    source = "rotational spring under a Bernoulli beam element, static condensation"
    stage = "joint"
    parameters = (Parameter("rho", "", lower=0.0, upper=100.0, null=0.0, start=0.05),)
    uses_heights = True
    usual = 0.5
    probability = 0.3
    beside = "joint_rotation"
    granted = "that the feet of the columns are clamped"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_softer_joints(slice(0, 1), values[0], own.start)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        lost, error = _lost_by_turning(values[0], std[0], columns=1)
        return (
            f"the feet of the columns turn, which takes {in_percent(lost, error)} of the stiffness that story 1 has "
            f"between rigid beams (rho = {values[0]:.2g})"
        )


class JointRelease(Effect):
    """Loss of clamping of the columns at one floor, or at the base, in one state.

    Two mechanisms soften the adjoining stories. First, the columns stay continuous, and their rotational restraint
    gains the flexibility rho / mean(k h^2), in series with the floor's beams (joint_rotation). Both stories soften
    together, by up to three eighths each if they are alike. Second, a looser clamp lets each column bend inside the
    clamp: its free length h grows by d, and the story loses the part 1 - (1 + d / h)^-3 = loss of its columns'
    stiffness. At the base and at the top both mechanisms soften one story alone, and the loss represents both. Only the
    ratios of the heights matter.

    Expected sizes: rho 0.5, which costs adjoining stories of equal stiffness 9 %. After loss of bolt preload a
    connection has some ten times the rotational stiffness of its column (Chen and Lui, Stability Design of Steel
    Frames, on semi-rigid connections); a plate with loose screws has about the stiffness of the column. A loss of 5 %:
    a clamp with a tenth of its column's length that grips over five sixths of its own length. At the base and at the
    top a loss of 12 %, both together. One in thirty frames that are tested in several states has this effect.
    """

    name = "joint_release"
    summary = "The joints between the columns and one floor, or the feet, came loose in one state."
    formula = (
        "flexibility of the joints of one floor + rho / mean(k h^2), rotations condensed, and the columns of both "
        "adjoining stories (1 - loss) k, in one state"
    )
    source = "rotational spring in series with the beams, Bernoulli beam element, static condensation; free length"
    stage = "joint"
    parameters: tuple[Parameter, ...] = (
        Parameter("rho", "", lower=0.0, upper=100.0, start=0.05),
        Parameter("loss", "", lower=0.0, upper=0.99, start=0.01),
    )
    sits_at = ("floor", "state")
    needs = ("several states",)
    lowest_floor = 0
    probability = 0.03
    uses_heights = True

    def bound_at(self, experiment: Experiment, place: Place) -> Self:
        """Make a copy with the loss alone if only one story adjoins: the data cannot separate the two parts there."""
        both = len(_adjoining(place, experiment.stories)) > 1
        return self if both else self.having(self.parameters[-1:])

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        *turning, loss = values
        for rho in turning:
            joint = place.floor_index + 1
            state = state.with_softer_joints(slice(joint, joint + 1), rho, own.start)
        k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
        for at in _adjoining(place, len(k)):
            columns = k[at] - state.brace_stiffness[at]
            d_columns = dk[:, at] - state.d_brace_stiffness[:, at]
            k[at] -= loss * columns
            dk[:, at] -= loss * d_columns
            dk[own.stop - 1, at] -= columns
        return dataclasses.replace(state, story_stiffness=k, d_story_stiffness=dk)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.5, 0.05]) if len(self.parameters) == 2 else np.array([0.12])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        top = len(scale.heights)
        (rho, loss), (rho_std, loss_std) = (each if len(each) == 2 else (0.0, each[0]) for each in (values, std))
        kept = 1.0 - loss
        by_turning, error = _lost_by_turning(rho * kept, rho_std * kept, len(_adjoining(place, top)))
        lost = 1.0 - (1.0 - by_turning) * kept
        size = in_percent(lost, float(np.hypot(kept * error, (1.0 - by_turning) * loss_std)))
        where = f'in "{place.state}"'
        if place.floor == 0:
            return f"the feet of the columns are loose {where}, which costs story 1 {size} of its stiffness"
        if place.floor == top:
            return f"the joints of floor {top} are loose {where}, which costs story {top} {size} of its stiffness"
        return (
            f"the joints of floor {place.floor} are loose {where}, which costs stories {place.floor} and "
            f"{place.floor_index + 2} about {size} of their stiffness"
        )


def _lost_by_turning(rho: float, std: float, columns: int) -> tuple[float, float]:
    """Return the loss of a story's stiffness from rotating joints of one floor, and its standard deviation.

    In a frame of equal stories a story loses rho / 4 / (1 + c rho), with c = 1/3 for each column that ends there.
    """
    denominator = 1.0 + columns * rho / 3.0
    return rho / 4.0 / denominator, std / 4.0 / denominator**2


def _adjoining(place: Place, stories: int) -> range:
    """Return the indices of the stories below and above a floor."""
    return range(max(place.floor_index, 0), min(place.floor_index + 2, stories))
