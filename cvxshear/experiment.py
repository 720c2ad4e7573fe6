"""What was measured and what was declared: the frame, its configurations, the priors; all validation.

Every object is frozen and its arrays are read-only, so a result can refer to the experiment it came from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear import checks
from cvxshear.errors import InputError
from cvxshear.priors import Prior
from cvxshear.typing import Bools, Floats, Ints, Json

MOST_STORIES = 2000
"""More are taken for a mistake in the file: the matrices alone would fill the memory."""

DEFAULT_FREQUENCY_STD = 0.002
DEFAULT_MODE_SHAPE_STD = 0.01
NOISE_KINDS = ("additive", "multiplicative")


def _no_floats() -> Floats:
    return checks.frozen(np.zeros(0))


def _no_ints() -> Ints:
    return checks.frozen(np.zeros(0, dtype=np.int64))



@dataclass(frozen=True, eq=False)
class Frame:
    """What is known of the frame itself, the same in every configuration.

    Parameters
    ----------
    stories : int, optional
        Number of stories N; 0 where it follows from the rest.
    story_heights : float or array_like, shape (N,), optional
        m.
    total_mass : float, optional
        kg, without added mass.
    floor_masses : array_like, shape (N,), optional
        kg, known, without added mass.
    gravity : float, optional
        m/s2.
    """

    stories: int = 0
    story_heights: Floats | None = None
    total_mass: float | None = None
    floor_masses: Floats | None = None
    gravity: float = 9.81

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.stories != 0 or isinstance(self.stories, bool):
            put(self, "stories", checks.whole(self.stories, "frame: stories", least=1, most=MOST_STORIES))
        if self.story_heights is not None:
            heights: object = self.story_heights
            if isinstance(heights, list | tuple | np.ndarray):
                put(self, "story_heights", checks.vector(heights, "frame: story_heights", above=0.0))
            else:
                put(self, "story_heights", checks.one_or_many(heights, "frame: story_heights", 1, above=0.0))
        if self.total_mass is not None:
            put(self, "total_mass", checks.number(self.total_mass, "frame: total_mass", above=0.0))
        if self.floor_masses is not None:
            put(self, "floor_masses", checks.vector(self.floor_masses, "frame: floor_masses", above=0.0))
            if self.total_mass is not None and not np.isclose(self.floor_masses.sum(), self.total_mass, rtol=1e-6):
                raise InputError(
                    f"frame: floor_masses add up to {self.floor_masses.sum():g} kg, total_mass says "
                    f"{self.total_mass:g} kg; give one of the two, or values that agree"
                )
        put(self, "gravity", checks.number(self.gravity, "frame: gravity", above=0.0))

    @staticmethod
    def from_dict(declared: object) -> Frame:
        """The frame that the table `[frame]` of a measurement file declares."""
        names = [item.name for item in dataclasses.fields(Frame)]
        table = checks.keys(declared, names, [], "frame")
        if "stories" in table and table["stories"] == 0:
            raise InputError(f"frame: stories = 0 must lie between 1 and {MOST_STORIES}")
        return Frame(**table)

    @property
    def elevations(self) -> Floats | None:
        """Heights of the floors above ground, shape (N,), m; None where story heights are not declared."""
        return None if self.story_heights is None else np.cumsum(self.story_heights)

    @property
    def known_total(self) -> float | None:
        """The total mass without added mass, kg, where it is declared in either way."""
        return float(self.floor_masses.sum()) if self.floor_masses is not None else self.total_mass

    def _completed(self, stories: int) -> Frame:
        """The same frame with its number of stories, and one height a story."""
        heights = self.story_heights
        if heights is not None and len(heights) == 1:
            heights = np.repeat(heights, stories)
        return dataclasses.replace(self, stories=stories, story_heights=heights)


@dataclass(frozen=True, eq=False)
class Configuration:
    """One tested state of the frame: what was added to it and what was measured on it.

    Parameters
    ----------
    frequencies : array_like, shape (m,)
        Natural frequencies, Hz, ascending.
    mode_shapes : array_like, shape (m, n)
        One row a mode, one entry a measured floor, of any scale and sign; nan where not measured. A row of
        nan alone stands for a mode of which only the frequency is known.
    name : str, optional
    added_mass : array_like, shape (N,), optional
        kg on each floor, known; none where empty.
    measured_floors : array_like of int, shape (n,), optional
        Ascending, 1 the lowest; all floors where empty.
    modes : array_like of int, shape (m,), optional
        Which modes of the model these are; 1, 2, ..., m where empty.
    mass_normalized : bool, optional
        Whether the shapes carry the scale 1/sqrt(kg).
    frequency_std : float or array_like, shape (m,), optional
        Relative standard deviation.
    mode_shape_std : float or array_like, shape (m,) or (m, n), optional
        Standard deviation of the entries, in the sense of `mode_shape_noise`.
    mode_shape_noise : str, optional
        "additive": std times the mode's largest entry; "multiplicative": std times the entry itself.
    damping_ratios : float or array_like, shape (m,), optional
        Fraction of critical; reported, not fitted.

    Attributes
    ----------
    noise_declared : bool
        Whether both standard deviations were given.
    """

    frequencies: Floats
    mode_shapes: Floats
    name: str = "configuration 1"
    added_mass: Floats = field(default_factory=_no_floats)
    measured_floors: Ints = field(default_factory=_no_ints)
    modes: Ints = field(default_factory=_no_ints)
    mass_normalized: bool = False
    frequency_std: Floats | None = None
    mode_shape_std: Floats | None = None
    mode_shape_noise: str = "additive"
    damping_ratios: Floats | None = None

    def __post_init__(self) -> None:
        self._check_modes()
        self._check_shapes()
        self._check_noise()

    def _put(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _at(self, key: str) -> str:
        return f'configuration "{self.name}": {key}'

    def _check_modes(self) -> None:
        checks.text(self.name, "configuration: name")
        frequencies = checks.vector(self.frequencies, self._at("frequencies"), above=0.0)
        self._put("frequencies", frequencies)
        steps = np.flatnonzero(np.diff(frequencies) <= 0)
        if steps.size:
            place = int(steps[0])
            raise InputError(
                f"{self._at('frequencies')} must be ascending, each greater than the one before; entry {place + 2} "
                f"is {frequencies[place + 1]:g} Hz after {frequencies[place]:g} Hz (sort the mode shapes with them)"
            )
        count = len(frequencies)
        if not len(self.modes):
            self._put("modes", checks.frozen(np.arange(1, count + 1)))
        else:
            self._put("modes", checks.ascending_whole(self.modes, self._at("modes"), most=MOST_STORIES))
            if len(self.modes) != count:
                raise InputError(f"{self._at('modes')} must have {count} entries, one a frequency, not {len(self.modes)}")
        if self.damping_ratios is not None:
            ratios = checks.one_or_many(self.damping_ratios, self._at("damping_ratios"), count, least=0.0)
            if np.any(ratios >= 1):
                raise InputError(f"{self._at('damping_ratios')} must be below 1 (a fraction of critical), not {ratios.max():g}")
            self._put("damping_ratios", ratios)

    def _check_shapes(self) -> None:
        shapes = checks.table(self.mode_shapes, self._at("mode_shapes"), rows=len(self.frequencies), nan=True)
        self._put("mode_shapes", shapes)
        self._put("mass_normalized", checks.flag(self.mass_normalized, self._at("mass_normalized")))
        width = shapes.shape[1]
        if len(self.measured_floors):
            self._put("measured_floors", checks.ascending_whole(self.measured_floors, self._at("measured_floors"), most=MOST_STORIES))
            if len(self.measured_floors) != width:
                raise InputError(
                    f"{self._at('measured_floors')} has {len(self.measured_floors)} entries, each row of mode_shapes has "
                    f"{width}: give one entry a measured floor"
                )
        self._refuse_empty_shapes(shapes)
        self._refuse_equal_shapes(shapes)
        if len(self.added_mass):
            self._put("added_mass", checks.vector(self.added_mass, self._at("added_mass"), least=0.0))
        else:
            self._put("added_mass", _no_floats())

    def _refuse_empty_shapes(self, shapes: Floats) -> None:
        for row, shape in enumerate(shapes, 1):
            known = shape[np.isfinite(shape)]
            if known.size and not np.any(known):
                raise InputError(f"{self._at('mode_shapes')}, row {row} is zero at every measured floor; write nan where nothing was measured")

    def _refuse_equal_shapes(self, shapes: Floats) -> None:
        """Two modes of one frame differ; the same row twice is a mistake in the file."""
        for i in range(len(shapes)):
            for j in range(i):
                both = np.isfinite(shapes[i]) & np.isfinite(shapes[j])
                if both.sum() < 2:
                    continue
                a, b = shapes[i][both], shapes[j][both]
                if (a @ a) * (b @ b) > 0 and (a @ b) ** 2 >= (1 - 1e-12) * (a @ a) * (b @ b):
                    raise InputError(f"{self._at('mode_shapes')}, rows {j + 1} and {i + 1} are the same shape; each mode has its own")

    def _check_noise(self) -> None:
        count, width = self.mode_shapes.shape
        if self.frequency_std is not None:
            self._put("frequency_std", checks.one_or_many(self.frequency_std, self._at("frequency_std"), count, above=0.0))
        if self.mode_shape_std is not None:
            self._put("mode_shape_std", self._checked_shape_std(self.mode_shape_std, count, width))
        checks.choice(self.mode_shape_noise, NOISE_KINDS, self._at("mode_shape_noise"))

    def _checked_shape_std(self, value: object, count: int, width: int) -> Floats:
        where = self._at("mode_shape_std")
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, list | tuple) and any(isinstance(item, list | tuple) for item in value):
            std = checks.table(value, where, rows=count, above=0.0)
            if std.shape[1] != width:
                raise InputError(f"{where} has {std.shape[1]} entries a row, mode_shapes has {width}")
            return std
        return checks.frozen(np.repeat(checks.one_or_many(value, where, count, above=0.0)[:, None], width, axis=1))

    @staticmethod
    def from_dict(declared: object, *, name: str = "configuration 1") -> Configuration:
        """The configuration that a table `[[configuration]]` of a measurement file declares.

        Parameters
        ----------
        declared : dict
        name : str, optional
            Its name where the table gives none.
        """
        names = [item.name for item in dataclasses.fields(Configuration)]
        where = name
        if isinstance(declared, Mapping) and isinstance(declared.get("name"), str):
            where = f'configuration "{declared["name"]}"'
        table = checks.keys(declared, names, ["frequencies", "mode_shapes"], where)
        return Configuration(**{"name": name, **table})

    @property
    def noise_declared(self) -> bool:
        return self.frequency_std is not None and self.mode_shape_std is not None

    @property
    def measured(self) -> Bools:
        """Which entries of `mode_shapes` hold a number, shape (m, n)."""
        return np.isfinite(self.mode_shapes)

    @property
    def complete(self) -> bool:
        """Whether every mode was measured at every floor."""
        stories = len(self.added_mass)
        return self.mode_shapes.shape == (stories, stories) and bool(self.measured.all())

    @property
    def log_frequency_std(self) -> Floats:
        """Standard deviation of the logarithm of each frequency, shape (m,); the default where none is declared."""
        if self.frequency_std is None:
            return np.full(len(self.frequencies), DEFAULT_FREQUENCY_STD)
        return self.frequency_std

    @property
    def entry_std(self) -> Floats:
        """Standard deviation of each shape entry in the units of the entry, shape (m, n).

        Multiplicative noise on an entry measured as zero would weigh it infinitely; it is taken to be at
        least a thousandth of the mode's largest entry.
        """
        largest = np.max(np.abs(np.where(self.measured, self.mode_shapes, 0.0)), axis=1, keepdims=True)
        relative = DEFAULT_MODE_SHAPE_STD if self.mode_shape_std is None else self.mode_shape_std
        if self.mode_shape_noise == "multiplicative":
            return relative * np.maximum(np.abs(self.mode_shapes), 1e-3 * largest)
        return np.broadcast_to(relative * largest, self.mode_shapes.shape)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A frame, the configurations it was tested in, and what is known beforehand.

    Parameters
    ----------
    frame : Frame
    configurations : sequence of Configuration
        At least one.
    priors : sequence of Prior, optional
    name : str, optional
        For reports; the file's name where it was read from one.

    Raises
    ------
    InputError
        Where the parts do not fit each other, or nothing tells how heavy the frame is.
    """

    frame: Frame
    configurations: tuple[Configuration, ...]
    priors: tuple[Prior, ...] = ()
    name: str = "experiment"

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "configurations", tuple(self.configurations))
        put(self, "priors", tuple(self.priors))
        if not self.configurations:
            raise InputError("at least one [[configuration]] is needed")
        self._check_names()
        stories = self._count_stories()
        put(self, "frame", self.frame._completed(stories))
        put(self, "configurations", tuple(_fitted(each, stories) for each in self.configurations))
        for prior in self.priors:
            prior.check(stories)
        self._check_scale()

    def _check_names(self) -> None:
        seen: set[str] = set()
        for configuration in self.configurations:
            if configuration.name in seen:
                raise InputError(f'two configurations are named "{configuration.name}"; give each a name of its own')
            seen.add(configuration.name)

    def _count_stories(self) -> int:
        """The number of stories, which every part must agree on."""
        said: dict[str, int] = {}
        frame = self.frame
        if frame.stories:
            said["frame: stories"] = frame.stories
        if frame.story_heights is not None and len(frame.story_heights) > 1:
            said["frame: story_heights"] = len(frame.story_heights)
        if frame.floor_masses is not None:
            said["frame: floor_masses"] = len(frame.floor_masses)
        for each in self.configurations:
            if len(each.added_mass):
                said[f'configuration "{each.name}": added_mass'] = len(each.added_mass)
            if not len(each.measured_floors):
                said[f'configuration "{each.name}": mode_shapes (no measured_floors given)'] = each.mode_shapes.shape[1]
        if not said:
            each = max(self.configurations, key=lambda item: int(item.measured_floors[-1]))
            said[f'configuration "{each.name}": measured_floors'] = int(each.measured_floors[-1])
        (first, stories), *others = said.items()
        for key, count in others:
            if count != stories:
                raise InputError(f"{key} speaks of {count} stories, {first} of {stories}; they must agree")
        return stories

    def _check_scale(self) -> None:
        added = [tuple(each.added_mass) for each in self.configurations]
        if (
            self.frame.known_total is None
            and len(set(added)) < 2
            and not any(each.mass_normalized for each in self.configurations)
            and not any(prior.fixes_scale for prior in self.priors)
        ):
            raise InputError(
                "nothing tells how heavy the frame is: give frame: total_mass or floor_masses, two configurations with "
                "different added_mass, mass_normalized shapes, or a prior that fixes the scale (value, or nominal "
                "without free_scale)"
            )

    @staticmethod
    def from_dict(declared: object, *, name: str = "experiment") -> Experiment:
        """The experiment that a dict of the measurement file's shape declares.

        Parameters
        ----------
        declared : dict
            The keys `frame` (optional), `configuration` (list) and `prior` (list, optional).
        name : str, optional

        Returns
        -------
        Experiment

        Raises
        ------
        InputError
            Naming the key, the value found and what would be right.
        """
        table = checks.keys(declared, ["frame", "configuration", "prior"], [], "the measurement file")
        if "configuration" not in table:
            raise InputError("at least one [[configuration]] is needed")
        configurations = tuple(
            Configuration.from_dict(item, name=f"configuration {place}")
            for place, item in enumerate(_tables(table["configuration"], "configuration"), 1)
        )
        priors = []
        for place, item in enumerate(_tables(table.get("prior", []), "prior"), 1):
            try:
                priors.append(Prior.from_dict(item))
            except InputError as error:
                raise InputError(f"prior {place}: {error}") from error
        return Experiment(Frame.from_dict(table.get("frame", {})), configurations, tuple(priors), name)

    def to_dict(self) -> Json:
        """The dict of the measurement file's shape that declares this experiment."""
        result: Json = {"frame": _declared(self.frame, Frame())}
        if self.priors:
            result["prior"] = [prior.to_dict() for prior in self.priors]
        result["configuration"] = [_declared(each, None) for each in self.configurations]
        return result

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return self.frame.stories

    @property
    def noise_declared(self) -> bool:
        """Whether every configuration declares both standard deviations; otherwise the weights are only relative."""
        return all(each.noise_declared for each in self.configurations)

    def with_priors(self, priors: Sequence[Prior]) -> Experiment:
        """The same experiment with these priors besides its own."""
        return dataclasses.replace(self, priors=(*self.priors, *priors)) if priors else self


def _fitted(configuration: Configuration, stories: int) -> Configuration:
    """The configuration in a frame of so many stories: added mass filled in, floors and modes within it."""
    at = configuration._at
    floors, modes = configuration.measured_floors, configuration.modes
    if not len(floors):
        floors = checks.frozen(np.arange(1, stories + 1))
    if floors[-1] > stories:
        raise InputError(f"{at('measured_floors')} names floor {floors[-1]} of a frame of {stories} stories")
    if modes[-1] > stories:
        raise InputError(
            f"{at('modes')} names mode {modes[-1]}, a frame of {stories} stories has {stories}; leave out what is not a "
            "sway mode, or give the right number of stories"
        )
    added = configuration.added_mass if len(configuration.added_mass) else np.zeros(stories)
    return dataclasses.replace(configuration, added_mass=added, measured_floors=floors)


def _tables(value: object, key: str) -> list[object]:
    if not isinstance(value, list | tuple) or (key == "configuration" and not value):
        raise InputError(f"[[{key}]] must be a list of tables, not {checks.shown(value)}")
    return list(value)


def _declared(item: Frame | Configuration, defaults: Frame | None) -> Json:
    """The fields as plain values, without those left at their default."""
    result: Json = {}
    for each in dataclasses.fields(item):
        value = getattr(item, each.name)
        if value is None or (defaults is not None and value is getattr(defaults, each.name)):
            continue
        result[each.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return result
