"""What is known beforehand of an effect that the shear model lacks: a table `[[effect]]` of a measurement file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import fields_as_table
from cvxshear.util.typing import Json


@dataclass(frozen=True)
class ExpectedEffect:
    """What is known of an effect, everywhere or at a place, in place of what the catalogue expects.

    Parameters
    ----------
    name : str
        Of the catalogue.
    floor, story : int, optional
        Counted from 1 (floor 0: the base); every one where not given.
    state : str, optional
        Every one where not given.
    size : float, optional
        Standard deviation of its parameter, in its unit.
    probability : float, optional
        That it is there, at one of these places.
    exclude : bool, optional
        It is not looked for.
    to : int, optional
        The higher of the two floors that it joins, `floor` the lower; every one where not given.

    Raises
    ------
    InputError
        Naming the key, the value found and what would be right.
    """

    name: str
    floor: int | None = None
    story: int | None = None
    state: str | None = None
    size: float | None = None
    probability: float | None = None
    exclude: bool = False
    to: int | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.text(self.name, "effect: name")
        if self.size is not None:
            put(self, "size", checks.number(self.size, self._at("size"), above=0.0))
        if self.probability is not None:
            put(self, "probability", checks.number(self.probability, self._at("probability"), above=0.0))
            if self.probability >= 1.0:
                raise InputError(f"{self._at('probability')} = {self.probability:g} must be below 1; assume the effect")
        checks.flag(self.exclude, self._at("exclude"))
        if self.exclude and (self.size is not None or self.probability is not None):
            raise InputError(f"{self._at('exclude')} leaves no room for size or probability; give one or the other")

    def _at(self, key: str) -> str:
        return f"effect {self.name}: {key}"

    @staticmethod
    def from_dict(declared: object, where: str) -> ExpectedEffect:
        """Read what a table `[[effect]]` declares."""
        fields = [item.name for item in dataclasses.fields(ExpectedEffect)]
        table = checks.keys(declared, fields, ["name"], where)
        return ExpectedEffect(**{key: value for key, value in table.items() if value is not None})

    def to_dict(self) -> Json:
        """Return the table that declares it."""
        return fields_as_table(self, exclude=False)

    def check(self, stories: int, states: Sequence[str]) -> None:
        """Raise `InputError` where it names a floor, story or state that an experiment has not."""
        for key, least in (("floor", 0), ("to", 1), ("story", 1)):
            if getattr(self, key) is not None:
                checks.whole(getattr(self, key), self._at(key), least=least, most=stories)
        if self.to is not None and self.floor is not None and self.to <= self.floor:
            raise InputError(f"{self._at('to')} = {self.to} must be above floor = {self.floor}: the lower floor first")
        if self.state is not None:
            checks.choice(self.state, list(states), self._at("state"))

    def concerns(self, name: str, place: Mapping[str, int | str | None]) -> bool:
        """Whether it speaks of the effect of this name at this place (its floor, to, story and state)."""
        return name == self.name and all(getattr(self, part, None) in (None, its) for part, its in place.items())
