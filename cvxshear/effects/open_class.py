"""Open classes: violations of a statement of the shear model that the catalogue does not describe."""

from abc import abstractmethod
from collections.abc import Sequence
from itertools import combinations
from typing import ClassVar, Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.masses import on_floors
from cvxshear.effects.state import Scale, State
from cvxshear.effects.stories import with_changed_story
from cvxshear.effects.whole_frame import MOST_JOINED, separate_levels, unit_springs
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, Configuration
from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.priors import Constraints
from cvxshear.util import quantities, ranking
from cvxshear.util.typing import Bools, Floats, Ints

#: Smallest distance from zero, in standard deviations, of an entry that is named as a place of a model error.
STANDS_OUT = 3.0


class OpenClass(Effect):
    """Violation of a statement of the shear model that the catalogue does not describe.

    The parameters are normal about zero with one common size. The size is unknown: its logarithm is normal about the
    logarithm of `usual`, with a standard deviation of 1.5, so two thirds of all cases lie within a factor of 4.5. The
    evidence penalises the many parameters: a correct cause of the catalogue explains the same data with one parameter.

    Each statement fails in this way in two of a hundred tested frames, because the catalogue covers the cases known
    from practice. If a statement has two classes, each has one in a hundred.
    """

    kind = "open"
    common_size = True
    size_width = 1.5
    probability = 0.02
    parameters: tuple[Parameter, ...] = ()
    holds_in_words: ClassVar[str]
    """Violated statement of the shear model, as a clause."""

    def bound(self, experiment: Experiment) -> Self:
        """Make a copy with one parameter per entry."""
        return self.having(self.entries(experiment))

    @abstractmethod
    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        """List the parameters of the class in an experiment, each named by its place: "floors 2 and 6", "story 3"."""

    def lacks(self, experiment: Experiment) -> str:
        # The entries of springs and masses between all pairs of floors.
        if self.stage in ("spring", "inertia") and experiment.stories > MOST_JOINED:
            return f"at most {MOST_JOINED} stories"
        return super().lacks(experiment) or ("" if self.entries(experiment) else "more floors")

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        failed = f"{self.holds_in_words}{place.in_state} does not hold"
        named = self.conspicuous(values, std)
        if not named:
            return f"{failed}; no single place stands out"
        if values[named[0]] < 0 and self.never_negative:
            return f"{failed}; no single place stands out, as no {self.never_negative} is negative"
        entries = "; ".join(
            f"{self.parameters[i].name}: {quantities.with_std(float(values[i]), float(std[i]), units[i])}"
            for i in named
        )
        return f"{failed}: {self.place_in_words} {entries}"

    place_in_words: ClassVar[str] = "what stands out is"
    never_negative: ClassVar[str] = ""
    """Cause of a single entry that cannot be negative; a negative entry has another cause."""

    def conspicuous(self, values: Floats, std: Floats, most: int = 3) -> list[int]:
        """List the significant entries, the most significant first and not more than a sentence can name."""
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.nan_to_num(np.abs(values) / std)
        return [i for i in ranking.order(z) if z[i] >= STANDS_OUT][:most]


def named_pair(i: int, j: int) -> str:
    """Name a pair, such as "floors 2 and 6" or "the ground and floor 3"."""
    return f"floors {i} and {j}" if i else f"the ground and floor {j}"


#: Motions of floors that turn, in words behind the name of a floor or story.
WAYS = (" in x", " in y", " in rotation")


class OtherStiffness(OpenClass):
    """K + sum of s_ij d_ij d_ij' over all pairs of levels that no story joins, d_ij = e_j - e_i, e_0 = 0.

    Every symmetric K is such a network of springs between all pairs of levels, with the ground. N springs are the
    stories, and the other N(N-1)/2 form this class. Springs may be negative.

    Expected size: 2 % of a story's stiffness, between 0.4 and 9 % in two thirds of all cases.
    """

    name = "other_stiffness"
    summary = "The floors are tied to each other in a way that no shear frame and no effect of the catalogue has."
    formula = "K + sum of s_ij d_ij d_ij', d_ij = e_j - e_i, over the pairs of levels at least two apart"
    source = "every symmetric matrix is a network of springs between all pairs of its nodes and the ground"
    stage = "spring"
    floors_move = ("one", "three")
    usual, usual_in = 0.02, "story_stiffness"
    holds_in_words = "that only neighboring floors are tied to each other"
    place_in_words = "something that the catalogue does not hold ties"
    never_negative = "spring"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        parts = WAYS if experiment.frame.turns else ("",)
        ties = separate_levels(experiment.stories)
        return [Parameter(f"{named_pair(i, j)}{part}", "N/m") for part in parts for i, j in ties]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        n, experiment = len(state.heights), state.experiment
        units = unit_springs(separate_levels(n), n)
        if experiment.frame.turns:
            # Rotations at the radius of gyration, so that all springs are in N/m.
            each = [1.0, 1.0, float(np.mean(experiment.radius)) ** 2]
            units = np.concatenate([np.kron(units, np.diag(each * axis)) for axis in np.eye(3)])
        return state.plus_stiffness(values, units, own)


class OtherInertia(OpenClass):
    """M_ij = M_ji = mu_ij for every pair of floors i < j.

    Expected size: 2 % of a floor's mass, between 0.4 and 9 % in two thirds of all cases; the columns' own mass couples
    neighboring floors by a tenth of the mass of a story's columns.
    """

    name = "other_inertia"
    summary = "The inertia of the floors is coupled in a way that no effect of the catalogue has."
    formula = "M + sum of mu_ij (e_i e_j' + e_j e_i') over all pairs of floors"
    source = "every symmetric mass matrix has N(N-1)/2 entries off its diagonal"
    stage = "inertia"
    usual, usual_in = 0.02, "floor_mass"
    holds_in_words = "that the inertia of each floor is its own"
    place_in_words = "something that the catalogue does not hold couples the inertia of"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(named_pair(i, j), "kg") for i, j in combinations(range(1, experiment.stories + 1), 2)]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        i, j = np.triu_indices(len(state.floor_mass), k=1)
        units = np.zeros((len(i), len(state.floor_mass), len(state.floor_mass)))
        units[np.arange(len(i)), i, j] = units[np.arange(len(i)), j, i] = 1.0
        return state.plus_mass(values, units, own)


class OtherBeams(OpenClass):
    """Joints of floor j with 1 + b_j times the flexibility of joint_rotation, for every floor.

    The beams of a floor resist the rotation of its joints; joint_rotation assumes equal beams at every floor.

    Expected size: 20 % of each floor's flexibility, between 4 and 90 % in two thirds of all cases. One frame in ten: a
    podium, a setback or a roof has different beams and a different slab, which stiffens them.
    """

    name = "other_beams"
    summary = "The beams resist the turning joints of some floors more than those of others."
    formula = "flexibility of the joints of every floor j times 1 + b_j"
    source = "beams of each floor by themselves: other spans, depths, slabs"
    stage = "beams"
    beside = "joint_rotation"
    usual = 0.2
    probability = 0.1
    holds_in_words = "that the beams of all floors are alike"
    place_in_words = "what turns more or less easily than elsewhere is the joints of"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"floor {j}", "", lower=-0.95) for j in range(1, experiment.stories + 1)]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        factor = np.concatenate([[1.0], 1.0 + values])
        slopes = state.d_joint_flexibility * factor
        slopes[own, 1:] += np.diag(state.joint_flexibility[1:])
        return state.having(joint_flexibility=state.joint_flexibility * factor, d_joint_flexibility=slopes)


class OtherChanges(OpenClass):
    """k_i (1 + c_i) for every story i in one state.

    Expected size: 10 % of each story's stiffness, between 2 and 45 % in two thirds of all cases.
    """

    name = "other_changes"
    summary = "In one state every story is softer or stiffer than in the others, each by its own share."
    formula = "k_i (1 + c_i) for every story i, in one state"
    source = "a repair, a rebuilt frame, another day: each story by itself"
    stage = "story"
    floors_move = ("one", "three")
    usual = 0.1
    probability = 0.01
    sits_at = ("state",)
    needs = ("several states",)
    holds_in_words = "that the stories are those of the other states"
    place_in_words = "what changed most is"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        parts = WAYS if experiment.frame.turns else ("",)
        stories = range(1, experiment.stories + 1)
        return [Parameter(f"story {i}{part}", "", lower=-0.99) for i in stories for part in parts]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        if state.experiment.frame.turns:
            k, dk = state.story_stiffness.copy(), state.d_story_stiffness.copy()
            diagonal = np.flatnonzero(np.tile(np.arange(6) < 3, len(state.heights)))
            whole, d_whole = state.column_stiffness[diagonal], state.d_column_stiffness[:, diagonal]
            k[diagonal] += values * whole
            dk[:, diagonal] += values * d_whole
            dk[own, diagonal] += np.diag(whole)
            return state.having(story_stiffness=k, d_story_stiffness=dk)
        for at, change in enumerate(values):
            state = with_changed_story(state, at, float(change), own.start + at)
        return state


class OtherLoads(OpenClass):
    """M + diag(mass_i) in one state; no floor can lose more than it holds.

    Expected size: 10 % of a floor's mass, between 2 and 45 % in two thirds of all cases.
    """

    name = "other_loads"
    summary = "In one state every floor carries another mass than was declared."
    formula = "M + diag(mass_i), in one state"
    source = "live load, furniture, instruments: each floor by itself"
    stage = "mass"
    usual, usual_in = 0.1, "floor_mass"
    probability = 0.01
    sits_at = ("state",)
    needs = ("several states",)
    holds_in_words = "that the floors carry what was declared"
    place_in_words = "what differs most is"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"floor {i}", "kg") for i in range(1, experiment.stories + 1)]

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        n = experiment.stories
        declared = np.array([each.added_mass for each in experiment.tested if each.state == place.state])
        G = np.hstack([-np.eye(n), np.zeros((n, n)), -np.eye(n)])
        return Constraints(G=G, h=declared.min(axis=0))

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_mass(values, on_floors(range(len(values)), len(values)), own)


class OtherGains(OpenClass):
    """The measured shape entry at each floor is 1 + g_j times the true one, in every configuration and mode.

    Expected size: 5 % of each reading, between 1 and 22 % in two thirds of all cases.
    """

    name = "other_gains"
    summary = "Every sensor reads too much or too little, each by its own factor."
    formula = "measured phi_j = (1 + g_j) phi_j for every floor j with a sensor"
    source = "sensors of different make, or calibrated by different hands"
    stage = "shape"
    usual = 0.05
    probability = 0.01
    holds_in_words = "that the sensors show the motion"
    place_in_words = "what stands out is the sensor at"

    floors: tuple[int, ...] = ()
    """Floors with measured shapes, in the order of `parameters`."""

    def bound(self, experiment: Experiment) -> Self:
        own = super().bound(experiment)
        own.floors = tuple(_floors(experiment))
        return own

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return [Parameter(f"floor {floor}", "", lower=-0.9, upper=9.0) for floor in _floors(experiment)]

    def lacks(self, experiment: Experiment) -> str:
        return "" if len(_floors(experiment)) > 1 else "shapes at two floors or more"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        observation = state.observation
        for parameter, (floor, gain) in enumerate(zip(self.floors, values, strict=True), own.start):
            observation = observation.scaled(floor - 1, 1.0 + float(gain), parameter)
        return state.having(observation=observation)


def _floors(experiment: Experiment) -> list[int]:
    """List the floors with measured shapes."""
    return sorted({int(floor) for each in experiment.configurations for floor in each.measured_floors})


class _LessAccurate(OpenClass):
    """Data that are less accurate than declared, all by one unknown factor; the only unknown is the common size.

    An error of every datum, normal about zero with one common size s in declared standard deviations, equals a standard
    deviation larger by sqrt(1 + s^2).
    """

    stage = "shape"
    floors_move = ("one", "three")
    probability = 0.01
    rescales = True
    usual = 1.0

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return []

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # The effect changes the weight of the data, not their values.
        return state


class OtherShapes(_LessAccurate):
    """Errors beyond the standard deviation in all shape entries, of one state, of one floor, or of all tests.

    log s is normal about 0 with a standard deviation of 1.5.
    """

    name = "other_shapes"
    summary = "The shapes of one state, or at one floor, are less accurate than their standard deviation says."
    formula = "standard deviation of the shape entries of one state, of one floor or of all times an unknown factor"
    source = "a sensor on a soft bracket or that came loose, a clock, a mode that was not separated"
    sits_at = ("floor", "state")
    holds_in_words = "that the shapes are as accurate as their standard deviations"

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "shapes of a declared accuracy"

    def places(self, experiment: Experiment) -> list[Place]:
        """List each state with shapes, each floor with a sensor, and all at once, if an accuracy was declared.

        An undeclared accuracy is estimated anyway.
        """
        shown = [each for each in experiment.configurations if each.measured.any() and each.mode_shape_std is not None]
        states = dict.fromkeys(each.state for each in shown)
        floors = sorted({int(floor) for each in shown for floor in each.measured_floors})
        several = [Place(state=state) for state in states] if len(states) > 1 else []
        single = [Place(floor=floor) for floor in floors] if len(floors) > 2 else []
        return [*several, *single, *([Place()] if shown else [])]

    def rescaled(self, tested: Tested, noise: str, floors: Ints, place: Place) -> Bools:
        declared = isinstance(tested, Configuration) and tested.mode_shape_std is not None
        here = declared and noise == "mode_shape" and place.state in (None, tested.state)
        return (floors == place.floor) & here if place.floor is not None else np.full(len(floors), here)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        whose = f"the shapes at floor {place.floor}" if place.floor is not None else "the shapes"
        where = f'{whose} of "{place.state}"' if place.state is not None else whose
        return f"{where} are less accurate than their standard deviation says, in no way that the catalogue holds"


class OtherFrequencies(_LessAccurate):
    """Errors beyond the standard deviation in all frequencies.

    log s is normal about 0 with a standard deviation of 2. The formal deviations of a curve fit or of
    one record do not include the differences between tests, and may be ten to a hundred times too small.

    Considered if the declared deviations are below the default, `DEFAULT_FREQUENCY_STD`, and shapes were measured too.
    With frequencies alone, any change between tests would pass for their scatter.
    """

    name = "other_frequencies"
    summary = "The frequencies are less accurate than their standard deviations say, all by one factor."
    formula = "standard deviation of all frequencies times an unknown factor"
    source = "formal deviations of a curve fit or of one record, rounded digits, days that differ"
    size_width = 2.0
    holds_in_words = "that the frequencies are as accurate as their standard deviations"

    def lacks(self, experiment: Experiment) -> str:
        tests = experiment.configurations
        stated = [float(np.min(each.frequency_std)) for each in tests if each.frequency_std is not None]
        if min(stated, default=np.inf) >= DEFAULT_FREQUENCY_STD:
            return f"frequencies that are said to be better than {100 * DEFAULT_FREQUENCY_STD:g} %"
        return "" if any(each.measured.any() for each in tests) else "shapes"

    def rescaled(self, tested: Tested, noise: str, floors: Ints, place: Place) -> Bools:
        declared = isinstance(tested, Configuration) and tested.frequency_std is not None
        return np.full(len(floors), declared and noise == "frequency")

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return "the frequencies are less accurate than their standard deviations say"


#: One or two for each statement of the shear model, in the order of the reports.
OPEN_CLASSES: tuple[OpenClass, ...] = (
    OtherStiffness(),
    OtherInertia(),
    OtherBeams(),
    OtherChanges(),
    OtherLoads(),
    OtherGains(),
    OtherShapes(),
    OtherFrequencies(),
)
