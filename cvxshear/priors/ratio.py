"""Ratio: two floor masses or two story stiffnesses stand in a known ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.priors.base import Constraints, Prior, certainty, check_place, check_quantity, check_std, set_field
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Ratio(Prior):
    """x[of] = value x[to], exact, or soft: r = log(x[of] / (value x[to])) / std.

    The logarithm makes a soft ratio say the same whichever way round it is declared.

    Parameters
    ----------
    quantity : str
        "floor_mass", "story_stiffness" or "story_damping".
    of, to : int
        Floors or stories, 1 the lowest.
    value : float
        x[of] / x[to].
    std : float, optional
        Relative standard deviation of the ratio; exact without it.
    """

    kind: ClassVar[str] = "ratio"
    quantity: str
    of: int
    to: int
    value: float
    std: float | None = None

    def __post_init__(self) -> None:
        check_quantity(self)
        set_field(self, "value", checks.number(self.value, "value of the ratio prior", above=0.0))
        check_std(self, self.std)
        check_place(self, "of")
        check_place(self, "to")
        if self.of == self.to:
            raise InputError(
                f"the ratio prior compares {self.quantity} {self.of} with itself; 'of' and 'to' must differ"
            )

    def check(self, stories: int) -> None:
        """Raise `InputError` where it names a floor or story that a frame of so many stories has not."""
        check_place(self, "of", stories)
        check_place(self, "to", stories)

    def constraints(self, stories: int) -> Constraints:
        """Return the exact statement; none where it is soft."""
        if self.std is not None:
            return Constraints()
        row = np.zeros((1, stories))
        row[0, self.of - 1], row[0, self.to - 1] = 1.0, -self.value
        return Constraints(A=row, b=np.zeros(1))

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the soft statement and its derivative; none where it is exact."""
        if self.std is None:
            return super().residual(x)
        of, to = self.of - 1, self.to - 1
        row = np.zeros((1, len(x)))
        row[0, of], row[0, to] = 1.0 / (x[of] * self.std), -1.0 / (x[to] * self.std)
        return np.array([np.log(x[of] / (self.value * x[to])) / self.std]), row

    def describe(self) -> str:
        """Say the statement in words."""
        share = "equal to" if self.value == 1 else f"{self.value:g} times"
        return f"{self.quantity} {self.of} is {share} {self.quantity} {self.to}{certainty(self.std)}"
