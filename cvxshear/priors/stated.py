"""Priors of floor masses and story stiffnesses: values, ratios, bounds, and change with height."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import helmert

from cvxshear.priors.base import Constraints, Prior, certainty, check_length, check_place, check_quantity, listed, put
from cvxshear.util import checks, errors
from cvxshear.util.typing import Floats


class _Equations(Prior):
    """Statements x = ... that are exact, or soft where they have a standard deviation."""

    std: float | None
    places: ClassVar[tuple[str, ...]] = ()
    """Fields that hold a floor or a story."""

    def __post_init__(self) -> None:
        check_quantity(self)
        put(self, "std", checks.number, above=0.0)
        for name in self.places:
            check_place(self, name)

    def check(self, stories: int) -> None:
        """Raise `InputError` if it names a floor or story that the frame does not have."""
        for name in self.places:
            check_place(self, name, stories)

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
    places = ("at",)

    def __post_init__(self) -> None:
        super().__post_init__()
        put(self, "value", checks.number, above=0.0)

    @property
    def fixes_scale(self) -> bool:
        """Always true: one mass or stiffness in absolute terms fixes the rest."""
        return True

    def suggested(self, stories: int) -> Floats:
        """Return the value at its floor or story, nan elsewhere."""
        return np.where(np.arange(1, stories + 1) == self.at, self.value, np.nan)

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

    Soft, r_i = (x_i / v_i - 1) / std. With a free scale, r is log(x_i / v_i) / std minus its mean over the floors,
    expressed in an orthonormal basis of the N - 1 directions that change the distribution (the Helmert contrasts), so
    that it counts as N - 1 statements.

    Parameters
    ----------
    quantity : str
        "floor_mass" or "story_stiffness".
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
        super().__post_init__()
        put(self, "values", checks.vector, above=0.0)
        put(self, "free_scale", checks.flag)

    @property
    def fixes_scale(self) -> bool:
        """Whether the values are meant as they stand, and not up to a factor."""
        return not self.free_scale

    def suggested(self, stories: int) -> Floats:
        """Return the values."""
        return self.values

    def check(self, stories: int) -> None:
        """Raise `InputError` if it names floors or stories that the frame does not have."""
        check_length(self, "values", stories, "give one a story")

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
        "floor_mass" or "story_stiffness".
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
    places = ("of", "to")

    def __post_init__(self) -> None:
        super().__post_init__()
        put(self, "value", checks.number, above=0.0)
        if self.of == self.to:
            raise errors.InputError(
                f"the ratio prior compares {self.quantity} {self.of} with itself; 'of' and 'to' must differ"
            )

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


@dataclass(frozen=True, eq=False)
class Bounds(Prior):
    """lower <= x <= upper, exact.

    Parameters
    ----------
    quantity : str
        "floor_mass" or "story_stiffness".
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
            raise errors.InputError("the bounds prior needs a key 'lower' or 'upper'")
        put(self, "lower", checks.vector if checks.many(self.lower) else checks.number, least=0.0)
        put(self, "upper", checks.vector if checks.many(self.upper) else checks.number, above=0.0)

    def check(self, stories: int) -> None:
        """Raise `InputError` if it names floors or stories that the frame does not have."""
        for name in ("lower", "upper"):
            check_length(self, name, stories, "give one number for all, or one a story")
        lower, upper = self._limits(stories)
        if np.any(lower > upper):
            place = int(np.argmax(lower > upper))
            raise errors.InputError(
                f"the bounds prior on {self.quantity} {place + 1}: lower {lower[place]:g} is above "
                f"upper {upper[place]:g}; it must not be"
            )

    def _limits(self, stories: int) -> tuple[Floats, Floats]:
        lower = np.broadcast_to(-np.inf if self.lower is None else self.lower, stories)
        upper = np.broadcast_to(np.inf if self.upper is None else self.upper, stories)
        return lower.astype(float), upper.astype(float)

    def constraints(self, stories: int) -> Constraints:
        """Return the bounds, infinite by default."""
        return Constraints(*self._limits(stories))

    def describe(self) -> str:
        """Say the statement in words."""
        limits = [
            f"{word} {listed(value, self.quantity)}"
            for word, value in (("at least", self.lower), ("at most", self.upper))
            if value is not None
        ]
        return f"{self.quantity} {' and '.join(limits)}"


#: Ways in which a quantity can change with height.
DIRECTIONS = ("decreasing", "increasing")


@dataclass(frozen=True, eq=False)
class Monotone(Prior):
    """x[i+1] <= x[i] ("decreasing") or x[i+1] >= x[i] ("increasing"), exact.

    Parameters
    ----------
    quantity : str
        "floor_mass" or "story_stiffness".
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
