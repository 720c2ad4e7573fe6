"""A static pull or tilt test: known forces on the floors, measured displacements."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cvxshear.measurement.declaration import InTable
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats

DEFAULT_DISPLACEMENT_STD = 0.01
"""Default standard deviation, relative to the largest displacement (see `data.Static.noise`)."""


@dataclass(frozen=True, eq=False)
class StaticTest(InTable):
    """Static forces on the frame and the measured displacements of its floors.

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
        checks.text(self.name, "static test: name")
        state = checks.text(self.state, self._at("state")) if self.state else self.name
        object.__setattr__(self, "state", state)
        checks.put(self, "force", checks.vector, self._at("force"))
        one_each: dict[str, Any] = {"length": len(self.force), "each": ", one a floor"}
        checks.put(self, "displacement", checks.vector, self._at("displacement"), nan=True, **one_each)
        if not np.any(self.force):
            raise InputError(f"{self._at('force')} is zero on every floor; a static test needs one that is not")
        if not np.any(np.abs(self.displacement[self.measured]) > 0):
            raise InputError(f"{self._at('displacement')} holds no displacement; give one floor's at least, in m")
        if np.size(self.added_mass):
            checks.put(self, "added_mass", checks.vector, self._at("added_mass"), least=0.0, **one_each)
        checks.put(self, "displacement_std", checks.number, self._at("displacement_std"), above=0.0)

    def _at(self, key: str) -> str:
        return f'static test "{self.name}": {key}'

    def in_frame(self, stories: int) -> StaticTest:
        """Return the test for a frame of the given number of stories, with the added mass filled in."""
        return self if len(self.added_mass) else dataclasses.replace(self, added_mass=np.zeros(stories))

    @property
    def measured(self) -> Bools:
        """Which displacements were measured, shape (N,)."""
        return np.isfinite(self.displacement)

    @property
    def entry_std(self) -> Floats:
        """Standard deviation of each displacement, declared or default, shape (N,), m."""
        relative = DEFAULT_DISPLACEMENT_STD if self.displacement_std is None else self.displacement_std
        return np.full(len(self.force), relative * float(np.nanmax(np.abs(self.displacement))))
