"""Value: one floor mass or story stiffness is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.priors.base import Constraints, Prior, certainty, check_place, check_quantity, listed, put
from cvxshear.util import checks
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Value(Prior):
    """x[at] = value, exact, or with a relative standard deviation: r = (x[at] / value - 1) / std.

    Parameters
    ----------
    quantity : str
        "floor_mass", "story_stiffness" or "story_damping".
    at : int
        Floor or story, 1 the lowest.
    value : float
        kg or N/m.
    std : float, optional
        Relative standard deviation; exact without it.
    """

    kind: ClassVar[str] = "value"
    quantity: str
    at: int
    value: float
    std: float | None = None

    def __post_init__(self) -> None:
        check_quantity(self)
        put(self, "value", checks.number, above=0.0)
        put(self, "std", checks.number, above=0.0)
        check_place(self, "at")

    @property
    def fixes_scale(self) -> bool:
        """Always true: one mass or stiffness in absolute terms fixes the rest."""
        return True

    def suggested(self, stories: int) -> Floats:
        """Return the value at its floor or story, nan elsewhere."""
        return np.where(np.arange(1, stories + 1) == self.at, self.value, np.nan)

    def check(self, stories: int) -> None:
        """Raise `InputError` where it names a floor or story that a frame of so many stories has not."""
        check_place(self, "at", stories)

    def _row(self, stories: int) -> Floats:
        row = np.zeros((1, stories))
        row[0, self.at - 1] = 1.0
        return row

    def constraints(self, stories: int) -> Constraints:
        """Return the exact statement; none where it is soft."""
        if self.std is not None:
            return Constraints()
        return Constraints(A=self._row(stories), b=np.array([self.value]))

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the soft statement and its derivative; none where it is exact."""
        if self.std is None:
            return super().residual(x)
        row = self._row(len(x)) / (self.value * self.std)
        return row @ x - 1.0 / self.std, row

    def describe(self) -> str:
        """Say the statement in words."""
        return f"{self.quantity} {self.at} is {listed(self.value, self.quantity)}{certainty(self.std)}"
