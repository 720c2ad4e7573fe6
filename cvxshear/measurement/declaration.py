"""Declarations about the frame, its damping and its effects, static tests, and the texts of a report."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import fields_as_table
from cvxshear.util.typing import Bools, Floats, Json

#: Findings of `check` that refuse a file unless they are accepted; docs/howto/check-a-file.md says what each means.
MISTAKES = (
    "sensor_sign", "swapped_sensors", "floors_from_top", "transposed", "mode_order", "missing_mode", "mode_number",
    "entry_sign", "sensor_floors", "sensor_unit", "sensor_direction", "sensor_position", "drifts", "periods",
    "frequency_unit", "signs",
)  # fmt: skip

#: Mistakes in which modes of the frame the measured ones are.
NUMBERS = ("missing_mode", "mode_number")

#: Findings of `check` that are warnings.
DOUBTS = (
    "angular_frequency", "heights", "masses", "deviations", "look_alike", "repeated", "gravity",
    "total_mass", "added_mass", "outside_plan",
)  # fmt: skip

#: Findings that `[frame] accept` can name.
NAMES = (*MISTAKES, *DOUBTS)

#: Kinds of damping, see `Damping`.
DAMPING_KINDS = ("modal", "story", "rayleigh")


#: Motions of a floor that turns: two displacements of the reference point, and the angle about the vertical axis.
MOTIONS = ("x", "y", "rotation")


class InTable(checks.ReadOnlyArrays):
    """A dataclass that a table of a measurement file declares.

    Attributes
    ----------
    unsaid : mapping of str to object
        Values of single fields that mean "not given", besides None.
    """

    unsaid: ClassVar[Mapping[str, object]] = {}

    @classmethod
    def of_table(
        cls, declared: object, where: str, *required: str, elsewhere: Mapping[str, str] | None = None, **given: object
    ) -> Self:
        """Take an object, or read a table whose keys are the fields; `given` has values for absent fields."""
        if isinstance(declared, cls):
            return declared
        names = [item.name for item in fields(cls)]  # type: ignore[arg-type]  # every subclass is one
        table = checks.keys(declared, names, required, where, elsewhere=elsewhere)
        return cls(**given | {key: value for key, value in table.items() if value is not None or key in required})

    def to_dict(self) -> Json:
        """Return the table that declares it in a measurement file."""
        return fields_as_table(self, unsaid=self.unsaid)


def named_in(declared: object, kind: str, otherwise: str) -> str:
    """Say which table a message is about: by the name that it gives itself, or `otherwise`."""
    if isinstance(declared, Mapping) and declared.get("name") is not None:
        return f'{kind} "{checks.text(declared["name"], f"{otherwise}: name")}"'
    return otherwise


@dataclass(frozen=True, eq=False)
class Frame(InTable):
    """Declared properties of the frame, the same in every configuration.

    Parameters
    ----------
    stories : int, optional
        Number of stories N; 0 where it follows from the rest.
    story_heights : float or array_like, shape (N,), optional
        m; one number for all.
    total_mass : float, optional
        kg, without added mass.
    floor_masses : array_like, shape (N,), optional
        kg, known, without added mass.
    gravity : float, optional
        m/s2.
    total_mass_std : float, optional
        Relative standard deviation of `total_mass`; exact without it.
    total_mass_placeholder : bool, optional
        Whether the total mass is unknown: masses and stiffnesses are then relative to `total_mass`.
    reference : str, optional
        The state that is the frame itself: no change and no undeclared mass sits in it.
    accept : sequence of str, optional
        Findings of `check` that are known and right, by their names in `cvxshear.measurement.declaration.NAMES`.
    motions : sequence of str, optional
        Motions of each floor: ("x",) or `MOTIONS`.
    plan : array_like, shape (2,) or (N, 2), optional
        Sizes of the floors in x and y, m, about the reference point, where the floors turn. A floor's mass center lies
        within its plan, and its polar inertia is that of a uniform rectangle, m (a^2 + b^2) / 12, within `plan_std`.
    plan_std : float, optional
        Relative standard deviation of that inertia. Default: a facade of a fifth of a square floor's mass, which has
        twice the inertia of a uniform floor, adds a fifth.

    Raises
    ------
    InputError
        Naming the key, the value found and what would be right.
    """

    unsaid = {  # noqa: RUF012 - read only
        "stories": 0, "total_mass_placeholder": False, "motions": ("x",), "plan_std": 0.2,
    }  # fmt: skip

    stories: int = 0
    story_heights: Floats | None = None
    total_mass: float | None = None
    floor_masses: Floats | None = None
    gravity: float = 9.81
    total_mass_std: float | None = None
    total_mass_placeholder: bool = False
    reference: str | None = None
    accept: tuple[str, ...] = ()
    motions: tuple[str, ...] = ("x",)
    plan: Floats | None = None
    plan_std: float = 0.2

    def __post_init__(self) -> None:
        # The default 0 means "not given"; False or an empty array, which equal 0, are values.
        if type(self.stories) is not int or self.stories != 0:
            checks.put(self, "stories", checks.whole, "frame: stories", least=1, most=checks.MOST_STORIES)
        checks.put(self, "story_heights", self._checked_heights, "frame: story_heights")
        checks.put(self, "total_mass", checks.number, "frame: total_mass", above=0.0)
        if self.floor_masses is not None:
            checks.put(self, "floor_masses", checks.vector, "frame: floor_masses", above=0.0)
            if self.total_mass is not None and not np.isclose(self.floor_masses.sum(), self.total_mass, rtol=1e-6):
                raise InputError(
                    f"frame: floor_masses add up to {self.floor_masses.sum():g} kg, total_mass says "
                    f"{self.total_mass:g} kg; give one of the two, or values that agree"
                )
        checks.put(self, "gravity", checks.number, "frame: gravity", above=0.0)
        if self.total_mass_std is not None:
            checks.put(self, "total_mass_std", checks.number, "frame: total_mass_std", above=0.0)
            if self.total_mass is None or self.floor_masses is not None:
                raise InputError("frame: total_mass_std belongs to total_mass; give that, and no floor_masses")
        checks.put(self, "total_mass_placeholder", checks.flag, "frame: total_mass_placeholder")
        if self.total_mass_placeholder and (self.total_mass is None or self.floor_masses is not None):
            raise InputError("frame: total_mass_placeholder belongs to total_mass; leave it out where that is known")
        checks.put(self, "reference", checks.text, "frame: reference")
        names = checks.items(self.accept, "frame: accept", "names")
        accepted = tuple(checks.choice(name, NAMES, "frame: accept") for name in names)
        object.__setattr__(self, "accept", accepted)
        self._check_motions()

    def _check_motions(self) -> None:
        named = tuple(self.motions) if isinstance(self.motions, list | tuple) else self.motions
        if named not in (("x",), MOTIONS):
            raise InputError(
                f'frame: motions must be ["x"] or {list(MOTIONS)}, in this order, not {checks.shown(self.motions)}'
            )
        object.__setattr__(self, "motions", named)
        checks.put(self, "plan_std", checks.number, "frame: plan_std", above=0.0)
        if self.plan is not None:
            if not self.turns:
                raise InputError(f"frame: plan belongs to floors that turn; declare motions = {list(MOTIONS)}")
            if checks.many(self.plan) and not any(checks.many(each) for each in self.plan):
                checks.put(self, "plan", checks.vector, "frame: plan", length=2, each=", a and b in m", above=0.0)
            else:
                checks.put(self, "plan", checks.pairs, "frame: plan", above=0.0)
        elif self.plan_std != Frame.plan_std:
            raise InputError("frame: plan_std belongs to plan; give that, too")

    def _checked_heights(self, heights: object, where: str) -> Floats:
        """Check one height a story; a single number, for all stories, stays one until their number is known."""
        if checks.many(heights):
            return checks.vector(heights, where, above=0.0)
        height = checks.number(heights, where, above=0.0)
        return checks.frozen(np.full(self.stories if self.stories else (), height))

    @staticmethod
    def from_dict(declared: object, *, elsewhere: Mapping[str, str] | None = None) -> Frame:
        """Read the frame that the table `[frame]` of a measurement file declares.

        Parameters
        ----------
        declared : dict
        elsewhere : dict, optional
            Keys of other tables of the file, each with that table's header, for a message that says where they belong.
        """
        if isinstance(declared, list):
            raise InputError(f"[frame] must be one table, in single brackets, not a list: {checks.shown(declared)}")
        if isinstance(declared, Mapping) and declared.get("stories") is not None:
            checks.whole(declared["stories"], "frame: stories", least=1, most=checks.MOST_STORIES)
        return Frame.of_table(declared, "frame", elsewhere=elsewhere)

    @property
    def turns(self) -> bool:
        """Whether the floors move in two directions and turn."""
        return self.motions == MOTIONS

    @property
    def elevations(self) -> Floats | None:
        """Heights of the floors above ground, shape (N,), m; None where story heights or stories are not declared."""
        return None if self.story_heights is None or not self.story_heights.ndim else np.cumsum(self.story_heights)

    @property
    def known_total(self) -> float | None:
        """The total mass without added mass, kg, where it is declared in either way."""
        return float(self.floor_masses.sum()) if self.floor_masses is not None else self.total_mass


@dataclass(frozen=True, eq=False)
class Damping(checks.ReadOnlyArrays):
    """How the damping of the frame is modelled.

    Parameters
    ----------
    kind : str, optional
        "modal": a damping ratio a mode; "story": dashpots between the floors; "rayleigh": a combination of mass and
        stiffness.
    """

    kind: str = "modal"

    def __post_init__(self) -> None:
        checks.choice(self.kind, DAMPING_KINDS, "damping: kind")


@dataclass(frozen=True)
class Heading(InTable):
    """Texts of a report about the test; None for a text that was not given.

    Parameters
    ----------
    title, client, author, test : str, optional
    date : str, optional
    """

    title: str | None = None
    client: str | None = None
    author: str | None = None
    date: str | None = None
    test: str | None = None

    @staticmethod
    def from_dict(declared: object) -> Heading:
        """Read the heading that the table `[report]` of a measurement file declares.

        Raises
        ------
        InputError
            Where a key is unknown or its value no text.
        """
        table = dict(checks.keys(declared, [item.name for item in fields(Heading)], [], "report"))
        # TOML has dates of its own.
        if isinstance(table.get("date"), datetime.date):
            table["date"] = table["date"].isoformat()
        return Heading(**{key: checks.text(value, f"report: {key}") for key, value in table.items()})

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Names and texts that stand below the title."""
        return [(key, value) for key, value in self.to_dict().items() if key != "title"]


@dataclass(frozen=True, eq=False)
class Limits(InTable):
    """Drift ratios that the user wants to know passed or not.

    Parameters
    ----------
    story_drift : array_like, shape (L,)
        Drift over story height; ascending.
    names : sequence of str, optional
        What passing each means; the ratio in percent where not given.

    Raises
    ------
    InputError
        Naming the key, the value found and what would be right.
    """

    story_drift: Floats
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        drift = checks.vector(self.story_drift, "limits: story_drift", above=0.0)
        if np.any(np.diff(drift) <= 0):
            raise InputError(f"limits: story_drift must be ascending, not {checks.shown(drift.tolist())}")
        if drift[-1] >= 1.0:
            raise InputError(
                f"limits: story_drift is drift over story height, so 2 % is 0.02; {drift[-1]:g} is more than the height"
            )
        object.__setattr__(self, "story_drift", drift)
        given = self.names or tuple(f"{100 * each:g} %" for each in drift)
        if not isinstance(given, list | tuple) or len(given) != len(drift):
            raise InputError(f"limits: names must have {checks.entries(len(drift))}, one a value of story_drift")
        object.__setattr__(self, "names", tuple(checks.text(each, "limits: names") for each in given))


@dataclass(frozen=True)
class ExpectedEffect(InTable):
    """Declared prior of an effect, everywhere or at a place; it replaces the prior of the catalogue.

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

    unsaid = {"exclude": False}  # noqa: RUF012 - read only

    name: str
    floor: int | None = None
    story: int | None = None
    state: str | None = None
    size: float | None = None
    probability: float | None = None
    exclude: bool = False
    to: int | None = None

    def __post_init__(self) -> None:
        checks.text(self.name, "effect: name")
        checks.put(self, "size", checks.number, self._at("size"), above=0.0)
        checks.put(self, "probability", checks.number, self._at("probability"), above=0.0)
        if self.probability is not None and self.probability >= 1.0:
            raise InputError(f"{self._at('probability')} = {self.probability:g} must be below 1; assume the effect")
        checks.flag(self.exclude, self._at("exclude"))
        if self.exclude and (self.size is not None or self.probability is not None):
            raise InputError(f"{self._at('exclude')} leaves no room for size or probability; give one or the other")

    def _at(self, key: str) -> str:
        return f"effect {self.name}: {key}"

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


#: Default standard deviation, relative to the largest displacement (see `data.Static.noise`).
DEFAULT_DISPLACEMENT_STD = 0.01


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
        return self if len(self.added_mass) else replace(self, added_mass=np.zeros(stories))

    @property
    def measured(self) -> Bools:
        """Which displacements were measured, shape (N,)."""
        return np.isfinite(self.displacement)

    @property
    def entry_std(self) -> Floats:
        """Standard deviation of each displacement, declared or default, shape (N,), m."""
        relative = DEFAULT_DISPLACEMENT_STD if self.displacement_std is None else self.displacement_std
        return np.full(len(self.force), relative * float(np.nanmax(np.abs(self.displacement))))
