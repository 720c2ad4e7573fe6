"""One thing that looks wrong in a measurement file, and its place in the JSON of a result."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from cvxshear.util.results import InJson
from cvxshear.util.typing import Json


@dataclass(frozen=True)
class Finding(InJson):
    """One thing that looks wrong, and what to change.

    Parameters
    ----------
    name : str
        The word that `[frame] accept = [...]` takes.
    configuration : str or None
        Where it was found; None where it concerns the whole file.
    found : str
        What is there, a sentence.
    change : str
        What to change, a sentence.
    refuses : bool
        Whether nothing is to be fitted before it is changed or accepted; else it is a warning.
    rivals : tuple of str, optional
        Names of other mistakes that `change` proposes as well; to accept one of them is to accept the finding.
    """

    name: str
    configuration: str | None
    found: str
    change: str
    refuses: bool
    rivals: tuple[str, ...] = ()

    def accepted(self, names: Collection[str]) -> bool:
        """Whether it is among these names."""
        return any(name in names for name in (self.name, *self.rivals))

    @property
    def how_to_accept(self) -> str:
        """The line of the measurement file that lets it pass."""
        return f'[frame] accept = ["{self.name}"]'


def in_json(found: Iterable[Finding] | None) -> Json:
    """List what the findings add to a result's JSON; nothing where nobody looked for any."""
    return {} if found is None else {"warnings": [item.to_dict() for item in found]}
