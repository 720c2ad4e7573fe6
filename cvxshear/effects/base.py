"""Base class of the physical effects, and their places."""

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
from cvxshear.util import checks, errors, quantities
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Floats, Ints, Json


@dataclass(frozen=True)
class Parameter:
    """Number that an effect adds to the model.

    Parameters
    ----------
    name : str
    unit : str
        Empty for a ratio.
    lower, upper : float
        Physical bounds.
    null : float
        Value at which the effect vanishes.
    start : float
        Value at which a fit starts.
    unit_in_stories : str
        Unit if heights are not declared, so that lengths count in stories.
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
    """Place of an effect; each part that does not apply is None.

    Parameters
    ----------
    floor, story : int or None
        The lowest is 1; floor 0 is the ground.
    state : str or None
        State of the frame.
    to : int or None
        Higher floor, if the effect joins two floors; `floor` is then the lower one.
    prior : str or None
        Declared statement that the effect contradicts, in words (`Experiment.soft_statements`). The parameters are
        then the errors of the residuals of this statement, in standard deviations.
    test : str or None
        Configuration of the state, if the effect is present in this configuration only.
    part : str or None
        Part of a floor or story that turns, in words: a direction, "in x"; a side, "in x at y > 0"; a sensor.
    """

    floor: int | None = None
    story: int | None = None
    state: str | None = None
    to: int | None = None
    prior: str | None = None
    test: str | None = None
    part: str | None = None

    json_keys = "floor to story configuration prior"

    def to_dict(self) -> Json:
        """Return the documented JSON; the part only if there is one."""
        return super().to_dict() | ({} if self.part is None else {"part": self.part})

    def describe(self) -> str:
        """Describe the place, such as "floor 3 of test 2"; empty if the effect has no particular place."""
        parts = []
        if self.to is not None:
            parts.append(f"floors {self.floor} and {self.to}")
        elif self.floor is not None:
            parts.append(f"floor {self.floor}" if self.floor else "the base")
        if self.story is not None:
            parts.append(f"story {self.story}")
        if self.part is not None:
            parts = [" ".join((*parts, self.part))]
        if self.configuration is not None:
            parts.append(f'"{self.configuration}"')
        if self.prior is not None:
            parts.append(f'the statement "{self.prior}"')
        return " of ".join(parts)

    @property
    def floor_index(self) -> int:
        """Index of the floor of the effect, counted from 0."""
        assert self.floor is not None
        return self.floor - 1

    @property
    def configuration(self) -> str | None:
        """Name of the state, or of one of its tests."""
        return self.state if self.test is None else self.test

    @property
    def spot(self) -> str:
        """Floor and part of it."""
        return f"floor {self.floor}{f' {self.part}' if self.part else ''}"

    @property
    def in_state(self) -> str:
        """Phrase such as ' in "after"'; empty for an effect in every state."""
        return "" if self.configuration is None else f' in "{self.configuration}"'

    def label(self, subject: str) -> str:
        """Return a subject with its place, such as "ground spring at floor 3" or "spring between floors 2 and 6"."""
        where = self.describe()
        if self.part is not None and self.floor is self.story is None:
            return f"{subject} {where}"
        return f"{subject} {'at' if self.to is None else 'between'} {where}" if where else subject


class Effect(ABC):
    """Physical effect that the shear model lacks.

    A user-defined effect is a subclass with these attributes and `apply`; pass it to `close_loop` or register it.

    Attributes
    ----------
    name : str
        Name in files and results.
    summary : str
        One sentence for a reader who does not know the effect.
    formula : str
        Terms that the effect adds to the model.
    source : str
        Source of the formula.
    stage : str
        One of `STAGES`: the quantities that the effect changes.
    kind : str
        "cause", or "open" for a class of all deviations from one statement of the shear model.
    parameters : tuple of Parameter
        If their number depends on the experiment, the effect sets them in `bound`.
    sits_at : tuple of str
        Parts of its place, among "floor", "to", "story", "state".
    needs : tuple of str
        Requirements, among "heights", "several states".
    lowest_floor : int
        Lowest possible floor of the effect.
    probability : float
        Prior probability that a tested frame has the effect at one or more places.
    usual : float
        Usual size of the parameters in practice, in parts of `usual_in`; infinite for a uniform prior between the
        bounds.
    usual_in : str
        "floor_mass" or "story_stiffness": the mean of the frame that is the unit of `usual`; empty for the parameter's
        own unit.
    size : float or None
        Expected size of the first parameter, in its unit; replaces the value from `sizes`.
    says : str
        Clause on the effect for the first parameter, with {size}, {place} (a `Place`) and {word} in it, the first of
        `words` for a value above null and the second below; empty if `phrase` is written out.
    words : tuple of str
    tail : float
        Degrees of freedom of Student's t, the prior of each parameter about its null value. Fewer degrees of freedom
        make sizes far above the expected one more probable; infinite for a normal prior.
    common_size : bool
        Whether the parameters have one unknown common size. Their prior is then normal. Its standard deviation is
        `sizes` times a factor, and the logarithm of the factor has the standard deviation `size_width` about zero.
    size_width : float
    rescales : bool
        Whether the effect leaves the accuracy of some data open (`rescaled`). Such an effect has no parameters of its
        own; its common size is the factor on the standard deviations of these data.
    assumption_text : str
        Assumption of a verdict without this effect, reported if the data hardly test the effect: a clause such as
        "that the floors of {state} weigh what they did", or one with {prior}. Empty if there is no such assumption.
    releases : tuple of str
        Declarations that the effect cancels in the model, among "total_mass" and "prior" (the prior at its place).
    adds_motion : bool
        Whether the effect adds a degree of freedom. Derivatives at the null value then do not show its influence, and a
        fit begins at its start values.
    uses_heights : bool
        Whether the effect assumes equal story heights if they are not declared.
    floors_move : tuple of str
        Floors that it is written for, among "one" (motion a floor) and "three".
    beside : str
        Name of another effect that this one requires; without the other, this one has no influence. Empty if none.
    companion : str
        Name of an effect that changes the prior probability of this one at the same place to `accompanies`; empty if
        there is none.
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
    says: str = ""
    words: ClassVar[tuple[str, str]] = ("", "")
    tail: ClassVar[float] = 4.0
    common_size: ClassVar[bool] = False
    size_width: ClassVar[float] = 1.0
    rescales: ClassVar[bool] = False
    assumption_text: ClassVar[str] = ""
    releases: ClassVar[tuple[str, ...]] = ()
    adds_motion: ClassVar[bool] = False
    uses_heights: ClassVar[bool] = False
    floors_move: ClassVar[tuple[str, ...]] = ("one",)
    beside: ClassVar[str] = ""
    companion: ClassVar[str] = ""
    accompanies: ClassVar[float] = 0.2

    @abstractmethod
    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        """Apply this effect to the state.

        Parameters
        ----------
        state : State
        place : Place
        values : ndarray, shape (p,)
            The effect's parameters.
        own : slice
            Rows of the derivatives by these parameters.

        Returns
        -------
        State
            State with changed matrices and derivatives, also the derivatives by other parameters if they change.
        """

    def bound(self, experiment: Experiment) -> Effect:
        """Return the effect for this experiment: itself, or a copy whose `parameters` or `sits_at` depend on it."""
        return self

    def bound_at(self, experiment: Experiment, place: Place) -> Effect:
        """Return the effect for one place: itself, or a copy whose `parameters` depend on the place."""
        return self

    def rescaled(self, tested: Tested, noise: str, floors: Ints, place: Place) -> Bools:
        """Return the residuals of a kind of datum with an open standard deviation; none by default.

        Parameters
        ----------
        tested : Configuration or StaticTest
        noise : str
            Kind of noise.
        floors : ndarray of int, shape (d,)
            Floor of each residual.
        place : Place

        Returns
        -------
        ndarray of bool, shape (d,)
        """
        return np.zeros(len(floors), dtype=bool)

    def corrects(self, place: Place, floor_mass: Floats) -> Floats:
        """Return the correction of the declared floor masses per unit of each parameter, shape (N, p), kg.

        Zeros if the effect is separate from the floors, or if the floor masses are identified.
        """
        return np.zeros((len(floor_mass), len(self.parameters)))

    def dual(self, place: Place, stories: int) -> tuple[str, Place] | None:
        """Return name and place of the effect with the same frequencies in the dual chain; None if there is none.

        A chain of N stories k_i and floors m_i has, without added mass, the eigenvalues of the chain with stories 1 /
        m_(N+1-i) and floors 1 / k_(N+1-i): T D_k T' D_m^-1 and D_m^-1 T D_k T' have the same eigenvalues, and reversing
        the order of the floors turns T into T'. So frequencies alone cannot distinguish a softer story from a heavier
        floor.

        Parameters
        ----------
        place : Place
        stories : int
            Number N of stories.
        """
        return None

    def sizes(self, scale: Scale) -> Floats:
        """Return the usual sizes in practice, shape (p,): standard deviations of the parameters about null.

        By default `usual` for each parameter; infinite for a uniform prior between the bounds.
        """
        return np.full(len(self.parameters), self.usual * (getattr(scale, self.usual_in) if self.usual_in else 1.0))

    @property
    def starts(self) -> tuple[tuple[float, ...], ...]:
        """Starting points of fits of the parameters; several if one does not reach every optimum."""
        return (tuple(item.start for item in self.parameters),)

    def expected_sizes(self, scale: Scale) -> Floats:
        """Return `sizes`, with `size` in place of the first if given (in place of all if they have one common size)."""
        usual = self.sizes(scale)
        if self.size is None:
            return usual
        return np.full(len(usual), self.size) if self.common_size else np.concatenate([[self.size], usual[1:]])

    def limits(self, experiment: Experiment, place: Place) -> Constraints:
        """Return the limits in addition to the parameters' own bounds, as rows on masses, stiffnesses, parameters.

        The rows have 2N + p entries: floor masses, story stiffnesses, the effect's own parameters; none by default.
        """
        return Constraints()

    def lacks(self, experiment: Experiment) -> str:
        """Return the missing declarations that the effect requires; empty if the experiment has them all."""
        if "heights" in self.needs and experiment.frame.story_heights is None:
            return "story_heights"
        if "several states" in self.needs and len(experiment.states) < 2:
            return "several states"
        return ""

    def unavailable(self, experiment: Experiment) -> str:
        """Return what the experiment lacks, its kind of floors first; empty if the effect can be looked for."""
        if not self.suits(experiment):
            return "floors that do not turn" if experiment.frame.turns else "floors that turn"
        return self.lacks(experiment)

    def suits(self, experiment: Experiment) -> bool:
        """Whether the effect is written for such floors."""
        return ("three" if experiment.frame.turns else "one") in self.floors_move

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        """Describe effect, place and size: a clause that can be a sentence of its own.

        Parameters
        ----------
        place : Place
        values, std : ndarray, shape (p,)
            Parameters and their standard deviations, nan if not determined.
        scale : Scale
            Scale of the identified frame.
        units : sequence of str
            Units of the parameters.
        """
        if self.says:
            size = without_sign(values[0], std[0], units[0])
            return self.says.format(size=size, word=self.words[int(values[0] < 0)], place=place)
        sizes = ", ".join(
            f"{item.name} = {quantities.with_std(float(value), float(error), unit)}"
            for item, value, error, unit in zip(self.parameters, values, std, units, strict=True)
        )
        return f"{place.label(self.label)} is there ({sizes})"

    def of_story(self, place: Place, stories: int) -> tuple[int, str] | None:
        """Return the one story whose stiffness the effect changes, and the part of it that changes, such as "its feet".

        The phrase of such an effect says first, up to a colon, what the story lost or gained. None by default.
        """
        return None

    def known_anyway(self, experiment: Experiment, floor_mass: Floats, story_stiffness: Floats) -> str:
        """Return a sentence on prior knowledge of the effect that the data need not show; empty by default."""
        return ""

    @property
    def label(self) -> str:
        """Name of the effect in words."""
        return self.name.replace("_", " ")

    def expecting(self, *, size: float | None = None, probability: float | None = None) -> Self:
        """Return the same effect with another size of its first parameter, in its unit, or another probability."""
        changed = copy.copy(self)
        if probability is not None:
            if not 0.0 < probability < 1.0:
                raise errors.InputError(f"the probability of {self.name} must lie between 0 and 1, not {probability:g}")
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
        """List all places of the effect in this experiment."""
        stories = range(1, experiment.stories + 1)
        floors = list(range(self.lowest_floor, experiment.stories + 1)) if "floor" in self.sits_at else [None]
        levels = list(stories) if "story" in self.sits_at else [None]
        states = list(experiment.changed_states) if "state" in self.sits_at else [None]
        return [Place(floor, story, state) for floor in floors for story in levels for state in states]

    def weight(self, place: Place, experiment: Experiment) -> float:
        """Return the relative probability of a place; equal for all places by default."""
        return 1.0


def shown_states(experiment: Experiment) -> list[str]:
    """List the states that may have changed and that have measured shapes, if there are several states.

    A few more frequencies do not distinguish a spring or a tank in one state from changed stories.
    """
    shown = {each.state for each in experiment.configurations if each.measured.any()}
    return [state for state in experiment.changed_states if state in shown] if len(experiment.states) > 1 else []


@dataclass(frozen=True)
class LocatedEffect(InJson):
    """Effect at a place.

    Parameters
    ----------
    effect : Effect
    place : Place
    fixed : tuple of float, optional
        Fixed values of its parameters; the parameters are free if empty.
    """

    effect: Effect
    place: Place = Place()
    fixed: tuple[float, ...] = ()

    json_keys = "name=effect.name *place"

    @property
    def start(self) -> tuple[float, ...]:
        """Starting values of a fit of its parameters."""
        return self.fixed or tuple(item.start for item in self.effect.parameters)

    @property
    def label(self) -> str:
        """Name and place, such as "ground spring at floor 4"."""
        return self.place.label(self.effect.label)

    def acts_on(self, tested: Tested) -> bool:
        """Whether the effect is present in this tested state."""
        return self.place.state in (None, tested.state) and self.place.test in (None, tested.name)

    def units(self, experiment: Experiment) -> tuple[str, ...]:
        """Return the units of its parameters; lengths count in stories if heights are not declared."""
        metric = experiment.frame.story_heights is not None
        return tuple(item.unit if metric else item.unit_in_stories or item.unit for item in self.effect.parameters)


def without_sign(value: float, std: float, unit: str = "") -> str:
    """Return the size of a number and its standard deviation, such as "15.1 ± 0.4 %"; a ratio is in percent."""
    factor = 1 if unit else 100
    return quantities.with_std(factor * abs(float(value)), factor * float(std), unit or "%")
