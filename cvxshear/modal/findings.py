"""What a record itself gets wrong, as statements with numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

from cvxshear.util.typing import Json


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a record, or that it cannot tell.

    Parameters
    ----------
    kind : str
        "clock offset", "dead channel", "clipped channel", "held samples", "drift", "aliasing", "sign",
        "swapped channels", "resolution", "reciprocity", "amplitude", "split mode", "missing mode",
        "other mode", "overlooked mode", "complex mode", "leakage", "scale", "std".
    message : str
        For people, with the numbers and their units.
    numbers : dict, optional
        The same numbers for programs.
    """

    kind: str
    message: str
    numbers: Json = field(default_factory=dict)

    def to_dict(self) -> Json:
        """The finding as plain values."""
        return {"kind": self.kind, "message": self.message, "numbers": dict(self.numbers)}
