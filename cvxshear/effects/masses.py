"""Masses that differ from the model or the declaration, and the inertia of the columns' own mass."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place, off_by
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class AddedMass(Effect):
    """M + mass e e' at one floor in one state, or in one test of a state that was tested with loads.

    No floor can lose more than its own mass. Expected size: 15 % of the mean floor mass, a weight that was carried up
    or taken away; negative if the declared mass is too large. In one test, the entry of `added_mass` is wrong: the load
    was on another floor, or forgotten. This case has a third of the probability at each place.
    """

    name = "added_mass"
    summary = "In one state, or one test of it, a floor carries more or less mass than was declared."
    formula = "M + mass e_j e_j' in one state, or one test of it"
    source = "rigid mass at floor j"
    stage = "mass"
    parameters = (Parameter("mass", "kg"),)
    usual, usual_in = 0.15, "floor_mass"
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

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_mass(values, on_floors([place.floor_index], len(state.floor_mass)), own)

    def dual(self, place: Place, stories: int) -> tuple[str, Place] | None:
        if place.test is not None:
            return None
        return "story_change", Place(story=stories - place.floor_index, state=place.state)

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        at = place.floor_index
        declared = [each.added_mass[at] for each in experiment.tested if LocatedEffect(self, place).acts_on(each)]
        row = np.zeros(2 * experiment.stories + 1)
        row[at] = row[-1] = -1.0
        return Constraints(G=row[None], h=np.array([min(declared, default=0.0)]))

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = with_std(abs(values[0]), std[0], units[0])
        word = "more" if values[0] > 0 else "less"
        return f"floor {place.floor} carries {size} {word}{place.in_state} than declared"


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
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    usual = 0.1
    sits_at = ("state",)
    needs = ("several states",)
    probability = 0.03
    granted = "that the floors of {state} did not all become heavier or lighter by one factor"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return _all_heavier(state, float(values[0]), own)

    def dual(self, place: Place, stories: int) -> tuple[str, Place]:
        return "state_stiffness", place

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f'all floors of "{place.state}" are {off_by(values[0], std[0], "heavier", "lighter")}'


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
    summary = (
        "The columns' own mass moves with both floors they join, which couples neighbouring floors through the mass."
    )
    formula = "M + mu sum over stories of [[13/35 - 1/2, 9/70], [9/70, 13/35 - 1/2]]"
    source = "consistent mass matrix of a Bernoulli beam in sway, Archer 1963"
    stage = "inertia"
    parameters = (Parameter("mu", "kg", lower=0.0),)
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

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = with_std(values[0], std[0], units[0])
        return f"the columns of a story weigh {size}, and their mass moves with both floors that they join"


def on_floors(floors: Sequence[int], stories: int) -> Floats:
    """Return unit masses on these floors, counted from 0, one matrix each, shape (p, N, N)."""
    units = np.zeros((len(floors), stories, stories))
    units[np.arange(len(floors)), floors, floors] = 1.0
    return units


def _all_heavier(state: State, part: float, own: slice) -> State:
    """Multiply all floor masses by 1 + part."""
    at = np.arange(len(state.floor_mass))
    M, dM = state.system.M.copy(), state.system.dM.copy()
    M[at, at] += part * state.floor_mass
    dM[at, at, at] += part
    dM[own, at, at] += state.floor_mass
    return state.with_mass(M, dM)


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
    stage = "mass"
    parameters = (Parameter("e", "", lower=-0.9, upper=9.0),)
    usual = 0.1
    probability = 0.02
    releases = ("total_mass",)
    granted = "that the frame weighs what was declared"

    by_floor: bool = False
    """Whether every floor's mass is declared."""

    def bound(self, experiment: Experiment) -> Self:
        if experiment.frame.floor_masses is None:
            return self
        own = copy.copy(self)
        own.by_floor = True
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

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        if self.by_floor:
            return f"all floors are {off_by(values[0], std[0], 'heavier', 'lighter')} than declared"
        return f"the frame is {off_by(values[0], std[0], 'heavier', 'lighter')} than its declared total mass"


class FloorMass(Effect):
    """M + mass e_j e_j' at one floor in every state: the declared mass of that floor is wrong.

    Considered if floor_masses are declared, which are exact; an identified mass would absorb the effect.

    Expected size: a quarter of the mean floor mass, such as a floor finish or a facade that the estimate from drawings
    omits. Floor masses declared exact were usually weighed: one frame in twenty has a wrong entry.
    """

    name = "floor_mass"
    summary = "A floor is heavier or lighter than its entry of floor_masses."
    formula = "M + mass e_j e_j' in every state"
    source = "error of one declared floor mass"
    stage = "mass"
    parameters = (Parameter("mass", "kg"),)
    usual, usual_in = 0.25, "floor_mass"
    probability = 0.05
    sits_at = ("floor",)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_mass(values, on_floors([place.floor_index], len(state.floor_mass)), own)

    def corrects(self, place: Place, floor_mass: Floats) -> Floats:
        return np.eye(len(floor_mass))[:, [place.floor_index]]

    def lacks(self, experiment: Experiment) -> str:
        return "floor_masses" if experiment.frame.floor_masses is None else ""

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        row = np.zeros(2 * experiment.stories + 1)
        row[place.floor_index] = row[-1] = -1.0
        return Constraints(G=row[None], h=np.zeros(1))

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        size = with_std(abs(values[0]), std[0], units[0])
        return f"floor {place.floor} is {size} {'heavier' if values[0] > 0 else 'lighter'} than declared"


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
    usual = 0.1
    probability = 0.02
    granted = "that the added masses weigh what was declared"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state.plus_mass(values, np.diag(state.tested.added_mass)[None], own)

    def lacks(self, experiment: Experiment) -> str:
        if not any(each.added_mass.any() for each in experiment.tested):
            return "added_mass"
        frame = experiment.frame
        return "total_mass or floor_masses" if frame.total_mass is None and frame.floor_masses is None else ""

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        return f"the added masses are {off_by(values[0], std[0], 'heavier', 'lighter')} than declared"
