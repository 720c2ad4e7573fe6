"""Nominal: the design values of all floor masses or all story stiffnesses, perhaps up to a common factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import helmert

from cvxshear.priors.base import Constraints, Prior, certainty, check_quantity, listed, put
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Nominal(Prior):
    """x = values, or x = c values with any c > 0; exact or soft.

    Soft, r_i = (x_i / v_i - 1) / std. With a free scale r is log(x_i / v_i) / std less its mean over the
    floors, expressed in an orthonormal basis of the N - 1 directions that change the distribution (the
    Helmert contrasts), so that it counts as N - 1 statements.

    Parameters
    ----------
    quantity : str
        "floor_mass", "story_stiffness" or "story_damping".
    values : array_like, shape (N,)
        kg or N/m.
    std : float, optional
        Relative standard deviation; exact without it.
    free_scale : bool, optional
        Whether the values are known only up to a common factor.
    """

    kind: ClassVar[str] = "nominal"
    quantity: str
    values: Floats
    std: float | None = None
    free_scale: bool = False

    def __post_init__(self) -> None:
        check_quantity(self)
        put(self, "values", checks.vector, above=0.0)
        put(self, "free_scale", checks.flag)
        put(self, "std", checks.number, above=0.0)

    @property
    def fixes_scale(self) -> bool:
        """Whether the values are meant as they stand, and not up to a factor."""
        return not self.free_scale

    def suggested(self, stories: int) -> Floats:
        """Return the values."""
        return self.values

    def check(self, stories: int) -> None:
        """Raise `InputError` where it names floors or stories that a frame of so many stories has not."""
        if len(self.values) != stories:
            raise InputError(
                f"values of the nominal prior has {checks.entries(len(self.values))}, the frame has {stories} stories; "
                "give one a story"
            )

    def constraints(self, stories: int) -> Constraints:
        """Return the exact statement; none where it is soft."""
        if self.std is not None:
            return Constraints()
        if not self.free_scale:
            return Constraints(A=np.eye(stories), b=self.values)
        scaled = np.diag(1.0 / self.values)
        return Constraints(A=scaled[1:] - scaled[:-1], b=np.zeros(stories - 1))

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the soft statement and its derivative; none where it is exact."""
        if self.std is None:
            return super().residual(x)
        if not self.free_scale:
            return (x / self.values - 1.0) / self.std, np.diag(1.0 / (self.values * self.std))
        basis = helmert(len(x)) / self.std
        return basis @ np.log(x / self.values), basis / x

    def describe(self) -> str:
        """Say the statement in words."""
        scale = " up to a common factor" if self.free_scale else ""
        return f"{self.quantity} is {listed(self.values, self.quantity)}{scale}{certainty(self.std)}"
