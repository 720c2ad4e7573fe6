"""What every prior is: a statement about the floor masses or the story stiffnesses, exact or soft.

A prior of one's own is a subclass of `Prior` that overrides `constraints` (an exact statement) or
`residual` (a soft one). A subclass that sets `kind` and is a dataclass can be named in a measurement file.
"""

from __future__ import annotations

import dataclasses
from abc import ABC
from typing import Any, ClassVar

import numpy as np

from cvxshear import checks
from cvxshear.errors import InputError
from cvxshear.typing import Floats, Json

QUANTITIES = ("floor_mass", "story_stiffness")
UNITS = {"floor_mass": "kg", "story_stiffness": "N/m"}


@dataclasses.dataclass(frozen=True, eq=False)
class Constraints:
    """Exact linear statements about one vector x of length N.

    Parameters
    ----------
    lower, upper : ndarray, shape (N,), optional
        lower <= x <= upper; infinite where there is no bound.
    G, h : ndarray, shapes (g, N) and (g,), optional
        G x <= h.
    A, b : ndarray, shapes (a, N) and (a,), optional
        A x = b.
    """

    lower: Floats | None = None
    upper: Floats | None = None
    G: Floats | None = None
    h: Floats | None = None
    A: Floats | None = None
    b: Floats | None = None


class Prior(ABC):
    """A statement about the floor masses (without added mass) or the story stiffnesses.

    Attributes
    ----------
    kind : str
        The word for it in a measurement file; empty where it has none.
    quantity : str
        "floor_mass" (kg) or "story_stiffness" (N/m).
    """

    kind: ClassVar[str] = ""
    kinds: ClassVar[dict[str, type[Prior]]] = {}
    quantity: str

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if cls.kind:
            Prior.kinds[cls.kind] = cls

    @staticmethod
    def from_dict(declared: object) -> Prior:
        """The prior that a table of a measurement file declares.

        Parameters
        ----------
        declared : dict
            The key `kind`, and the keys of that kind.

        Raises
        ------
        InputError
            Where a key is unknown or missing, or a value is wrong.
        """
        if not isinstance(declared, dict) or "kind" not in declared:
            raise InputError(f"the prior needs a key 'kind', one of {', '.join(Prior.kinds)}")
        named = declared
        cls = Prior.kinds[checks.choice(named["kind"], list(Prior.kinds), "kind")]
        fields = [field for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
        required = [field.name for field in fields if field.default is dataclasses.MISSING]
        checks.keys(named, ["kind", *(field.name for field in fields)], required, f"the {cls.kind} prior")
        return cls(**{key: value for key, value in named.items() if key != "kind"})

    def to_dict(self) -> Json:
        """The table that declares this prior in a measurement file."""
        if not dataclasses.is_dataclass(self):
            return {"kind": self.kind or type(self).__name__, "quantity": self.quantity}
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items() if v is not None}
        return {"kind": self.kind, **plain}

    @property
    def fixes_scale(self) -> bool:
        """Whether it alone tells how heavy or how stiff the frame is, and not only how it is distributed."""
        return False

    def check(self, stories: int) -> None:
        """Raise `InputError` where the prior does not fit a frame of so many stories."""

    def constraints(self, stories: int) -> Constraints:
        """The exact statements, for a frame of so many stories; none by default."""
        return Constraints()

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """The soft statements at `x`: their errors in standard deviations, and the derivative.

        Parameters
        ----------
        x : ndarray, shape (N,)
            The quantity, kg or N/m.

        Returns
        -------
        r : ndarray, shape (p,)
            Errors divided by their standard deviations; none by default.
        J : ndarray, shape (p, N)
            dr/dx.
        """
        return np.zeros(0), np.zeros((0, len(x)))

    def describe(self) -> str:
        """The statement in words, for messages and reports."""
        return f"{self.kind or type(self).__name__} on {self.quantity}"


def check_quantity(prior: Prior) -> None:
    """Raise `InputError` unless the prior's quantity is one that a frame has."""
    checks.choice(prior.quantity, QUANTITIES, f"quantity of the {prior.kind} prior")


def set_field(prior: Prior, name: str, value: object) -> None:
    """Put the checked value in place of the one handed in; the dataclasses are frozen to everyone else."""
    object.__setattr__(prior, name, value)
