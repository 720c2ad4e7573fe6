"""Value: one floor mass or story stiffness is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear import checks
from cvxshear.priors.base import UNITS, Constraints, Prior, check_quantity, set_field
from cvxshear.typing import Floats


@dataclass(frozen=True, eq=False)
class Value(Prior):
    """x[at] = value, exact, or with a relative standard deviation: r = (x[at] / value - 1) / std.

    Parameters
    ----------
    quantity : str
        "floor_mass" or "story_stiffness".
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
        set_field(self, "value", checks.number(self.value, "value of the value prior", above=0.0))
        if self.std is not None:
            set_field(self, "std", checks.number(self.std, "std of the value prior", above=0.0))

    @property
    def fixes_scale(self) -> bool:
        return True

    def check(self, stories: int) -> None:
        checks.whole(self.at, "at of the value prior", least=1, most=stories)

    def _row(self, stories: int) -> Floats:
        row = np.zeros((1, stories))
        row[0, self.at - 1] = 1.0
        return row

    def constraints(self, stories: int) -> Constraints:
        if self.std is not None:
            return Constraints()
        return Constraints(A=self._row(stories), b=np.array([self.value]))

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        if self.std is None:
            return super().residual(x)
        row = self._row(len(x)) / (self.value * self.std)
        return row @ x - 1.0 / self.std, row

    def describe(self) -> str:
        sure = "" if self.std is None else f" within {100 * self.std:g} %"
        return f"{self.quantity} {self.at} is {self.value:g} {UNITS[self.quantity]}{sure}"
