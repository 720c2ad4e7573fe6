"""Masses that differ from the model or the declaration, the inertia of the columns, and masses on springs."""

import copy
from abc import abstractmethod
from collections import Counter
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place, shown_states
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.configuration import Configuration
from cvxshear.measurement.experiment import Experiment
from cvxshear.model import System
from cvxshear.motions import THREE_MOTIONS
from cvxshear.priors import Constraints
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats

#: Words for a mass above and below the declared one.
HEAVIER = ("heavier", "lighter")

#: Minimum attached mass, as a fraction of the mean floor mass, added to the parameter. The frame then has modes even if
#: the parameter is zero. The frequencies move by less than a millionth, unless the two are tuned to each other.
LEAST_MASS = 1e-6

#: Bounds of the attachment's frequency, in parts of the lowest and of the highest measured frequency. A slower
#: attachment acts like a missing mass on every mode, a faster one like an added mass.
LEAST_FREQUENCY, MOST_FREQUENCY = 0.5, 1.5

#: Attached mass at the start of a fit, in parts of the mean floor mass; without a declared total, in parts of the
#: largest added mass, or in kg without added mass. Fits from almost no mass stay at their start.
START_MASS = 0.05

#: Frequencies at the start of fits, in parts of the lowest and of the highest measured one. The places of twelve
#: simulated tanks and dampers were reached from five of them as from ten; without 0.8 and 2.0 three of nine were
#: missed. For a base with its own mass, on soil of stiffness s below story 1 of stiffness k, every floor moves with the
#: series of both springs and an attachment to floor 1. The attachment has (k / (k + s))^2 of the base's mass and the
#: frequency of the base between soil and story, which is above most modes.
FROM_THE_LOWEST, FROM_THE_HIGHEST = (1.1, 0.8, 2.0), (0.6, 1.2)

#: Bound of the frequency of loads on their mountings, in parts of the highest measured frequency. Faster loads act
#: within 1 % like loads on the bare floor.
STIFFEST_MOUNTING = 10.0


class AddedMass(Effect):
    """M + mass e e' at one floor in one state, or in one test of a state that was tested with loads.

    No floor can lose more than its own mass. Expected size: 15 % of the mean floor mass, a weight that was carried up
    or taken away; negative if the declared mass is too large. In one test, the entry of `added_mass` is wrong: the load
    was on another floor, or forgotten. This case has a third of the probability at each place.
    """

    name = "added_mass"
    summary = "In one state, or one test of it, a floor carries more or less mass than was declared."
    formula = "M + mass e_j e_j' in one state, or one test of it; of floors that turn, at (x, y) of the floor"
    source = "rigid mass at floor j"
    stage = "mass"
    floors_move = ("one", "three")
    parameters = (Parameter("mass", "kg"),)
    usual, usual_in = 0.15, "floor_mass"
    says = "floor {place.floor} carries {size} {word}{place.in_state} than declared"
    words = ("more", "less")
    sits_at = ("floor", "state")

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "several states"

    def places(self, experiment: Experiment) -> list[Place]:
        """List each floor in each state that may have changed, and in each of several tests of a state with loads."""
        of_states = super().places(experiment) if len(experiment.states) > 1 else []
        states = Counter(each.state for each in experiment.configurations)
        loaded = {each.state for each in experiment.configurations if states[each.state] > 1 and each.added_mass.any()}
        tests = [each for each in experiment.configurations if each.state in loaded]
        floors = range(1, experiment.stories + 1)
        return of_states + [Place(floor, state=each.state, test=each.name) for floor in floors for each in tests]

    def weight(self, place: Place, experiment: Experiment) -> float:
        return 1.0 if place.test is None else 1.0 / 3.0

    def bound_at(self, experiment: Experiment, place: Place) -> Effect:
        """Make a copy with the position as two further parameters, uniform over the plan, if the floors turn."""
        if not experiment.frame.turns:
            return self
        sides = zip("xy", experiment.half_plan[place.floor_index].tolist(), strict=True)
        return self.having([*self.parameters, *(Parameter(axis, "m", -half, half) for axis, half in sides)])

    def sizes(self, scale: Scale) -> Floats:
        return np.concatenate([super().sizes(scale)[:1], np.full(len(self.parameters) - 1, np.inf)])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        at = [f"{axis} = {with_std(x, dx, 'm')}" for axis, x, dx in zip("xy", values[1:], std[1:], strict=False)]
        return super().phrase(place, values, std, scale, units) + (f", at {' and '.join(at)}" if at else "")

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        if state.experiment.frame.turns:
            return _with_mass_at(state, place.floor_index, values, own)
        return state.plus_mass(values, on_floors([place.floor_index], len(state.floor_mass)), own)

    def dual(self, place: Place, stories: int) -> tuple[str, Place] | None:
        if place.test is not None:
            return None
        return "story_change", Place(story=stories - place.floor_index, state=place.state)

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        at = place.floor_index
        declared = [each.added_mass[at] for each in experiment.tested if LocatedEffect(self, place).acts_on(each)]
        size = experiment.parameters
        row = np.zeros(size + len(self.parameters))
        row[at * len(experiment.motions.mass_names)] = row[size] = -1.0
        return Constraints(G=row[None], h=np.array([min(declared, default=0.0)]))


def _with_mass_at(state: State, floor: int, values: Floats, own: slice) -> State:
    """Add a mass at (x, y) of a floor that turns, counted from 0."""
    mass, x, y = values.tolist()
    # Derivatives of the mass, the first moments and the inertia that it adds.
    by_values = [[1.0, x, y, x**2 + y**2], [0.0, mass, 0.0, 2.0 * mass * x], [0.0, 0.0, mass, 2.0 * mass * y]]
    slopes = np.tensordot(by_values, THREE_MOTIONS.mass_basis, 1)
    at = slice(3 * floor, 3 * floor + 3)
    M, dM = state.system.M.copy(), state.system.dM.copy()
    M[at, at] += mass * slopes[0]
    dM[own, at, at] += slopes
    return state.with_mass(M, dM)


class StateMass(Effect):
    """Every floor mass of the frame times 1 + e in one state; declared added masses do not change.

    In a state with an unmeasured mass scale, this effect and softer stories fit equally well.

    Expected size 10 %: a part of the live load of 1.5 to 3 kN/m2 in dwellings and offices (EN 1991-1-1), on floors that
    weigh 5 to 10 kN/m2. Between tests of a laboratory frame, a change of all floors would be recorded, so the prior
    probability is one frame in thirty.
    """

    name = "state_mass"
    summary = "All floors weigh more or less in one state by the same factor: live load, water, people."
    formula = "m_i (1 + e) for every floor i, in one state"
    source = "one factor on the floor masses"
    stage = "floor"
    floors_move = ("one", "three")
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    says = 'all floors of "{place.state}" are {size} {word}'
    words = HEAVIER
    usual = 0.1
    sits_at = ("state",)
    needs = ("several states",)
    probability = 0.03
    assumption_text = "that the floors of {state} did not all become heavier or lighter by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return _all_heavier(state, float(values[0]), own)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_stiffness", place


class MassCoupling(Effect):
    """The columns' mass mu a story, consistent (13/35, 9/70) in place of lumped (1/2, 0).

    Each story's columns add mu (13/35 - 1/2) to the diagonal at either end, and mu 9/70 between the two. The floor
    masses do not change: they hold half the columns of each adjoining story as lumped mass. So no floor is lighter than
    these halves: mu <= m_i, and mu / 2 <= m_N. The weight above a story comes from the lumped masses, so gravity acts
    before.

    Expected size: a tenth of the mean floor mass; columns and walls weigh 5 to 20 % of a floor in buildings, and less
    in laboratory frames, which seldom show the effect: 5 %.
    """

    name = "mass_coupling"
    summary = "The columns' own mass moves with both floors they join, and so couples neighbouring floors."
    formula = "M + mu sum over stories of [[13/35 - 1/2, 9/70], [9/70, 13/35 - 1/2]]"
    source = "consistent mass matrix of a Bernoulli beam in sway, Archer 1963"
    stage = "inertia"
    parameters = (Parameter("mu", "kg", lower=0.0),)
    says = "the columns of a story weigh {size}, and their mass moves with both floors that they join"
    usual, usual_in = 0.1, "floor_mass"
    probability = 0.05

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        stories = len(state.story_stiffness)
        ends = _ends(stories)
        unit = (13 / 35 - 1 / 2) * np.diag(ends) + (9 / 70) * (np.eye(stories, k=1) + np.eye(stories, k=-1))
        return state.plus_mass(values, unit[None], own)

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        n = experiment.stories
        lightest = np.hstack([-np.eye(n), np.zeros((n, n)), 0.5 * _ends(n)[:, None]])
        return Constraints(G=lightest, h=np.zeros(n))


def on_floors(floors: Sequence[int], stories: int) -> Floats:
    """Return unit masses on these floors, counted from 0, one matrix each, shape (p, N, N)."""
    units = np.zeros((len(floors), stories, stories))
    units[np.arange(len(floors)), floors, floors] = 1.0
    return units


def _all_heavier(state: State, part: float, own: slice) -> State:
    """Multiply the mass matrix without the declared added masses by 1 + part."""
    test = state.tested
    places = test.added_mass_position if isinstance(test, Configuration) else np.zeros(0)
    own_mass = state.system.M - state.experiment.motions.loads(test.added_mass, places)
    dM = (1.0 + part) * state.system.dM
    dM[own] += own_mass
    return state.with_mass(state.system.M + part * own_mass, dM)


def _ends(stories: int) -> Floats:
    """Return the number of stories that end at each floor; the base of story 1 does not move and does not count."""
    ends = np.full(stories, 2.0)
    ends[-1] = 1.0
    return ends


class TotalMass(Effect):
    """sum of the floor masses = total_mass (1 + e), or each of them its declared one times 1 + e.

    Considered if the total, or each floor, is declared exact and other data determine the mass scale: different added
    masses, scaled shapes, a static test, or a prior that fixes the scale.

    Expected size 10 %: masses that were weighed or taken from drawings omit bolts, cladding or live load. A total
    declared exact was usually weighed, so one such total in fifty is wrong by this size.
    """

    name = "total_mass"
    summary = "The frame is heavier or lighter than its declared total mass or floor masses, all by one factor."
    formula = "sum of m = total_mass (1 + e), or m_i = floor_masses_i (1 + e) for every floor i"
    source = "error of the declared total mass, or of a density on all floors"
    stage = "floor"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    says = "the frame is {size} {word} than its declared total mass"
    words = HEAVIER
    usual = 0.1
    probability = 0.02
    releases = ("total_mass",)
    assumption_text = "that the frame weighs what was declared"

    by_floor: bool = False
    """Whether every floor's mass is declared."""

    def bound(self, experiment: Experiment) -> Self:
        if experiment.frame.floor_masses is None:
            return self
        own = copy.copy(self)
        own.by_floor, own.says = True, "all floors are {size} {word} than declared"
        return own

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # The effect changes the required sum of the masses, not their inertia.
        return _all_heavier(state, float(values[0]), own) if self.by_floor else state

    def corrects(self, place: Place, floor_mass: Floats) -> Floats:
        return floor_mass[:, None] if self.by_floor else super().corrects(place, floor_mass)

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        total, n = experiment.frame.total_mass, experiment.stories
        if self.by_floor or total is None:
            return super().limits(experiment, place)
        row = np.concatenate([np.ones(n), np.zeros(n), [-total]])
        return Constraints(A=row[None], b=np.array([total]))

    def lacks(self, experiment: Experiment) -> str:
        frame = experiment.frame
        if frame.floor_masses is None and (frame.total_mass is None or frame.total_mass_std is not None):
            return "an exact total_mass or floor_masses"
        if not experiment.scale_known_otherwise:
            return "what else tells the scale of the masses, such as a second test with other added mass"
        return ""


class LoadScale(Effect):
    """Every declared added mass is 1 + e times the declared value.

    Considered if the total mass is declared and masses were added. If only the added masses determine the frame's mass,
    the factor scales all masses and stiffnesses, and no data determine it. If the total is declared exact, a wrong
    total (total_mass) changes every mode in the same way.

    Expected size 10 %: the weights were counted instead of weighed, weighed on an uncalibrated scale, or declared in
    another unit of force. Most weights are weighed, so one test in fifty has this effect.
    """

    name = "load_scale"
    summary = "All added masses are heavier or lighter than declared by the same factor."
    formula = "added mass a_j (1 + e) on every floor j, in every state"
    source = "calibration of the scale that weighed the added masses"
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    says = "the added masses are {size} {word} than declared"
    words = HEAVIER
    usual = 0.1
    probability = 0.02
    assumption_text = "that the added masses weigh what was declared"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_mass(values, np.diag(state.tested.added_mass)[None], own)

    def lacks(self, experiment: Experiment) -> str:
        if not any(each.added_mass.any() for each in experiment.tested):
            return "added_mass"
        frame = experiment.frame
        return "total_mass or floor_masses" if frame.total_mass is None and frame.floor_masses is None else ""


class _OnSprings(Effect):
    """Masses that move relative to the floors, at a frequency near the measured ones."""

    source = "Den Hartog, Mechanical Vibrations: the undamped absorber"
    stage = "attachment"
    adds_motion = True
    measured: tuple[float, float] = (1.0, 1.0)
    """Lowest and highest measured frequency, Hz."""

    def bound(self, experiment: Experiment) -> Self:
        """Make a copy with bounds of the frequency about the measured ones."""
        measured = np.concatenate([each.frequencies for each in experiment.configurations])
        lowest, highest = float(measured.min()), float(measured.max())
        own = self.having(self.ranged(experiment, lowest, highest))
        own.measured = lowest, highest
        return own

    @abstractmethod
    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        """Return the parameters for the range of the measured frequencies, Hz."""


class AttachedMass(_OnSprings):
    """M + m e_v e_v', K + m (2 pi f)^2 d d', d = e_v - e_j: one more degree of freedom v, without a sensor.

    f is the frequency of the mass on a fixed floor. The mass is not part of the floor masses or the declared total, and
    gravity does not include its weight. The frame has one more mode. Modes are numbered without the attachment's own
    mode, the one with the largest share of kinetic energy in the attachment. If two modes share this energy, as for a
    damper tuned to a mode, either may have been measured; then the numbers are the ones that fit the measured
    frequencies best (`data/base.py:numbered`).

    Expected size: 15 % of a floor's mass; tuned dampers weigh 1 to 5 % of the whole frame, tanks and machines 5 to 20 %
    of a floor (Soong and Dargush, Passive Energy Dissipation Systems). The prior of the frequency is uniform over the
    measured range. Such objects are visible, so one frame in fifty has an overlooked one. Dampers and tanks usually
    stand at the place of the largest motion, so the top floor has the same probability as all other floors together. In
    one state of several, the object was added or removed between the tests.
    """

    name = "attached_mass"
    summary = "A mass on a spring moves on one floor with a motion of its own: a tank, a machine, a tuned damper."
    formula = "M + m e_v e_v', K + m (2 pi f)^2 d d',  d = e_v - e_j"
    parameters = (Parameter("mass", "kg", lower=0.0), Parameter("frequency", "Hz", lower=0.01, upper=100.0, start=1.0))
    sits_at = ("floor",)
    probability = 0.02

    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        total = experiment.frame.known_total
        added = max(float(each.added_mass.max()) for each in experiment.configurations)
        floor = (added or 1.0) if total is None else total / experiment.stories
        start = FROM_THE_LOWEST[0] * lowest
        low, high = LEAST_FREQUENCY * lowest, MOST_FREQUENCY * highest
        return (
            Parameter("mass", "kg", lower=0.0, start=START_MASS * floor),
            Parameter("frequency", "Hz", low, high, null=start, start=start),
        )

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting points: one mass, with frequencies in the measured range."""
        mass, frequency = self.parameters
        lowest, highest = self.measured
        places = [*(part * lowest for part in FROM_THE_LOWEST), *(part * highest for part in FROM_THE_HIGHEST)]
        return tuple((mass.start, min(place, frequency.upper)) for place in places)

    def places(self, experiment: Experiment) -> list[Place]:
        floors = range(1, experiment.stories + 1)
        return [Place(floor=floor, state=state) for state in (None, *shown_states(experiment)) for floor in floors]

    def weight(self, place: Place, experiment: Experiment) -> float:
        return float(max(1, experiment.stories - 1)) if place.floor == experiment.stories else 1.0

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        stories = len(state.story_stiffness)
        by_mass = np.zeros(len(state.d_story_stiffness))
        by_mass[own.start] = 1.0
        by_mass[:stories] = LEAST_MASS / stories
        mass = float(values[0] + LEAST_MASS * np.mean(state.floor_mass))
        return with_attached(state, place.floor_index, mass, by_mass, float(values[1]), own.start + 1)

    def sizes(self, scale: Scale) -> Floats:
        return np.array([0.15 * scale.floor_mass, np.inf])

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        mass, frequency = (with_std(value, error, unit) for value, error, unit in zip(values, std, units, strict=True))
        said = f"a mass of {mass} swings on floor {place.floor} at {frequency} of its own{place.in_state}"
        return said if place.floor != 1 else f"{said}, or the base has a mass of its own on soft ground"


class LoadMounting(_OnSprings):
    """Every declared added mass a_j is attached to floor j by a spring a_j (2 pi f)^2.

    f is the frequency of the loads on fixed floors. In a mode of frequency w a load then acts as the mass a_j / (1 - (w
    / f)^2), which grows with the mode's frequency below f.

    The prior of f is uniform between the lowest measured frequency and ten times the highest; above, loads act within 1
    % like loads on the bare floor. Most weights are clamped or screwed down; weights on rubber, on sand bags or in a
    loose stack move in one loaded test out of thirty.
    """

    name = "load_mounting"
    summary = "The added masses are not fast to the floors: on rubber, on sand bags or in a loose stack they move."
    formula = "a_j off floor j; M + a_j e_v e_v', K + a_j (2 pi f)^2 d d',  d = e_v - e_j, for every load j"
    parameters = (Parameter("frequency", "Hz", lower=0.01, upper=1000.0, start=10.0),)
    says = "the added masses are not fast to the floors: they swing at {size}"
    probability = 0.03

    def ranged(self, experiment: Experiment, lowest: float, highest: float) -> Sequence[Parameter]:
        stiff = STIFFEST_MOUNTING * highest
        return [Parameter("frequency", "Hz", lower=lowest, upper=stiff, null=stiff, start=2.0 * highest)]

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting frequencies, from the measured range to above it."""
        lowest, highest = self.measured
        return tuple((float(each),) for each in (np.sqrt(lowest * highest), 1.2 * highest, 2.0 * highest))

    def lacks(self, experiment: Experiment) -> str:
        return "" if any(each.added_mass.any() for each in experiment.tested) else "added_mass"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        loads = state.tested.added_mass
        M, none = state.system.M.copy(), np.zeros(len(state.d_story_stiffness))
        at = np.arange(len(loads))
        M[at, at] -= loads
        state = state.with_mass(M, state.system.dM)
        for floor in np.flatnonzero(loads).tolist():
            state = with_attached(state, floor, float(loads[floor]), none, float(values[0]), own.start)
        return state


def with_attached(state: State, floor: int, mass: float, by_mass: Floats, frequency: float, own: int) -> State:
    """Attach a mass to one floor, with its own degree of freedom and without a sensor.

    Parameters
    ----------
    state : State
    floor : int
        Index of the floor, counted from 0.
    mass : float
        Attached mass, kg.
    by_mass : ndarray, shape (P,)
        Derivatives of the mass by all parameters.
    frequency : float
        Frequency of the mass on a fixed floor, Hz.
    own : int
        Index of the frequency among the parameters.
    """
    system = state.system
    square = (2 * np.pi * frequency) ** 2
    d = np.zeros(len(system.K) + 1)
    d[-1], d[floor] = 1.0, -1.0
    unit = np.outer(d, d)
    M, K, dM, dK = (_bordered(each) for each in (system.M, system.K, system.dM, system.dK))
    M[-1, -1] = mass
    dM[:, -1, -1] = by_mass
    K += mass * square * unit
    dK += (by_mass * square)[:, None, None] * unit
    dK[own] += mass * 2 * square / frequency * unit
    return state.having(system=System(M, K, dM, dK), observation=state.observation.extended())


def _bordered(matrices: Floats) -> Floats:
    """Append a row and a column of zeros to each matrix; `numpy.pad` takes many times longer for small ones."""
    *several, rows, columns = matrices.shape
    found = np.zeros((*several, rows + 1, columns + 1))
    found[..., :-1, :-1] = matrices
    return found
