"""Bounds: every floor mass or story stiffness lies between two values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.priors.base import Constraints, Prior, check_quantity, listed, set_field
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
        self._check_limit("lower", least=0.0)
        self._check_limit("upper", above=0.0)

    def _check_limit(self, name: str, *, above: float = -np.inf, least: float = -np.inf) -> None:
        value, where = getattr(self, name), f"{name} of the bounds prior"
        if value is not None:
            check = checks.vector if checks.many(value) else checks.number
            set_field(self, name, check(value, where, above=above, least=least))

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
