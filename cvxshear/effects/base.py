"""What every physical effect is, and where it sits."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.priors import Constraints
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import with_std
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True)
class Parameter:
    """A number that an effect adds to the model.

    Parameters
    ----------
    name : str
    unit : str
        Empty for a ratio.
    lower, upper : float
        Physical bounds.
    null : float
        The value at which the effect vanishes.
    start : float
        Where a fit starts from.
    unit_in_stories : str
        Its unit where heights are not declared, so that lengths count in stories.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    null: float = 0.0
    start: float = 0.0
    unit_in_stories: str = ""


@dataclass(frozen=True)
class Place(InJson):
    """Where an effect sits; each part is None where it does not apply.

    Parameters
    ----------
    floor, story : int or None
        1 the lowest; floor 0 is the ground.
    state : str or None
        Of the frame.
    to : int or None
        The higher floor, where the effect joins two of them; `floor` is then the lower one.
    prior : str or None
        The declared statement that the effect is about, in words (`Experiment.soft_statements`). Its parameters are
        then what each residual of that statement is off by, in standard deviations.
    test : str or None
        Configuration of the state, where the effect is in no other one of it.
    """

    floor: int | None = None
    story: int | None = None
    state: str | None = None
    to: int | None = None
    prior: str | None = None
    test: str | None = None

    json_keys = "floor to story configuration prior"

    def describe(self) -> str:
        """In words, such as "floor 3 of test 2"; empty where it sits nowhere in particular."""
        parts = []
        if self.to is not None:
            parts.append(f"floors {self.floor} and {self.to}")
        elif self.floor is not None:
            parts.append(f"floor {self.floor}" if self.floor else "the base")
        if self.story is not None:
            parts.append(f"story {self.story}")
        if self.configuration is not None:
            parts.append(f'"{self.configuration}"')
        if self.prior is not None:
            parts.append(f'the statement "{self.prior}"')
        return " of ".join(parts)

    @property
    def floor_index(self) -> int:
        """Of an effect that sits at a floor, counted from 0."""
        assert self.floor is not None
        return self.floor - 1

    @property
    def configuration(self) -> str | None:
        """Name of the state, or of the one test of it."""
        return self.state if self.test is None else self.test

    @property
    def in_state(self) -> str:
        """Such as ' in "after"'; empty where it sits in every state."""
        return "" if self.configuration is None else f' in "{self.configuration}"'

    def label(self, subject: str) -> str:
        """Name what sits here and its place, such as "ground spring at floor 3" or "spring between floors 2 and 6"."""
        where = self.describe()
        return f"{subject} {'at' if self.to is None else 'between'} {where}" if where else subject


class Effect(ABC):
    """A physical effect that the shear model lacks.

    One of your own is a subclass with these attributes and `apply`; hand it to `close_loop` or register it.

    Attributes
    ----------
    name : str
        Its word in files and results.
    summary : str
        One sentence for a reader who has never heard of it.
    formula : str
        What it adds to the model.
    source : str
        Where the formula comes from.
    stage : str
        One of `STAGES`: what it acts on.
    kind : str
        "cause", or "open" for a class that says "something else, whatever it is" of one statement of the shear model.
    parameters : tuple of Parameter
        An effect whose number of parameters depends on the experiment sets them in `bound`.
    sits_at : tuple of str
        Of "floor", "to", "story", "state": what its place names.
    needs : tuple of str
        Of "heights", "several states".
    lowest_floor : int
        The lowest floor it can sit at.
    probability : float
        That a tested frame has it somewhere, before anything is measured.
    usual : float
        The size of its parameters that practice meets, in parts of `usual_in`; infinite where any value between their
        bounds is as probable.
    usual_in : str
        "floor_mass" or "story_stiffness", the mean of the frame that `usual` is a part of; empty for the parameter's
        own unit.
    size : float or None
        Expected size of the first parameter, in its unit, in place of that of `sizes`.
    tail : float
        Degrees of freedom of Student's t, the prior of each parameter about its null value: the fewer, the more
        probable are sizes far beyond the expected one; infinite for a normal prior.
    common_size : bool
        Whether the parameters have one common size that is unknown itself. Their prior is then normal, its standard
        deviation `sizes` times a factor whose logarithm has the standard deviation `size_width` about zero.
    size_width : float
    rescales : bool
        Whether it leaves open how accurate some data are (`rescaled`); such an effect has no parameters of its
        own, and the factor on their standard deviations is its common size.
    granted : str
        What a verdict takes for granted as long as this effect is not in it, where the data hardly tell: a clause such
        as "that the floors of {state} weigh what they did", or one with {prior}. Empty where there is nothing to say.
    releases : tuple of str
        Of "total_mass", "prior" (the one at its place): declarations that do not hold as they stand where it is in the
        model.
    adds_motion : bool
        Whether the frame has one motion more with it. What it does is then not told by derivatives at its null value,
        and a fit begins at its start values.
    uses_heights : bool
        Whether it takes undeclared story heights as equal.
    beside : str
        Name of the effect without which this one does nothing; empty where it needs none.
    companion : str
        Name of an effect beside which, at the same place, this one has another prior probability, `accompanies`; empty
        where there is none.
    accompanies : float
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    stage: ClassVar[str]
    kind: ClassVar[str] = "cause"
    parameters: tuple[Parameter, ...]
    sits_at: tuple[str, ...] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    lowest_floor: ClassVar[int] = 1
    probability: float = 0.1
    usual: ClassVar[float] = np.inf
    usual_in: ClassVar[str] = ""
    size: float | None = None
    tail: ClassVar[float] = 4.0
    common_size: ClassVar[bool] = False
    size_width: ClassVar[float] = 1.0
    rescales: ClassVar[bool] = False
    granted: ClassVar[str] = ""
    releases: ClassVar[tuple[str, ...]] = ()
    adds_motion: ClassVar[bool] = False
    uses_heights: ClassVar[bool] = False
    beside: ClassVar[str] = ""
    companion: ClassVar[str] = ""
    accompanies: ClassVar[float] = 0.2

    @abstractmethod
    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        """Put this effect into the state.

        Parameters
        ----------
        state : State
        place : Place
        values : ndarray, shape (p,)
            The effect's parameters.
        own : slice
            Which rows of the derivatives are by these parameters.

        Returns
        -------
        State
            With matrices and derivatives changed; those by other parameters too, where they change.
        """

    def bound(self, experiment: Experiment) -> Effect:
        """Return the effect for this experiment: itself, or a copy whose `parameters` or `sits_at` depend on it."""
        return self

    def bound_at(self, experiment: Experiment, place: Place) -> Effect:
        """Return the effect for one place: itself, or a copy whose `parameters` depend on the place."""
        return self

    def rescaled(self, tested: Tested, noise: str, floors: Ints, place: Place) -> Bools:
        """Which residuals of a kind of datum have a standard deviation that is left open; none by default.

        Parameters
        ----------
        tested : Configuration or StaticTest
        noise : str
            Kind of noise.
        floors : ndarray of int, shape (d,)
            That each residual was measured at.
        place : Place

        Returns
        -------
        ndarray of bool, shape (d,)
        """
        return np.zeros(len(floors), dtype=bool)

    def corrects(self, place: Place, floor_mass: Floats) -> Floats:
        """Find what a unit of each parameter adds to the declared floor masses that it puts right, shape (N, p), kg.

        Zeros where it is something besides the floors, or where their masses are identified.
        """
        return np.zeros((len(floor_mass), len(self.parameters)))

    def dual(self, place: Place, stories: int) -> tuple[str, Place] | None:
        """Name and place of the effect that has the same frequencies in the dual chain; None where there is none.

        A chain of N stories k_i and floors m_i has, without added mass, the eigenvalues of the chain with stories
        1 / m_(N+1-i) and floors 1 / k_(N+1-i): T D_k T' D_m^-1 and D_m^-1 T D_k T' have the same ones, and reversing
        the order of the floors turns T into T'. So frequencies alone cannot tell a softer story from a heavier floor.

        Parameters
        ----------
        place : Place
        stories : int
            Number N of stories.
        """
        return None

    def sizes(self, scale: Scale) -> Floats:
        """Return the size that practice meets, shape (p,): standard deviations of the parameters about null.

        Infinite where a parameter is as probable anywhere between its bounds; `usual` of each by default.
        """
        return np.full(len(self.parameters), self.usual * (getattr(scale, self.usual_in) if self.usual_in else 1.0))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Points that fits of the parameters start at, where one does not lead everywhere."""
        return (tuple(item.start for item in self.parameters),)

    def expected_sizes(self, scale: Scale) -> Floats:
        """`sizes`, the first of them `size` where that is given; all of them where they have one common size."""
        usual = self.sizes(scale)
        if self.size is None:
            return usual
        return np.full(len(usual), self.size) if self.common_size else np.concatenate([[self.size], usual[1:]])

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        """Return what is possible beyond the parameters' own bounds, as rows on masses, stiffnesses, parameters.

        The rows have 2N + p entries: floor masses, story stiffnesses, the effect's own parameters; none by default.
        """
        return Constraints()

    def lacks(self, experiment: Experiment) -> str:
        """Return what the experiment would have to declare for this effect to be looked for; empty where it has all."""
        if "heights" in self.needs and experiment.frame.story_heights is None:
            return "story_heights"
        if "several states" in self.needs and len(experiment.states) < 2:
            return "several states"
        return ""

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        """Effect, place and size in words: a clause that can stand as a sentence of its own.

        Parameters
        ----------
        place : Place
        values, std : ndarray, shape (p,)
            Parameters and their standard deviations, nan where not determined.
        scale : Scale
            Of the frame that was found.
        units : sequence of str
            Of the parameters.
        """
        sizes = ", ".join(
            f"{item.name} = {with_std(float(value), float(error), unit)}"
            for item, value, error, unit in zip(self.parameters, values, std, units, strict=True)
        )
        return f"{place.label(self.label)} is there ({sizes})"

    def known_anyway(self, experiment: Experiment, floor_mass: Floats, story_stiffness: Floats) -> str:
        """Return a sentence on what is known of the effect even where the data do not show it; empty by default."""
        return ""

    @property
    def label(self) -> str:
        """Its name as words."""
        return self.name.replace("_", " ")

    def expecting(self, *, size: float | None = None, probability: float | None = None) -> Self:
        """Return the same effect with another size of its first parameter, in its unit, or another probability."""
        changed = copy.copy(self)
        if probability is not None:
            if not 0.0 < probability < 1.0:
                raise InputError(f"the probability of {self.name} must lie between 0 and 1, not {probability:g}")
            changed.probability = probability
        if size is not None:
            changed.size = checks.number(size, f"the size of {self.name}", above=0.0)
        return changed

    def having(self, parameters: Iterable[Parameter]) -> Self:
        """Return the same effect with other parameters."""
        changed = copy.copy(self)
        changed.parameters = tuple(parameters)
        return changed

    def places(self, experiment: Experiment) -> list[Place]:
        """Everywhere the effect can sit in this experiment."""
        stories = range(1, experiment.stories + 1)
        floors = list(range(self.lowest_floor, experiment.stories + 1)) if "floor" in self.sits_at else [None]
        levels = list(stories) if "story" in self.sits_at else [None]
        states = list(experiment.changed_states) if "state" in self.sits_at else [None]
        return [Place(floor, story, state) for floor in floors for story in levels for state in states]

    def weight(self, place: Place, experiment: Experiment) -> float:
        """How probable it is at a place in relation to others; the same everywhere by default."""
        return 1.0


def shown_states(experiment: Experiment) -> list[str]:
    """List, of several states, those that may have changed and whose shapes were measured.

    A few frequencies more or less do not tell a spring or a tank in one state from stories that changed.
    """
    shown = {each.state for each in experiment.configurations if each.measured.any()}
    return [state for state in experiment.changed_states if state in shown] if len(experiment.states) > 1 else []


@dataclass(frozen=True)
class Placed(InJson):
    """An effect at a place.

    Parameters
    ----------
    effect : Effect
    place : Place
    fixed : tuple of float, optional
        Values at which its parameters are held; free where empty.
    """

    effect: Effect
    place: Place = Place()
    fixed: tuple[float, ...] = ()

    json_keys = "name=effect.name *place"

    @property
    def start(self) -> tuple[float, ...]:
        """Where a fit of its parameters starts."""
        return self.fixed or tuple(item.start for item in self.effect.parameters)

    @property
    def label(self) -> str:
        """Such as "ground spring at floor 4"."""
        return self.place.label(self.effect.label)

    def acts_on(self, tested: Tested) -> bool:
        """Whether this state of the frame has the effect in it."""
        return self.place.state in (None, tested.state) and self.place.test in (None, tested.name)

    def units(self, experiment: Experiment) -> tuple[str, ...]:
        """Of its parameters; lengths count in stories where heights are not declared."""
        metric = experiment.frame.story_heights is not None
        return tuple(item.unit if metric else item.unit_in_stories or item.unit for item in self.effect.parameters)


def in_percent(value: float, std: float) -> str:
    """Return the size of a ratio and its standard deviation, without the sign, such as "15.1 ± 0.4 %"."""
    return with_std(100 * abs(float(value)), 100 * float(std), "%")


def off_by(value: float, std: float, above: str, below: str) -> str:
    """Return a ratio in words, such as "15.1 ± 0.4 % heavier"."""
    return f"{in_percent(value, std)} {above if value > 0 else below}"
