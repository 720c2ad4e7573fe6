"""One tested state of the frame: the added masses and the measured modes with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cvxshear.measurement.declaration import InTable, named_in
from cvxshear.measurement.repeats import Repeats
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints, Json


@dataclass(frozen=True, eq=False)
class OtherModes(InTable):
    """Alternative mode numbers of a configuration, with their probability.

    Parameters
    ----------
    modes : array_like of int, shape (m,)
        In place of the configuration's own, ascending.
    probability : float
        That these are right, before anything is fitted.
    """

    modes: Ints
    probability: float

    @staticmethod
    def of(declared: object, own: Ints, where: str) -> OtherModes:
        """Read one entry of `other_modes`, which must fit the configuration's own modes.

        Parameters
        ----------
        declared : OtherModes or dict
        own : ndarray of int, shape (m,)
        where : str
            The key, for messages.

        Raises
        ------
        InputError
        """
        if isinstance(declared, OtherModes):
            declared = declared.to_dict()
        table = checks.keys(declared, ["modes", "probability"], ["modes", "probability"], where)
        modes = checks.ascending_whole(
            table["modes"], f"{where}: modes", most=checks.MOST_STORIES, length=len(own), each=", one a frequency"
        )
        if np.array_equal(modes, own):
            raise InputError(f"{where}: modes are those of the configuration itself; leave the entry out")
        probability = checks.number(table["probability"], f"{where}: probability", above=0.0)
        if probability >= 1.0:
            raise InputError(f"{where}: probability = {probability:g} must be below 1; give these as modes")
        return OtherModes(modes, probability)


def other_modes(declared: object, own: Ints, where: str) -> tuple[OtherModes, ...]:
    """Read the entries of `other_modes`; the sum of their probabilities must be less than 1.

    Raises
    ------
    InputError
    """
    tables = checks.items(declared, where, "tables, each with modes and probability")
    found = tuple(OtherModes.of(item, own, f"{where}, entry {place}") for place, item in enumerate(tables, 1))
    if len({tuple(item.modes.tolist()) for item in found}) < len(found):
        raise InputError(f"{where} has the same modes twice")
    total = sum(item.probability for item in found)
    if total >= 1.0:
        raise InputError(f"{where}: the probabilities add up to {total:g}; leave something to the modes given")
    return found


@dataclass(frozen=True, eq=False)
class Sensor(InTable):
    """A sensor on a floor that moves in x and y and turns.

    Its reading is d . (u_x - y theta, u_y + x theta), with d the unit vector of its direction, (x, y) its position, and
    (u_x, u_y, theta) the motion of the floor at the reference point.

    Parameters
    ----------
    floor : int
        1 the lowest.
    position : array_like, shape (2,)
        x and y from the reference point, the center of the plan, m.
    direction : float, optional
        Degrees from x to y.

    Raises
    ------
    InputError
    """

    floor: int
    position: Floats
    direction: float = 0.0

    def __post_init__(self) -> None:
        checks.put(self, "floor", checks.whole, "floor", least=1, most=checks.MOST_STORIES)
        checks.put(self, "position", checks.vector, "position", length=2, each=", x and y in m")
        checks.put(self, "direction", checks.number, "direction")

    @property
    def row(self) -> Floats:
        """Reading of a unit motion of its floor in x, in y and about the vertical axis, shape (3,)."""
        angle = np.deg2rad(self.direction)
        # Fifteen decimals: along y, exactly nothing of x is read.
        (x, y), (along, across) = self.position, np.round([np.cos(angle), np.sin(angle)], 15)
        return np.array([along, across, x * across - y * along])

    @staticmethod
    def rows(sensors: Sequence[Sensor], stories: int) -> Floats:
        """Write the readings of unit motions of all floors, shape (sensors, 3 N)."""
        found = np.zeros((len(sensors), 3 * stories))
        for row, sensor in zip(found, sensors, strict=True):
            row[3 * sensor.floor - 3 : 3 * sensor.floor] = sensor.row
        return found

    @staticmethod
    def each(declared: object, where: str) -> tuple[Sensor, ...]:
        """Read a list of sensors or of their tables.

        Raises
        ------
        InputError
            Naming the entry, the key, the value found and what would be right.
        """
        found: list[Sensor] = []
        for place, item in enumerate(checks.items(declared, where, "sensors"), 1):
            with checks.named(f"{where}, entry {place}"):
                found.append(Sensor.of_table(item, "a sensor", "floor", "position"))
        rows = {(each.floor, *each.row.round(12)) for each in found}
        if len(rows) < len(found):
            raise InputError(f"{where} has two sensors that read the same motion; give each entry of a shape its own")
        return tuple(found)


def motion_shares(sensors: Sequence[Sensor], shapes: Floats) -> Floats:
    """Compute how much of each mode is displacement in x, in y, and rotation.

    Parameters
    ----------
    sensors : sequence of Sensor, length r
    shapes : ndarray, shape (m, r)

    Returns
    -------
    ndarray, shape (m, 3)
        Shares of the sum of squares over the floors, of the motions of least squares at the reference points. A
        rotation is a displacement at the sensors' root mean square distance from their center.
    """
    places = np.array([sensor.position for sensor in sensors])
    radius = np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))
    motions = np.linalg.pinv(Sensor.rows(sensors, max(sensor.floor for sensor in sensors))) @ shapes.T
    squares = np.sum(motions.reshape(-1, 3, len(shapes)) ** 2, axis=0).T * [1.0, 1.0, radius**2]
    return np.asarray(squares / np.sum(squares, axis=1, keepdims=True))


#: Least count of equal numbers that makes a shape or a test a copy of another: one or two can be equal by rounding.
ENTRIES_OF_A_COPY = 3


def repeated_rows(shapes: Floats, *, whole: bool) -> tuple[int, int] | None:
    """Find the first two rows that are one shape.

    Modes of one frame are orthogonal by its masses, so no two are proportional over `whole` shapes. At some of the
    floors they can be; there only a copied row is found.

    Parameters
    ----------
    shapes : ndarray, shape (m, n)
        nan where not measured.
    whole : bool
        Whether there is an entry for every floor.

    Returns
    -------
    tuple of (int, int) or None
    """
    seen: dict[bytes, int] = {}
    for row, shape in enumerate(shapes):
        known = np.isfinite(shape)
        if known.all() if whole else known.sum() >= ENTRIES_OF_A_COPY:
            # Twelve digits: a scale changes the last ones. Zero has no sign.
            same = np.round(shape / shape[np.argmax(np.abs(shape))], 12) + 0.0 if whole else shape
            if (before := seen.setdefault(same.tobytes(), row)) != row:
                return before, row
    return None


DEFAULT_FREQUENCY_STD = 0.002
#: Relative, and relative to a mode's largest entry; `data.Frequencies.noise` and `data.Shapes.noise` say why.
DEFAULT_MODE_SHAPE_STD = 0.01

#: Largest asymmetry of a covariance, and smallest eigenvalue of its correlation: rounding of printed digits.
SYMMETRIC_TO = 1e-9

#: What `mode_shape_std` is relative to: a mode's largest entry, or the entry itself.
NOISE_KINDS = ("additive", "multiplicative")


def _no_floats() -> Floats:
    return checks.frozen(np.zeros(0))


def _no_ints() -> Ints:
    return checks.frozen(np.zeros(0, dtype=np.int64))


def _absent(value: object) -> bool:
    """Return whether a value means "not given"; the default factories write this as an empty array."""
    if isinstance(value, np.ndarray):
        return value.size == 0
    return value is None or (isinstance(value, list | tuple) and not value)


@dataclass(frozen=True, eq=False)
class Configuration(InTable):
    """One tested state of the frame, with its added masses and its measured modes.

    Parameters
    ----------
    frequencies : array_like, shape (m,)
        Natural frequencies, Hz, ascending; from `repeats` where these are given.
    mode_shapes : array_like, shape (m, n), optional
        One row a mode, one entry a measured floor, of any scale and sign; nan where not measured. A row of nan is a
        mode with a frequency and no shape. Without this array, no mode has a shape.
    name : str, optional
    state : str, optional
        The state of the frame: configurations of one state share what was undeclared about it; the configuration's
        name where empty.
    added_mass : array_like, shape (N,), optional
        kg on each floor, known; none where empty.
    added_mass_position : array_like, shape (N, 2), optional
        x and y of the added mass of each floor of a frame that turns, m; the reference point where empty.
    measured_floors : array_like of int, shape (n,), optional
        Ascending, 1 the lowest; all floors where empty.
    sensors : sequence of Sensor or dict, optional
        In place of `measured_floors` where the floors turn: one an entry of a shape.
    modes : array_like of int, shape (m,), optional
        Which modes of the model these are; 1, 2, ..., m where empty.
    other_modes : sequence of OtherModes or dict, optional
        Which other modes of the model these may be, each with the probability that it is so.
    mass_normalized : bool, optional
        Whether the shapes carry the scale 1/sqrt(kg).
    frequency_std : float or array_like, shape (m,), optional
        Relative standard deviation.
    frequency_covariance : array_like, shape (m, m), optional
        Relative covariance of the frequencies, in place of `frequency_std`.
    repeats : Repeats or dict, optional
        Repeated tests, in place of the frequencies, their covariance and, if it has shapes, of the shapes.
    mode_shape_std : float or array_like, shape (m,) or (m, n), optional
        Standard deviation of the entries, in the sense of `mode_shape_noise`.
    mode_shape_noise : str, optional
        "additive": std times the mode's largest entry; "multiplicative": std times the entry itself.
    damping_ratios : float or array_like, shape (m,), optional
        Fraction of critical, nan where not measured; not fitted with the modes, but what damping is made of.
    damping_ratio_std : float or array_like, shape (m,), optional
        Relative standard deviation of the damping ratios.
    date : str or date, optional
        Day or time of the test, ISO 8601 ("2024-05-03", "2024-05-03T14:30").
    temperature : float, optional
        Temperature of the frame, degrees C.
    amplitude : float, optional
        Largest motion in the test, in one unit for all tests.

    Raises
    ------
    InputError
        Naming the configuration, the key, the value found and what would be right.
    """

    frequencies: Floats = field(default_factory=_no_floats)
    mode_shapes: Floats = field(default_factory=_no_floats)
    name: str = "configuration 1"
    state: str = ""
    added_mass: Floats = field(default_factory=_no_floats)
    added_mass_position: Floats = field(default_factory=_no_floats)
    measured_floors: Ints = field(default_factory=_no_ints)
    sensors: tuple[Sensor, ...] = ()
    modes: Ints = field(default_factory=_no_ints)
    other_modes: tuple[OtherModes, ...] = ()
    mass_normalized: bool = False
    frequency_std: Floats | None = None
    frequency_covariance: Floats | None = None
    repeats: Repeats | None = None
    mode_shape_std: Floats | None = None
    mode_shape_noise: str = "additive"
    damping_ratios: Floats | None = None
    damping_ratio_std: Floats | None = None
    date: str | None = None
    temperature: float | None = None
    amplitude: float | None = None

    def __post_init__(self) -> None:
        checks.text(self.name, "configuration: name")
        self._put("state", checks.text(self.state, self._at("state")) if self.state else self.name)
        if self.repeats is not None:
            with checks.named(self._at("repeats")):
                self._put("repeats", Repeats.of_table(self.repeats, "the table", "frequencies"))
            self._replace(self.derived)
            if "mode_shape_std" in self.derived and self.mode_shape_noise != "additive":
                raise InputError(f"{self._at('mode_shape_noise')} must be additive, as the scatter of repeats is")
        self._check_modes()
        self._check_shapes()
        if self.frequency_covariance is not None:
            self._check_covariance(self.frequency_covariance)
        one_each: dict[str, Any] = {"length": len(self.frequencies), "each": ", one a mode"}
        self._check("frequency_std", checks.one_or_many, above=0.0, **one_each)
        if self.mode_shape_std is not None:
            self._put("mode_shape_std", self._checked_shape_std(self.mode_shape_std, *self.mode_shapes.shape))
        checks.choice(self.mode_shape_noise, NOISE_KINDS, self._at("mode_shape_noise"))
        self._check("damping_ratios", checks.one_or_many, least=0.0, nan=True, **one_each)
        if self.damping_ratios is not None:
            self._refuse_ratios(self.damping_ratios)
        self._check("damping_ratio_std", checks.one_or_many, above=0.0, **one_each)
        self._check("date", checks.date)
        self._check("temperature", checks.number)
        self._check("amplitude", checks.number, above=0.0)

    def _put(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _check(self, name: str, check: Callable[..., object], **limits: Any) -> None:
        """Put what a check returns in the place of a field; a default of None stays."""
        checks.put(self, name, check, self._at(name), **limits)

    @cached_property
    def derived(self) -> Mapping[str, Floats]:
        """Fields that follow from others, which cannot be given as well."""
        if self.repeats is not None:
            with checks.named(self._at("repeats")):
                return self.repeats.summary(mass_normalized=self.mass_normalized)
        return {}

    def _check_given(self, name: str, otherwise: object, check: Callable[..., object], **limits: Any) -> None:
        """Check a field that is given, or put a default in its place."""
        if _absent(getattr(self, name)):
            self._put(name, otherwise)
        else:
            self._check(name, check, **limits)

    def _replace(self, found: Mapping[str, Floats], by: str = "repeats") -> None:
        """Put fields that follow from another field; a copy may have them already."""
        for key, value in found.items():
            given = getattr(self, key)
            if not _absent(given) and not np.array_equal(given, value, equal_nan=True):
                raise InputError(f"{self._at(key)} and {by} are both given: leave {key} out, {by} replaces it")
            self._put(key, checks.frozen(value))

    def _at(self, key: str) -> str:
        return f'configuration "{self.name}": {key}'

    def _check_modes(self) -> None:
        self._check("frequencies", checks.vector, above=0.0)
        steps = np.flatnonzero(np.diff(self.frequencies) <= 0)
        if steps.size:
            place = int(steps[0])
            before, after = self.frequencies[place : place + 2]
            cure = "sort the mode shapes with them"
            if len(self.frequencies) > 2 and len(steps) == len(self.frequencies) - 1:
                cure = f"all descend as periods in s do: write 1 / period, or else {cure}"
            raise InputError(
                f"{self._at('frequencies')} must be ascending, each greater than the one before; entry {place + 2} "
                f"is {after:g} Hz after {before:g} Hz ({cure})"
            )
        count = len(self.frequencies)
        one_each: dict[str, Any] = {"most": checks.MOST_STORIES, "length": count, "each": ", one a frequency"}
        self._check_given("modes", checks.frozen(np.arange(1, count + 1)), checks.ascending_whole, **one_each)
        self._put("other_modes", other_modes(self.other_modes, self.modes, self._at("other_modes")))

    def _check_covariance(self, value: object) -> None:
        """Check the covariance of the frequencies, and derive their standard deviations from it."""
        where, count = self._at("frequency_covariance"), len(self.frequencies)
        covariance = checks.table(value, where, rows=count, columns=count)
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if np.max(np.abs(covariance - covariance.T)) > SYMMETRIC_TO * np.max(np.abs(covariance)):
            raise InputError(f"{where} must be symmetric: entry [i][j] equal to entry [j][i]")
        if not np.all(std > 0) or np.linalg.eigvalsh(covariance / np.outer(std, std))[0] <= SYMMETRIC_TO:
            raise InputError(
                f"{where} must be positive definite: a variance above zero for each frequency, and no combination of "
                "frequencies that is known exactly; with fewer tests than frequencies, give repeats"
            )
        self._put("frequency_covariance", checks.frozen(0.5 * (covariance + covariance.T)))
        self._replace({"frequency_std": std}, "frequency_covariance" if self.repeats is None else "repeats")

    def _refuse_ratios(self, ratios: Floats) -> None:
        where = self._at("damping_ratios")
        if np.all(np.isnan(ratios)):
            raise InputError(f"{where} must have a number for one mode at least; leave it out otherwise")
        if np.any(ratios >= 1):
            raise InputError(
                f"{where} must be below 1 (a fraction of critical, not percent), not {np.nanmax(ratios):g}"
            )

    def _check_shapes(self) -> None:
        count = len(self.frequencies)
        self._check_given("mode_shapes", checks.frozen(np.zeros((count, 0))), checks.table, rows=count, nan=True)
        self._refuse_empty_shapes(self.mode_shapes)
        self._check("mass_normalized", checks.flag)
        self._check_added_mass()
        width = self.mode_shapes.shape[1]
        self._put("sensors", Sensor.each(self.sensors, self._at("sensors")))
        if self.sensors:
            self._check_sensors(width)
            return
        whole = _absent(self.measured_floors) or len(self.added_mass) == width
        if not width and not _absent(self.measured_floors):
            where = self._at("measured_floors")
            raise InputError(f"{where} is given, but no mode_shapes: leave it out, or give the shapes")
        one_each: dict[str, Any] = {"length": width, "each": ", one an entry in each row of mode_shapes"}
        most = checks.MOST_STORIES
        self._check_given("measured_floors", _no_ints(), checks.ascending_whole, most=most, **one_each)
        if width and (pair := repeated_rows(self.mode_shapes, whole=whole)) is not None:
            raise InputError(
                f"{self._at('mode_shapes')}, rows {pair[0] + 1} and {pair[1] + 1} are the same shape; each mode "
                "has its own"
            )

    def _check_added_mass(self) -> None:
        self._check_given("added_mass", _no_floats(), checks.vector, least=0.0)
        if not _absent(self.added_mass_position):
            if not len(self.added_mass):
                raise InputError(f"{self._at('added_mass_position')} is given, but no added_mass: give both")
            self._check("added_mass_position", checks.pairs, length=len(self.added_mass))

    def _check_sensors(self, width: int) -> None:
        where = self._at("sensors")
        if not _absent(self.measured_floors):
            raise InputError(f"{where} and measured_floors both say what a shape shows; give sensors alone")
        self._put("measured_floors", _no_ints())
        if len(self.sensors) != width:
            raise InputError(f"{where} has {checks.entries(len(self.sensors))}, each row of mode_shapes has {width}")

    def _refuse_empty_shapes(self, shapes: Floats) -> None:
        for row, shape in enumerate(shapes, 1):
            known = shape[np.isfinite(shape)]
            if known.size and np.max(np.abs(known)) < checks.SMALLEST:
                raise InputError(
                    f"{self._at('mode_shapes')}, row {row} is zero at every measured floor; write nan where nothing "
                    "was measured"
                )

    def _checked_shape_std(self, value: object, count: int, width: int) -> Floats:
        """Check one number, one a mode, or one an entry, and return one an entry."""
        where = self._at("mode_shape_std")
        if not width:
            raise InputError(f"{where} is given, but no mode_shapes: leave it out, or give the shapes")
        if checks.many(value) and any(map(checks.many, checks.items(value, where, "numbers"))):
            return checks.table(value, where, rows=count, columns=width, above=0.0)
        each = checks.one_or_many(value, where, count, each=", one a mode", above=0.0)
        return checks.frozen(np.repeat(each[:, None], width, axis=1))

    @staticmethod
    def from_dict(
        declared: object, *, name: str = "configuration 1", elsewhere: Mapping[str, str] | None = None
    ) -> Configuration:
        """Read the configuration that a table `[[configuration]]` of a measurement file declares.

        Parameters
        ----------
        declared : dict
        name : str, optional
            Its name where the table gives none.
        elsewhere : dict, optional
            Keys of other tables of the file, each with that table's header, for a message that says where they belong.
        """
        where = named_in(declared, "configuration", name)
        for key in ("added_mass", "added_mass_position", "measured_floors", "sensors", "modes", "mode_shapes"):
            if isinstance(declared, Mapping) and declared.get(key) is not None and _absent(declared[key]):
                raise InputError(f"{where}: {key} must not be empty; leave the key out for its default")
        repeated = isinstance(declared, Mapping) and declared.get("repeats") is not None
        required = () if repeated else ("frequencies",)
        return Configuration.of_table(declared, where, *required, elsewhere=elsewhere, name=name)

    def to_dict(self) -> Json:
        """Return the table that declares it, without the fields that follow from others."""
        replaced = {*self.derived, *(["frequency_std"] if self.frequency_covariance is not None else [])}
        return {key: value for key, value in super().to_dict().items() if key not in replaced}

    @property
    def unsaid(self) -> Mapping[str, object]:  # type: ignore[override]  # it hangs on the name
        """A state of the configuration's own name need not be given."""
        return {"state": self.name}

    def in_frame(self, stories: int, motions: int = 1) -> Configuration:
        """Fill in the added masses for a frame of the given numbers of stories and of motions per floor; check it.

        Raises
        ------
        InputError
            Where it names a floor or a mode that the frame has not.
        """
        floors, modes, most = self.measured_floors, self.modes, stories * motions
        for place, sensor in enumerate(self.sensors, 1):
            checks.whole(sensor.floor, f"{self._at('sensors')}, entry {place}: floor", least=1, most=stories)
        if not self.sensors and not len(floors) and self.mode_shapes.shape[1]:
            floors = checks.frozen(np.arange(1, stories + 1))
        if len(floors) and floors[-1] > stories:
            raise InputError(
                f"{self._at('measured_floors')} names floor {floors[-1]} of a frame of {stories} stories; floors count "
                f"from 1, the first above ground, to {stories}"
            )
        if modes[-1] > most:
            raise InputError(
                f"{self._at('modes')} names mode {modes[-1]} (where not given: 1 to {len(modes)}, the number of "
                f"frequencies), a frame of {stories} stories has {most}; leave out what is not a sway mode, or give "
                "the right number of stories"
            )
        for place, other in enumerate(self.other_modes, 1):
            if other.modes[-1] > most:
                raise InputError(
                    f"{self._at('other_modes')}, entry {place} names mode {other.modes[-1]}; a frame of {stories} "
                    f"stories has {most}"
                )
        added = self.added_mass if len(self.added_mass) else np.zeros(stories)
        return replace(self, added_mass=added, measured_floors=floors)

    @property
    def highest_floor(self) -> int:
        """The highest floor with a sensor; 0 where no floor is named."""
        return int(max((*self.measured_floors.tolist(), *(sensor.floor for sensor in self.sensors)), default=0))

    @property
    def noise_declared(self) -> bool:
        """Whether both standard deviations were given."""
        return self.frequency_std is not None and self.mode_shape_std is not None

    @cached_property
    def measured(self) -> Bools:
        """Which entries of `mode_shapes` hold a number, shape (m, n)."""
        return np.isfinite(self.mode_shapes)

    @cached_property
    def entry_floors(self) -> Ints:
        """Floor of each entry of a shape, shape (n,)."""
        return np.array([each.floor for each in self.sensors]) if self.sensors else self.measured_floors

    @cached_property
    def entry_rows(self) -> Ints:
        """Row of the observation matrix that each entry of a shape shows, shape (n,)."""
        return np.arange(len(self.sensors)) if self.sensors else self.measured_floors - 1

    @cached_property
    def sensor_rows(self) -> Floats:
        """Observation matrix of the sensors of a frame of N floors that turn, shape (n, 3 N)."""
        return Sensor.rows(self.sensors, len(self.added_mass))

    def unloaded(self, name: str) -> Configuration:
        """Return a test of a state of its own with the same sensors and no added mass."""
        return replace(self, name=name, state=name, added_mass=np.zeros(len(self.added_mass)))

    @cached_property
    def known_shapes(self) -> Floats:
        """`mode_shapes` with zero for entries that were not measured, shape (m, n)."""
        return np.where(self.measured, self.mode_shapes, 0.0)

    @cached_property
    def entry_weights(self) -> Floats:
        """Inverse standard deviation of each shape entry, zero for entries that were not measured, shape (m, n)."""
        known = self.measured
        return np.asarray(np.where(known, 1.0 / np.where(known, self.entry_std, 1.0), 0.0))

    @property
    def complete(self) -> bool:
        """Whether every mode was measured at every floor."""
        stories = len(self.added_mass)
        return self.mode_shapes.shape == (stories, stories) and bool(self.measured.all())

    @cached_property
    def log_frequency_std(self) -> Floats:
        """Standard deviation of the logarithm of each frequency, declared or default, shape (m,)."""
        if self.frequency_std is None:
            return np.full(len(self.frequencies), DEFAULT_FREQUENCY_STD)
        return self.frequency_std

    @cached_property
    def frequency_correlation(self) -> Floats | None:
        """Correlation of the logarithms of the frequencies, shape (m, m); None if they are independent."""
        if self.frequency_covariance is None:
            return None
        return np.asarray(self.frequency_covariance / np.outer(self.log_frequency_std, self.log_frequency_std))

    @cached_property
    def entry_std(self) -> Floats:
        """Standard deviation of each shape entry in the units of the entry, shape (m, n).

        Multiplicative noise on an entry measured as zero would weigh it infinitely; it is taken to be at
        least a thousandth of the mode's largest entry.
        """
        largest = np.max(np.abs(self.known_shapes), axis=1, keepdims=True, initial=0.0)
        relative = DEFAULT_MODE_SHAPE_STD if self.mode_shape_std is None else self.mode_shape_std
        if self.mode_shape_noise == "multiplicative":
            return np.asarray(relative * np.maximum(np.abs(self.mode_shapes), 1e-3 * largest))
        return np.broadcast_to(relative * largest, self.mode_shapes.shape)
