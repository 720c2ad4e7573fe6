"""Stories, their braces and their joints."""

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place, without_sign
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.motions import entries_of
from cvxshear.util.typing import Floats


class StoryChange(Effect):
    """k_i (1 + change) in one state.

    If a part of the story's stiffness is braces, the braces change first. A loss reduces the braces until they are
    gone, a gain increases them up to twice their stiffness, and the columns take the rest. The parameter is always the
    share of the whole story's stiffness.

    Expected size 25 %: damage, a loosened joint or a repair is detectable from some percent, and a story with a loss of
    more than half no longer belongs to the same frame.
    """

    name = "story_change"
    summary = "One story is softer or stiffer in one state than in the others: damage, a repair, a joint that loosened."
    formula = "k_i (1 + change) in one state; of floors that turn, K_s + change k_x d d', d = (1, 0, -y), likewise in y"
    source = "change of one story's columns or joints between tests"
    stage = "story"
    floors_move = ("one", "three")
    parameters = (Parameter("change", "", lower=-0.99, upper=99.0),)
    sits_at = ("story", "state")
    needs = ("several states",)
    usual = 0.25

    def places(self, experiment: Experiment) -> list[Place]:
        parts = (None, *SIDES) if experiment.frame.turns else (None,)
        return [dataclasses.replace(at, part=part) for at in super().places(experiment) for part in parts]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        assert place.story is not None
        if state.experiment.frame.turns:
            return with_changed_side(state, place.story - 1, place.part, values[0], own.start)
        return with_changed_story(state, place.story - 1, values[0], own.start)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        assert place.story is not None
        return "added_mass", Place(floor=stories + 1 - place.story, state=place.state)

    def of_story(self, place: Place, stories: int) -> tuple[int, str] | None:
        assert place.story is not None
        return None if place.part else (place.story, "its columns")

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = without_sign(values[0], std[0])
        part = f" {place.part}" if place.part else ""
        if values[0] > 0:
            return f"story {place.story} is {size} stiffer{part}{place.in_state}"
        return f"story {place.story} lost {size} of its stiffness{part}{place.in_state}"


#: Parts of a story that turns: a direction, and the side of the plan on which its members resist in that direction,
#: both sides alike or one. In words, with the axis and the sides' signs.
SIDES: dict[str, tuple[int, tuple[float, ...]]] = {
    "in x": (0, (1.0, -1.0)),
    "in y": (1, (1.0, -1.0)),
    "in x at y > 0": (0, (1.0,)),
    "in x at y < 0": (0, (-1.0,)),
    "in y at x > 0": (1, (1.0,)),
    "in y at x < 0": (1, (-1.0,)),
}


def with_changed_side(state: State, at: int, part: str | None, change: float, parameter: int) -> State:
    """Change a story that turns: its whole matrix, or its members in one direction at the edges of the plan.

    Parameters
    ----------
    state : State
    at : int
        Index of the story, counted from 0.
    part : str or None
        Of `SIDES`; None for the whole matrix.
    change : float
        Share of the story's stiffness in that direction.
    parameter : int
        Row of the derivatives by the change.
    """
    k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
    own = slice(6 * at, 6 * at + 6)
    # Changes add up, so that an open class of changes can be replaced by its causes.
    whole, d_whole = state.column_stiffness[own], state.d_column_stiffness[:, own]
    if part is None:
        unit, d_unit = whole, d_whole
    else:
        axis, signs = SIDES[part]
        edges = np.array(signs) * state.experiment.half_plan[at, 1 - axis]
        members = np.zeros((len(edges), 3))
        members[:, axis], members[:, 2] = 1.0, edges if axis else -edges
        shape = entries_of(members[:, :, None] * members[:, None, :]).reshape(len(edges), 6).mean(axis=0)
        unit, d_unit = whole[axis] * shape, d_whole[:, axis, None] * shape
    k[own] += change * unit
    dk[:, own] += change * d_unit
    dk[parameter, own] += unit
    return state.having(story_stiffness=k, d_story_stiffness=dk)


def with_changed_story(state: State, at: int, change: float, parameter: int) -> State:
    """Multiply the stiffness of one story by 1 + change, its braces changed first.

    Parameters
    ----------
    state : State
    at : int
        Index of the story, counted from 0.
    change : float
    parameter : int
        Row of the derivatives by the change.
    """
    k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
    brace, d_brace = state.brace_stiffness.copy(), state.d_brace_stiffness.copy()
    gained, d_gained = change * k[at], change * dk[:, at]
    d_gained[parameter] += k[at]
    if abs(gained) >= brace[at]:
        # The braces are gone, or have twice their stiffness; the columns take the rest. Without braces they take all.
        factor = 1.0 + np.sign(gained)
        brace[at] *= factor
        d_brace[:, at] *= factor
    else:
        brace[at] += gained
        d_brace[:, at] += d_gained
    k[at] += gained
    dk[:, at] += d_gained
    return state.having(story_stiffness=k, d_story_stiffness=dk, brace_stiffness=brace, d_brace_stiffness=d_brace)


class StateStiffness(Effect):
    """Every story stiffness times 1 + e in one state, and with them the stiffness of its beams and joints.

    Springs to the ground and between floors, the base and the weight do not change. In a state with an unmeasured mass
    scale, heavier floors fit equally well; so does a clock that runs slow by half of e.

    Expected size 10 %: frequencies fall by 2 to 10 % with the amplitude of the motion, and by the same amount with
    temperature and cracking of the whole frame (Clinton et al. 2006 on the Millikan Library; Peeters and De Roeck 2001
    on a bridge); the stiffness falls by twice this amount. One in twenty frames that are tested in several states has
    this effect.
    """

    name = "state_stiffness"
    summary = "The whole frame is softer or stiffer in one state: amplitude, temperature, cracks, or a retrofit."
    formula = "k_i (1 + e) for every story i, in one state"
    source = "one factor on the elastic modulus of the frame"
    stage = "story"
    floors_move = ("one", "three")
    parameters = (Parameter("e", "", lower=-0.99, upper=99.0),)
    says = 'all stories of "{place.state}" are {size} {word}'
    words = ("stiffer", "softer")
    sits_at = ("state",)
    needs = ("several states",)
    probability = 0.05
    usual = 0.1
    assumption_text = "that the stories of {state} did not all soften or stiffen by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        changed = {}
        # The columns' stiffness is the reference for beams and joints, which soften with the columns.
        for name in ("story_stiffness", "brace_stiffness", "column_stiffness"):
            stiffness = getattr(state, name)
            changed[name] = (1.0 + values[0]) * stiffness
            changed[f"d_{name}"] = (1.0 + values[0]) * getattr(state, f"d_{name}")
            changed[f"d_{name}"][own] += stiffness
        return state.having(**changed)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_mass", place


class Bracing(Effect):
    """A part beta of every story's stiffness is braces, which do not rotate joints.

    Rotating joints soften the columns alone, and a story that changes in one state changes its braces first
    (story_change). Chord drift and base rotation act on columns and braces alike, because a brace pulls at the columns
    at its ends. So the effect is detectable only with effects that rotate joints, and not in a frame with rigid beams.

    Expected: a uniform prior of the share; one in thirty frames of several stories has undeclared braces.
    """

    name = "bracing"
    summary = "Braces carry a part of every story's shear, which joints that turn do not soften."
    formula = "K = T diag(beta k) T' + frame of the columns (1 - beta) k with joints that turn"
    source = "diagonals hinged at both ends, which resist the drift of their story alone"
    stage = "bracing"
    parameters = (Parameter("beta", "", lower=0.0, upper=0.99),)
    says = "braces make up {size} of the stiffness of every story"
    probability = 0.03

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        beta = values[0]
        columns, d_columns = state.column_stiffness, (1.0 - beta) * state.d_column_stiffness
        brace, d_brace = state.brace_stiffness + beta * columns, beta * state.d_column_stiffness
        d_columns[own] -= columns
        d_brace[own] += columns
        return state.having(
            column_stiffness=(1.0 - beta) * columns,
            d_column_stiffness=d_columns,
            brace_stiffness=brace,
            d_brace_stiffness=state.d_brace_stiffness + d_brace,
        )


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
    source = "Bernoulli beam, Przemieniecki, Theory of Matrix Structural Analysis; static condensation, Guyan 1965"
    stage = "joint"
    parameters = (Parameter("eta", "", lower=0.0, upper=10.0, null=0.0, start=0.05),)
    uses_heights = True
    usual = 0.5

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return (
            "the beams bend and the joints turn, which adds "
            f"{without_sign(values[0], std[0])} to the sway of a story among equal ones (eta = {values[0]:.2g})"
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
    assumption_text = "that the feet of the columns are clamped"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.with_softer_joints(slice(0, 1), values[0], own.start)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        lost, error = _lost_by_turning(values[0], std[0], columns=1)
        return (
            f"the feet of the columns turn, which takes {without_sign(lost, error)} of the stiffness that story 1 has "
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
        return state.having(story_stiffness=k, d_story_stiffness=dk)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.5, 0.05]) if len(self.parameters) == 2 else np.array([0.12])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        top = len(scale.heights)
        (rho, loss), (rho_std, loss_std) = (each if len(each) == 2 else (0.0, each[0]) for each in (values, std))
        kept = 1.0 - loss
        by_turning, error = _lost_by_turning(rho * kept, rho_std * kept, len(_adjoining(place, top)))
        lost = 1.0 - (1.0 - by_turning) * kept
        size = without_sign(lost, float(np.hypot(kept * error, (1.0 - by_turning) * loss_std)))
        if end := self.of_story(place, top):
            loose = "the feet of the columns" if place.floor == 0 else f"the joints of floor {top}"
            return f"story {end[0]} lost {size} of its stiffness{place.in_state}: {loose} are loose"
        return (
            f"the joints of floor {place.floor} are loose{place.in_state}, which costs stories {place.floor} and "
            f"{place.floor_index + 2} about {size} of their stiffness"
        )

    def of_story(self, place: Place, stories: int) -> tuple[int, str] | None:
        (story, *more) = _adjoining(place, stories)
        return None if more else (story + 1, "its feet" if place.floor == 0 else "its joints")


def _lost_by_turning(rho: float, std: float, columns: int) -> tuple[float, float]:
    """Return the loss of a story's stiffness from rotating joints of one floor, and its standard deviation.

    In a frame of equal stories a story loses rho / 4 / (1 + c rho), with c = 1/3 for each column that ends there.
    """
    denominator = 1.0 + columns * rho / 3.0
    return rho / 4.0 / denominator, std / 4.0 / denominator**2


def _adjoining(place: Place, stories: int) -> range:
    """Return the indices of the stories below and above a floor."""
    return range(max(place.floor_index, 0), min(place.floor_index + 2, stories))
