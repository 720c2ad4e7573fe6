"""Monotone: floor masses or story stiffnesses only decrease, or only increase, with height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.priors.base import Constraints, Prior, check_quantity
from cvxshear.util import checks

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
