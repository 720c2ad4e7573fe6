"""What the open classes have in common: many parameters of one common, unknown size."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats

MOST_OPEN_STORIES = 40
"""Stories up to which a class of springs or masses between all floors is looked for: its N(N-1)/2 parameters make every
fit of a taller frame take minutes."""

STANDS_OUT = 3.0
"""Deviations from zero, in standard deviations, from which on an entry is named as a place where the model fails."""

MOST_NAMED = 3
"""Entries that a sentence names, the most significant first."""


class OpenClass(Effect):
    """A statement of the shear model that does not hold, in no way that the catalogue has.

    Its parameters are normal about zero with one common size. That size is unknown itself: its logarithm is normal
    about that of `usual_size`, with a standard deviation of 1.5, so that two thirds of all cases lie within a factor of
    4.5. The evidence pays for the freedom: a cause of the catalogue that is right explains the same data with one
    parameter.

    Each statement fails so in two of a hundred tested frames: the catalogue holds what practice meets, and a class
    stands for what it lacks. Where a statement has two classes, each has one in a hundred.
    """

    kind = "open"
    common_size = True
    size_width = 1.5
    probability = 0.02
    parameters: tuple[Parameter, ...] = ()
    holds_in_words: ClassVar[str]
    """The statement of the shear model that does not hold, as a clause."""

    def bound(self, experiment: Experiment) -> Self:
        """Make a copy with one parameter an entry."""
        own = copy.copy(self)
        own.parameters = tuple(self.entries(experiment))
        return own

    @abstractmethod
    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        """List the parameters that it has in an experiment, each named by its place: "floors 2 and 6", "story 3"."""

    @abstractmethod
    def usual_size(self, scale: Scale) -> float:
        """Return the size that its parameters have in the middle of what is expected."""

    def sizes(self, scale: Scale) -> Floats:
        return np.full(len(self.parameters), self.usual_size(scale))

    def lacks(self, experiment: Experiment) -> str:
        return super().lacks(experiment) or ("" if self.entries(experiment) else "more floors")

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        where = f' in "{place.state}"' if place.state is not None else ""
        named = self.conspicuous(values, std)
        if not named:
            return f"{self.holds_in_words}{where} does not hold; no single place stands out"
        entries = "; ".join(
            f"{self.parameters[i].name}: {with_std(float(values[i]), float(std[i]), units[i])}" for i in named
        )
        return f"{self.holds_in_words}{where} does not hold: {self.place_in_words} {entries}"

    place_in_words: ClassVar[str] = "what stands out is"

    def cause_at(self, entry: int, place: Place, experiment: Experiment) -> tuple[str, Place] | None:
        """Name the effect of the catalogue, and its place, that one entry alone would be; None where there is none."""
        return None

    def conspicuous(self, values: Floats, std: Floats) -> list[int]:
        """List the entries that stand out of their deviations, the most significant first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.nan_to_num(np.abs(values) / std)
        order = [int(i) for i in np.argsort(-z, kind="stable") if z[i] >= STANDS_OUT]
        return order[:MOST_NAMED]


def pairs(stories: int, *, ground: bool) -> list[tuple[int, int]]:
    """Pairs of floors, the lower first, 0 the ground; with the ground those at least two levels apart."""
    if ground:
        return [(i, j) for i in range(stories + 1) for j in range(i + 2, stories + 1)]
    return [(i, j) for i in range(1, stories + 1) for j in range(i + 1, stories + 1)]


def named_pair(i: int, j: int) -> str:
    """Such as "floors 2 and 6", or "the ground and floor 3"."""
    return f"floors {i} and {j}" if i else f"the ground and floor {j}"
