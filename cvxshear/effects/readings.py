"""Errors of sensor readings, of declared masses and of declared statements."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.masses import HEAVIER, on_floors
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.declaration import StaticTest
from cvxshear.measurement.experiment import Configuration, Experiment, Tested
from cvxshear.priors import Constraints, Prior
from cvxshear.priors.base import QUANTITY_UNITS
from cvxshear.util import quantities, ranking
from cvxshear.util.typing import Floats


class SensorGain(Effect):
    """The measured shape entry at one floor is 1 + g times the true one, in every mode: in every test, or in one state.

    In one state, the sensor was exchanged or remounted between tests. This case is considered only if other states also
    have a shape at that floor; otherwise it equals the sensor's gain in every test.

    Expected size 5 %: calibrations of accelerometers hold within 1 to 10 % (ISO 16063-21 and the data sheets of MEMS
    sensors).
    """

    name = "sensor_gain"
    summary = "The sensor at one floor reads too much or too little by the same factor in every mode."
    formula = "measured phi_j = (1 + g) phi_j"
    source = "calibration error of one sensor"
    stage = "shape"
    floors_move = ("one", "three")
    parameters = (Parameter("g", "", lower=-0.9, upper=9.0),)
    says = "the sensor at {place.spot} reads {size} {word}{place.in_state}"
    words = ("too much", "too little")
    usual = 0.05
    sits_at = ("floor", "state")

    def places(self, experiment: Experiment) -> list[Place]:
        seen: dict[Place, dict[str, None]] = {}
        for each in experiment.configurations:
            for at, entries in zip(_sensors(each), each.measured.T, strict=True):
                if entries.any():
                    seen.setdefault(at, {})[each.state] = None
        everywhere = sorted(seen, key=lambda at: at.floor_index)
        return everywhere + [replace(at, state=state) for at in everywhere if len(seen[at]) > 1 for state in seen[at]]

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        row = place.floor_index
        if state.experiment.frame.turns:
            sensors = _sensors(state.tested)
            here = Place(floor=place.floor, part=place.part)
            if here not in sensors:
                return state
            row = sensors.index(here)
        return state.having(observation=state.observation.scaled(row, 1.0 + values[0], own.start))


def _sensors(tested: Tested) -> list[Place]:
    """List the floor of each entry of a shape; where floors turn, with direction and position of its sensor."""
    assert isinstance(tested, Configuration)
    if not tested.sensors:
        return [Place(floor=floor) for floor in tested.measured_floors.tolist()]
    return [
        Place(floor=each.floor, part="at ({:g}, {:g}) m along {:g} degrees".format(*each.position, each.direction))
        for each in tested.sensors
    ]


class ShapeScale(Effect):
    """The entries of mass-normalized shapes are 1 + g times the true ones: in every test, or in one state.

    They are scaled by the ratio of a force to an acceleration, so a force of the hammer or shaker that is read too
    large makes all entries too small. One state is considered alone if other states also have such shapes.

    Expected size 5 %, as for other sensors, with the probability of the gain of one sensor.
    """

    name = "shape_scale"
    summary = "All mass-normalized shapes are too large or too small by one factor: the force was misread."
    formula = "measured phi = (1 + g) phi, of mass-normalized shapes"
    source = "calibration error of the force, ISO 7626"
    stage = "shape"
    parameters = (Parameter("g", "", lower=-0.9, upper=9.0),)
    says = "all mass-normalized shapes{place.in_state} are {size} {word}, as where the force was misread"
    words = ("too large", "too small")
    usual = 0.05
    sits_at = ("state",)

    def places(self, experiment: Experiment) -> list[Place]:
        states = _normalized(experiment)
        return [Place() for _ in states[:1]] + [Place(state=state) for state in states if len(states) > 1]

    def lacks(self, experiment: Experiment) -> str:
        return "" if _normalized(experiment) else "mass-normalized shapes"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        tested, observation = state.tested, state.observation
        if isinstance(tested, Configuration) and tested.mass_normalized:
            for floor in range(len(state.floor_mass)):
                observation = observation.scaled(floor, 1.0 + values[0], own.start)
        return state.having(observation=observation)


def _normalized(experiment: Experiment) -> list[str]:
    """List the states with mass-normalized shapes."""
    shown = [each for each in experiment.configurations if each.mass_normalized and each.measured.any()]
    return list(dict.fromkeys(each.state for each in shown))


class ForceScale(Effect):
    """The displacements of every static test are 1 + g times the displacements under the declared forces.

    Expected size 5 %: load cells hold within 1 %. A force read off a spring or a crane's scale, or from weights that
    were not weighed, holds within 10 %. Dial gauges in inches instead of millimetres would be noticed.
    """

    name = "force_scale"
    summary = "The forces of the static tests are larger or smaller than declared, all by one factor."
    formula = "u = (1 + g) K^-1 p"
    source = "calibration error of a load cell"
    stage = "shape"
    parameters = (Parameter("g", "", lower=-0.9, upper=9.0),)
    says = "the forces of the static tests are {size} {word} than declared"
    words = ("larger", "smaller")
    usual = 0.05

    def lacks(self, experiment: Experiment) -> str:
        return "" if experiment.static else "a static test"

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        if not isinstance(state.tested, StaticTest):
            return state
        # A larger force on the same frame, and the same force on a softer frame, cause the same displacements.
        part = 1.0 / (1.0 + values[0])
        dK = part * state.system.dK
        dK[own] -= part**2 * state.system.K
        return state.with_stiffness(part * state.system.K, dK)


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
    says = "floor {place.floor} is {size} {word} than declared"
    words = HEAVIER
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


class _Statement(Effect):
    """A declared statement that does not hold; the effect changes the statement at its place, not the frame."""

    source = "design values and judgement that do not hold for the frame as built"
    stage = "story"
    parameters: tuple[Parameter, ...] = ()

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state


class WrongPrior(_Statement):
    """Every residual of one soft prior, or of a total mass with a standard deviation, has its own error.

    These errors, in standard deviations of the statement, are normal about zero with one common size. This equals a
    standard deviation larger by the corresponding factor.

    Expected size: five times the declared standard deviation, between 2 and 14 times in two thirds of all cases. A
    judgment "within 2 %" from drawings is sometimes wrong by 10 %. One statement in thirty does not hold.
    """

    name = "wrong_prior"
    summary = "A statement that was declared with a standard deviation is wrong by several times that."
    formula = "residual of the prior - e, e normal about 0 with a standard deviation of about 5"
    common_size = True
    usual = 5.0
    size_width = 1.0
    probability = 0.03

    def places(self, experiment: Experiment) -> list[Place]:
        return [Place(prior=words) for words, rows in experiment.soft_statements if rows]

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "a prior with a standard deviation"

    def bound_at(self, experiment: Experiment, place: Place) -> Self:
        rows = dict(experiment.soft_statements)[str(place.prior)]
        return self.having(Parameter(f"e{i}" if rows > 1 else "e", "") for i in range(1, rows + 1))

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        largest = float(np.max(np.abs(values)))
        return f'the statement "{place.prior}" is wrong by {largest:.1f} of its standard deviations'


class WrongExactPrior(_Statement):
    """A x = b + e in place of A x = b: a statement declared as exact does not hold.

    Each row is scaled to a largest coefficient of 1, so e is the error of a floor mass or a story stiffness.

    Expected size: a tenth of the mean mass or stiffness. Statements declared as exact are usually certain: one in fifty
    does not hold.
    """

    name = "wrong_exact_prior"
    summary = "A statement that was declared as exact, such as two floors alike, does not hold."
    formula = "A x = b + e for the rows of the statement"
    usual = 0.1
    probability = 0.02
    releases = ("prior",)
    assumption_text = 'that "{prior}" holds, as declared'

    def places(self, experiment: Experiment) -> list[Place]:
        stated = experiment.stated
        return [Place(prior=words) for words in stated if _equalities(stated[words], experiment)[1].size]

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "a prior that is an exact equation"

    def bound_at(self, experiment: Experiment, place: Place) -> Self:
        prior = experiment.stated[str(place.prior)]
        rows = len(_equalities(prior, experiment)[1])
        unit = QUANTITY_UNITS[prior.quantity]
        own = self.having(Parameter(f"e{i}" if rows > 1 else "e", unit) for i in range(1, rows + 1))
        own.about = prior.quantity
        return own

    about: str = "floor_mass"
    """Quantity in the statement."""

    def sizes(self, scale: Scale) -> Floats:
        return np.full(len(self.parameters), self.usual * getattr(scale, self.about))

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        A, b = _equalities(experiment.stated[str(place.prior)], experiment)
        n = experiment.stories
        wide = np.zeros((len(b), 2 * n + len(b)))
        at = 0 if self.about == "floor_mass" else n
        wide[:, at : at + n] = A
        wide[:, 2 * n :] = -np.eye(len(b))
        return Constraints(A=wide, b=b)

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        at = ranking.first_largest(np.abs(values))
        factor, unit = quantities.scaled([float(values[at])], units[at])
        size = quantities.with_std(abs(float(values[at])), float(std[at]), unit, factor)
        return f'the statement "{place.prior}", declared as exact, is off by {size}'


def _equalities(prior: Prior, experiment: Experiment) -> tuple[Floats, Floats]:
    """Return the exact equations of a prior, each scaled to a largest coefficient of 1; empty if the prior has none."""
    said = prior.constraints(experiment.stories)
    if said.A is None or said.b is None:
        return np.zeros((0, experiment.stories)), np.zeros(0)
    largest = np.max(np.abs(said.A), axis=1)
    return said.A / largest[:, None], said.b / largest
