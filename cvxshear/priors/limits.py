"""Priors that limit floor masses or story stiffnesses: bounds, and how they change with height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.priors.base import Constraints, Prior, check_quantity, listed, put
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Bounds(Prior):
    """lower <= x <= upper, exact.

    Parameters
    ----------
    quantity : str
        "floor_mass", "story_stiffness" or "story_damping".
    lower, upper : float or array_like, shape (N,), optional
        kg or N/m; one number for all, or one a floor or story; at least one of the two.
    """

    kind: ClassVar[str] = "bounds"
    quantity: str
    lower: float | Floats | None = None
    upper: float | Floats | None = None

    def __post_init__(self) -> None:
        check_quantity(self)
        if self.lower is None and self.upper is None:
            raise InputError("the bounds prior needs a key 'lower' or 'upper'")
        put(self, "lower", checks.vector if checks.many(self.lower) else checks.number, least=0.0)
        put(self, "upper", checks.vector if checks.many(self.upper) else checks.number, above=0.0)

    def check(self, stories: int) -> None:
        """Raise `InputError` where it names floors or stories that a frame of so many stories has not."""
        for name in ("lower", "upper"):
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and len(value) != stories:
                raise InputError(
                    f"{name} of the bounds prior has {checks.entries(len(value))}, the frame has {stories} stories; "
                    "give one number for all, or one a story"
                )
        lower, upper = self._limits(stories)
        if np.any(lower > upper):
            place = int(np.argmax(lower > upper))
            raise InputError(
                f"the bounds prior on {self.quantity} {place + 1}: lower {lower[place]:g} is above "
                f"upper {upper[place]:g}; it must not be"
            )

    def _limits(self, stories: int) -> tuple[Floats, Floats]:
        lower = np.broadcast_to(-np.inf if self.lower is None else self.lower, stories)
        upper = np.broadcast_to(np.inf if self.upper is None else self.upper, stories)
        return lower.astype(float), upper.astype(float)

    def constraints(self, stories: int) -> Constraints:
        """Return the bounds, infinite where there is none."""
        lower, upper = self._limits(stories)
        return Constraints(lower=lower, upper=upper)

    def describe(self) -> str:
        """Say the statement in words."""
        limits = [
            f"{word} {listed(value, self.quantity)}"
            for word, value in (("at least", self.lower), ("at most", self.upper))
            if value is not None
        ]
        return f"{self.quantity} {' and '.join(limits)}"


DIRECTIONS = ("decreasing", "increasing")
"""Ways in which a quantity can change with height."""


@dataclass(frozen=True, eq=False)
class Monotone(Prior):
    """x[i+1] <= x[i] ("decreasing") or x[i+1] >= x[i] ("increasing"), exact.

    Parameters
    ----------
    quantity : str
        "floor_mass", "story_stiffness" or "story_damping".
    direction : str
        "decreasing" or "increasing", with height.
    """

    kind: ClassVar[str] = "monotone"
    quantity: str
    direction: str

    def __post_init__(self) -> None:
        check_quantity(self)
        checks.choice(self.direction, DIRECTIONS, "direction of the monotone prior")

    def constraints(self, stories: int) -> Constraints:
        """Return the differences of neighbours, one row a pair."""
        climb = np.eye(stories)[1:] - np.eye(stories)[:-1]
        return Constraints(G=climb if self.direction == "decreasing" else -climb, h=np.zeros(stories - 1))

    def describe(self) -> str:
        """Say the statement in words."""
        return f"{self.quantity} only {self.direction} with height"
