"""A static pull or tilt test: known forces on the floors, measured displacements."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import fields_as_table
from cvxshear.util.typing import Bools, Floats, Json

DEFAULT_DISPLACEMENT_STD = 0.01


@dataclass(frozen=True, eq=False)
class StaticTest:
    """Forces on a frame that stands still, and where they move its floors.

    Parameters
    ----------
    force : array_like, shape (N,)
        N on each floor, at least one not zero.
    displacement : array_like, shape (N,)
        m at each floor, nan where not measured.
    name : str, optional
    state : str, optional
        The state of the frame; the test's name where empty.
    added_mass : array_like, shape (N,), optional
        kg on each floor, known; none where empty. Its weight acts where gravity does.
    displacement_std : float, optional
        Standard deviation, relative to the largest displacement.

    Raises
    ------
    InputError
        Naming the test, the key, the value found and what would be right.
    """

    force: Floats
    displacement: Floats
    name: str = "static test 1"
    state: str = ""
    added_mass: Floats = field(default_factory=lambda: np.zeros(0))
    displacement_std: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.text(self.name, "static test: name")
        put(self, "state", checks.text(self.state, self._at("state")) if self.state else self.name)
        put(self, "force", checks.vector(self.force, self._at("force")))
        count = len(self.force)
        put(
            self,
            "displacement",
            checks.vector(self.displacement, self._at("displacement"), length=count, each=", one a floor", nan=True),
        )
        if not np.any(self.force):
            raise InputError(f"{self._at('force')} is zero on every floor; a static test needs one that is not")
        if not np.any(np.abs(self.displacement[self.measured]) > 0):
            raise InputError(f"{self._at('displacement')} holds no displacement; give one floor's at least, in m")
        if np.size(self.added_mass):
            where = self._at("added_mass")
            added = checks.vector(self.added_mass, where, length=count, each=", one a floor", least=0.0)
            put(self, "added_mass", added)
        if self.displacement_std is not None:
            std = checks.number(self.displacement_std, self._at("displacement_std"), above=0.0)
            put(self, "displacement_std", std)

    def _at(self, key: str) -> str:
        return f'static test "{self.name}": {key}'

    @staticmethod
    def from_dict(declared: object, *, name: str = "static test 1") -> StaticTest:
        """Read the test that a table `[[static]]` of a measurement file declares."""
        where = name
        if isinstance(declared, Mapping) and declared.get("name") is not None:
            where = f'static test "{checks.text(declared["name"], f"{name}: name")}"'
        fields = [item.name for item in dataclasses.fields(StaticTest)]
        table = checks.keys(declared, fields, ["force", "displacement"], where)
        given = {key: value for key, value in table.items() if value is not None}
        return StaticTest(**{"name": name, **given})

    def to_dict(self) -> Json:
        """Return the table that declares this test in a measurement file."""
        return fields_as_table(self)

    def in_frame(self, stories: int) -> StaticTest:
        """Fit the test to a frame of so many stories, added mass filled in."""
        return self if len(self.added_mass) else dataclasses.replace(self, added_mass=np.zeros(stories))

    @property
    def measured(self) -> Bools:
        """Which displacements were measured, shape (N,)."""
        return np.isfinite(self.displacement)

    @property
    def entry_std(self) -> Floats:
        """Standard deviation of each displacement, shape (N,), m; the default where none is declared."""
        relative = DEFAULT_DISPLACEMENT_STD if self.displacement_std is None else self.displacement_std
        return np.full(len(self.force), relative * float(np.nanmax(np.abs(self.displacement))))
