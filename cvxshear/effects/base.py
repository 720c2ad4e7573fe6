"""What every physical effect is, and the state of a configuration that effects act on."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.experiment import Configuration, Experiment
from cvxshear.frame import System
from cvxshear.typing import Floats, Json

STAGES = ("story", "elastic", "flexibility", "spring", "mass", "gravity", "inertia", "shape")
"""The order in which effects act on a configuration, whatever the order they were named in: story stiffnesses,
the elastic frame made of them, what adds flexibility, what adds springs, masses, the weight of those masses, how
masses are coupled, and what the sensors make of the shapes."""


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
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    null: float = 0.0
    start: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where an effect sits; each part is None where it does not apply.

    Parameters
    ----------
    floor, story : int or None
        1 the lowest.
    configuration : str or None
        Its name.
    """

    floor: int | None = None
    story: int | None = None
    configuration: str | None = None

    def to_dict(self) -> Json:
        return dataclasses.asdict(self)

    def describe(self) -> str:
        """In words, such as "floor 3 of test 2"; empty where it sits nowhere in particular."""
        parts = [
            f"{word} {number}" for word, number in (("floor", self.floor), ("story", self.story)) if number is not None
        ]
        if self.configuration is not None:
            parts.append(f'"{self.configuration}"')
        return " of ".join(parts)


@dataclass(frozen=True, eq=False)
class State:
    """One configuration of the frame while effects act on it, with derivatives by all P parameters of the fit.

    The parameters are the N floor masses, the N story stiffnesses, and then the effects' own.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    frame_stiffness : ndarray, shape (N,)
        Story stiffnesses of the frame itself, N/m.
    story_stiffness : ndarray, shape (N,)
        Those of this configuration, N/m.
    d_story_stiffness : ndarray, shape (P, N)
    system : System
        Matrices and their derivatives, those of the effects' own parameters included (P rows).
    gain : ndarray, shape (N,)
        What the measured shape has at each floor in place of 1.
    d_gain : ndarray, shape (P, N)
    """

    experiment: Experiment
    configuration: Configuration
    frame_stiffness: Floats
    story_stiffness: Floats
    d_story_stiffness: Floats
    system: System
    gain: Floats
    d_gain: Floats

    def with_stiffness(self, K: Floats, dK: Floats) -> State:
        """The same state with another stiffness matrix and its derivatives."""
        return dataclasses.replace(self, system=dataclasses.replace(self.system, K=K, dK=dK))

    def with_mass(self, M: Floats, dM: Floats) -> State:
        """The same state with another mass matrix and its derivatives."""
        return dataclasses.replace(self, system=dataclasses.replace(self.system, M=M, dM=dM))

    @property
    def heights(self) -> Floats:
        """Story heights, shape (N,), m; only for effects that need them."""
        heights = self.experiment.frame.story_heights
        assert heights is not None, "an effect that uses heights must list them in its needs"
        return heights

    @property
    def elevations(self) -> Floats:
        """Elevations of the floors, shape (N,), m."""
        return np.cumsum(self.heights)


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
    parameters : tuple of Parameter
    sits_at : tuple of str
        Of "floor", "story", "configuration": what its place names.
    needs : tuple of str
        Of "heights", "several configurations".
    lowest_floor : int
        The lowest floor it can sit at.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    stage: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    sits_at: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    lowest_floor: ClassVar[int] = 1

    @abstractmethod
    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        """The state with this effect in it.

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

    def lacks(self, experiment: Experiment) -> str:
        """What the experiment would have to declare for this effect to be looked for; empty where it has all."""
        if "heights" in self.needs and experiment.frame.story_heights is None:
            return "story_heights"
        if "several configurations" in self.needs and len(experiment.configurations) < 2:
            return "several configurations"
        return ""

    def places(self, experiment: Experiment) -> list[Place]:
        """Everywhere the effect can sit in this experiment."""
        stories = range(1, experiment.stories + 1)
        floors = [floor for floor in stories if floor >= self.lowest_floor] if "floor" in self.sits_at else [None]
        levels = list(stories) if "story" in self.sits_at else [None]
        states = [each.name for each in experiment.configurations] if "configuration" in self.sits_at else [None]
        return [Place(floor, story, state) for floor in floors for story in levels for state in states]


@dataclass(frozen=True)
class Placed:
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

    @property
    def start(self) -> tuple[float, ...]:
        """Where a fit of its parameters starts."""
        return self.fixed or tuple(item.start for item in self.effect.parameters)

    @property
    def label(self) -> str:
        """Such as "ground_spring at floor 4"."""
        where = self.place.describe()
        return f"{self.effect.name} at {where}" if where else self.effect.name

    def to_dict(self) -> Json:
        """Name and place."""
        return {"name": self.effect.name, **self.place.to_dict()}

    def acts_on(self, configuration: Configuration) -> bool:
        """Whether this configuration has the effect in it."""
        return self.place.configuration in (None, configuration.name)
