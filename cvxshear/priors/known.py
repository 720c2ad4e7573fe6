"""Priors that say what floor masses or story stiffnesses are: one, all of them, or the ratio of two."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import helmert

from cvxshear.priors.base import Constraints, Prior, certainty, check_place, check_quantity, listed, put
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


class _Equations(Prior):
    """Statements x = ... that are exact, or soft where they have a standard deviation."""

    std: float | None

    @abstractmethod
    def _exact(self, stories: int) -> tuple[Floats, Floats]:
        """Return A and b of A x = b."""

    @abstractmethod
    def _soft(self, x: Floats, std: float) -> tuple[Floats, Floats]:
        """Return the errors in standard deviations and their derivative."""

    def constraints(self, stories: int) -> Constraints:
        """Return the exact statement; none where it is soft."""
        return Constraints() if self.std is not None else Constraints(None, None, None, None, *self._exact(stories))

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the soft statement and its derivative; none where it is exact."""
        return super().residual(x) if self.std is None else self._soft(x, self.std)


@dataclass(frozen=True, eq=False)
class Value(_Equations):
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

    def _exact(self, stories: int) -> tuple[Floats, Floats]:
        return np.eye(stories)[[self.at - 1]], np.array([self.value])

    def _soft(self, x: Floats, std: float) -> tuple[Floats, Floats]:
        row = self._exact(len(x))[0] / (self.value * std)
        return row @ x - 1.0 / std, row

    def describe(self) -> str:
        """Say the statement in words."""
        return f"{self.quantity} {self.at} is {listed(self.value, self.quantity)}{certainty(self.std)}"


@dataclass(frozen=True, eq=False)
class Nominal(_Equations):
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

    def _exact(self, stories: int) -> tuple[Floats, Floats]:
        if not self.free_scale:
            return np.eye(stories), self.values
        scaled = np.diag(1.0 / self.values)
        return scaled[1:] - scaled[:-1], np.zeros(stories - 1)

    def _soft(self, x: Floats, std: float) -> tuple[Floats, Floats]:
        if not self.free_scale:
            return (x / self.values - 1.0) / std, np.diag(1.0 / (self.values * std))
        basis = helmert(len(x)) / std
        return basis @ np.log(x / self.values), basis / x

    def describe(self) -> str:
        """Say the statement in words."""
        scale = " up to a common factor" if self.free_scale else ""
        return f"{self.quantity} is {listed(self.values, self.quantity)}{scale}{certainty(self.std)}"


@dataclass(frozen=True, eq=False)
class Ratio(_Equations):
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
        put(self, "value", checks.number, above=0.0)
        put(self, "std", checks.number, above=0.0)
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

    def _exact(self, stories: int) -> tuple[Floats, Floats]:
        unit = np.eye(stories)
        return unit[[self.of - 1]] - self.value * unit[[self.to - 1]], np.zeros(1)

    def _soft(self, x: Floats, std: float) -> tuple[Floats, Floats]:
        above, below = x[self.of - 1], x[self.to - 1]
        unit = np.eye(len(x)) / std
        J = unit[[self.of - 1]] / above - unit[[self.to - 1]] / below
        return np.array([np.log(above / (self.value * below)) / std]), J

    def describe(self) -> str:
        """Say the statement in words."""
        share = "equal to" if self.value == 1 else f"{self.value:g} times"
        return f"{self.quantity} {self.of} is {share} {self.quantity} {self.to}{certainty(self.std)}"
