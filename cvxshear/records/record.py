"""A record: channels and runs with their sampling and input. Time histories or frequency response functions.

A record holds physical values: sign and calibration have been applied. Its arrays are read-only.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from string import Formatter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cvxshear.records.data_frames import FEWEST_SAMPLES, columns_of, matrix_of, sound_pieces
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import InJson
from cvxshear.util.typing import Complexes, Floats, Ints, Json


@dataclass(frozen=True)
class Finding(InJson):
    """One thing that is wrong with a record, or that it cannot tell.

    Parameters
    ----------
    kind : str
        "clock offset", "dead channel", ...: a key of `records/findings.toml`, up to its slash; or "pieces".
    message : str
        For people, with the numbers and their units.
    numbers : dict, optional
        The same numbers for programs.
    """

    kind: str
    message: str
    numbers: Json = field(default_factory=dict)


@dataclass(frozen=True)
class Channel:
    """One measured response: where the sensor sits and which way it points.

    Parameters
    ----------
    name : str
        The column or data set it was read from.
    floor : int
        0 the ground, 1 the first floor above it.
    axis : str, optional
        Direction of shaking, any name ("x").
    place : str, optional
        Where the channel was declared, for messages ('line 12 of record.toml'); the name where empty.
    unit : str, optional
        The unit in which the sensor was recorded ("g", "mm/s2"); the record's values have been converted from it.
    position : (float, float), optional
        Where the sensor sits on its floor, m: along the direction of test, and across it. Of floors that turn, x and y
        from the center of the plan.
    direction : float, optional
        Degrees from the direction of test, or from x, to the sensor's axis, counter-clockwise; 0 where not given.
    """

    name: str
    floor: int
    axis: str = "x"
    place: str = ""
    unit: str | None = None
    position: tuple[float, float] | None = None
    direction: float | None = None

    def __post_init__(self) -> None:
        checks.text(self.name, "channel: name")
        checks.whole(self.floor, f'channel "{self.name}": floor', least=0, most=checks.MOST_STORIES)
        checks.text(self.axis, f'channel "{self.name}": axis')
        checks.put(self, "unit", checks.text, f'channel "{self.name}": unit')
        if self.position is not None:
            x, y = checks.vector(self.position, f'channel "{self.name}": position (m, along and across)', length=2)
            object.__setattr__(self, "position", (float(x), float(y)))
        checks.put(self, "direction", checks.number, f'channel "{self.name}": direction (degrees)')

    def __str__(self) -> str:
        spot = f"floor {self.floor}" if self.floor else "ground"
        return f'channel "{self.name}" ({spot}{", " + self.place if self.place else ""})'


@dataclass(frozen=True, eq=False)
class Run(checks.ReadOnlyArrays):
    """One uninterrupted stretch of time: a hit, a release, an earthquake, an hour of wind.

    Parameters
    ----------
    responses : array_like, shape (samples, channels)
        m/s2, m/s or m, one column a channel of the record.
    excitation : array_like, shape (samples,), optional
        N for a force, m/s2 for a base acceleration.
    floor : int, optional
        Where the force acts; 0 for a base acceleration or none.
    name : str, optional
    start, end : float, optional
        s; the part of the file that this run is. The arrays hold that part alone.
    """

    responses: Floats
    excitation: Floats | None = None
    floor: int = 0
    name: str = "run 1"
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        responses = matrix_of(self.responses, f"{self.name}: responses", np.float64)
        object.__setattr__(self, "responses", responses)
        if self.excitation is not None:
            excitation = np.asarray(matrix_of([self.excitation], f"{self.name}: excitation", np.float64)[0])
            if excitation.shape != (len(responses),):
                raise InputError(
                    f"{self.name}: excitation has {excitation.size} samples, the responses have {len(responses)}"
                )
            object.__setattr__(self, "excitation", checks.frozen(excitation))
        for key in ("start", "end"):
            checks.put(self, key, checks.number, f"{self.name}: {key} (s)")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise InputError(f"{self.name}: end = {self.end:g} s must come after start = {self.start:g} s")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.responses)


@dataclass(frozen=True, eq=False)
class FrfRun(checks.ReadOnlyArrays):
    """The responses to a unit force at one floor, by frequency.

    Parameters
    ----------
    responses : array_like of complex, shape (lines, channels)
        Response over force: accelerance (m/s2)/N, mobility (m/s)/N or receptance m/N.
    floor : int
        Where the force acts.
    name : str, optional
    """

    responses: Complexes
    floor: int
    name: str = "run 1"

    def __post_init__(self) -> None:
        object.__setattr__(self, "responses", matrix_of(self.responses, f"{self.name}: responses", np.complex128))
        checks.whole(self.floor, f"{self.name}: input_floor", least=1, most=checks.MOST_STORIES)


INPUTS = ("none", "free_decay", "force", "base")
RECORDED_QUANTITIES = ("acceleration", "velocity", "displacement")
#: A frequency response with fewer lines has too few across any resonance.
FEWEST_LINES = 32


@dataclass(frozen=True, eq=False)
class _Recorded(checks.ReadOnlyArrays):
    """Common part of time histories and frequency response functions."""

    channels: tuple[Channel, ...]
    stories: int = 0
    quantity: str = "acceleration"
    band: tuple[float, float] | None = None
    exponential_window: float | None = None
    name: str = "record"
    runs: tuple[Run, ...] | tuple[FrfRun, ...] = ()
    turns: bool = False

    def _check_common(self) -> None:
        put = object.__setattr__
        put(self, "channels", tuple(self.channels))
        put(self, "runs", tuple(self.runs))
        checks.choice(self.quantity, RECORDED_QUANTITIES, "record: quantity")
        if not self.runs:
            raise InputError("record: at least one run is needed")
        if not self.channels:
            raise InputError("record: at least one response channel on a floor is needed")
        for channel in self.channels:
            if channel.floor == 0:
                raise InputError(f'{channel} is on the ground: it can only be the input, with input = "base"')
            if self.turns and channel.position is None:
                raise InputError(f"{channel} needs a position: the floors turn (frame: motions)")
            if not self.turns and channel.axis != self.channels[0].axis:
                raise InputError(
                    f"{channel} points along {channel.axis}, {self.channels[0]} along {self.channels[0].axis}; "
                    "the channels of a record share one axis"
                )
        highest = int(self.floors.max())
        if self.stories == 0:
            put(self, "stories", highest)
        checks.whole(self.stories, "record: stories", least=highest, most=checks.MOST_STORIES)
        checks.put(
            self, "exponential_window", checks.number, "record: exponential_window (time constant, s)", above=0.0
        )
        if self.band is not None:
            low, high = checks.vector(self.band, "record: band", length=2, least=0.0)
            if high <= low:
                raise InputError(f"record: band = [{low:g}, {high:g}] must be ascending, in Hz")
            put(self, "band", (float(low), float(high)))

    @property
    def window_decay(self) -> float:
        """Decay rate that the exponential window added to every mode, 1/s."""
        return 0.0 if self.exponential_window is None else 1.0 / self.exponential_window

    @property
    def most_modes(self) -> int:
        """Number of modes of the frame: one a story, or three where the floors turn."""
        return 3 * self.stories if self.turns else self.stories

    @property
    def floors(self) -> Ints:
        """The floor of each channel, shape (channels,)."""
        return np.array([channel.floor for channel in self.channels], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class TimeRecord(_Recorded):
    """Time histories.

    Parameters
    ----------
    channels : sequence of Channel
        The responses, one a floor or several; ordered by floor on construction.
    stories : int, optional
        Stories of the frame; the highest measured floor where 0.
    quantity : str, optional
        What the responses are: "acceleration", "velocity", "displacement".
    band : (float, float), optional
        Hz; where natural frequencies are looked for. The record is decimated to it.
    exponential_window : float, optional
        s; time constant of an exponential window that had been applied to the responses.
    name : str, optional
    runs : sequence of Run
    turns : bool, optional
        Whether the floors move in x and y and turn; then each channel has a position, and its own direction.
    sampling_rate : float
        Hz.
    input : str
        "none" (ambient), "free_decay", "force" or "base" (base acceleration).

    Raises
    ------
    InputError
        Naming the channel or the run, and what would be right.
    """

    runs: tuple[Run, ...] = ()
    sampling_rate: float = 0.0
    input: str = "none"

    def __post_init__(self) -> None:
        self._check_common()
        rate = checks.number(self.sampling_rate, "record: sampling_rate", above=0.0)
        object.__setattr__(self, "sampling_rate", rate)
        checks.choice(self.input, INPUTS, "record: input")
        for run in self.runs:
            self._check_run(run)
        if self.band is not None and self.band[0] >= rate / 2:
            raise InputError(f"record: band starts at {self.band[0]:g} Hz, above half the sampling rate {rate:g} Hz")
        _order_by_floor(self)

    def _check_run(self, run: Run) -> None:
        if run.responses.shape[1] != len(self.channels):
            raise InputError(f"{run.name} has {run.responses.shape[1]} channels, the record {len(self.channels)}")
        if run.samples < FEWEST_SAMPLES:
            raise InputError(
                f"{run.name} has {run.samples} samples; at least {FEWEST_SAMPLES} are needed to find a mode in it"
            )
        for column, channel in enumerate(self.channels):
            _refuse_nonfinite(run.responses[:, column], f"{run.name}: {channel}")
        driven = self.input in ("force", "base")
        if driven and run.excitation is None:
            raise InputError(f'{run.name} lacks the input channel that input = "{self.input}" asks for')
        if run.excitation is not None:
            _refuse_nonfinite(run.excitation, f"{run.name}: the input channel")
            if driven and not np.any(run.excitation):
                raise InputError(f"{run.name}: the input channel is zero throughout")
        if self.input == "force":
            checks.whole(run.floor, f"{run.name}: input_floor", least=1, most=self.stories)

    @staticmethod
    def of(
        table: Any,
        *,
        floors: Mapping[Any, int] | Sequence[int] | None = None,
        excitation: Hashable | ArrayLike | None = None,
        drive: str | None = None,
        input_floor: int = 0,
        sampling_rate: float | None = None,
        **options: Any,
    ) -> TimeRecord:
        """Make a record of one run in a table: an array or a pandas DataFrame.

        Parameters
        ----------
        table : array_like, shape (samples, channels), or pandas.DataFrame
            m/s2, m/s or m. A data frame has one column a channel and the time as its index or in a column "time",
            "time_s", "t", .... Samples that are missing (nan) part it into runs, as in a file.
        floors : mapping to int, or sequence of int, optional
            The floor of each channel used, by its name or in the order of the columns; 1, 2, ... where None.
        excitation : str or other name of a column, or array_like, shape (samples,), optional
            The input: the name of its column, or its samples; N for a force, m/s2 for a base acceleration.
        drive : str, optional
            `input` of the record; where None "base" with an excitation, "force" where `input_floor` is given too, and
            "none" without.
        input_floor : int, optional
            Where a force acts.
        sampling_rate : float, optional
            Hz; from the time of the data frame where None.
        **options
            Of `TimeRecord`: stories, quantity, band, name, ....

        Returns
        -------
        TimeRecord

        Raises
        ------
        InputError
            Where a channel is not in the table, its time does not ascend in even steps, or the sampling rate is unknown
            or contradictory.
        """
        columns, rate = columns_of(table, sampling_rate)
        named = isinstance(excitation, Hashable) and (isinstance(excitation, str) or str(excitation) in columns)
        left = [name for name in columns if not (named and name == str(excitation))]
        chosen: dict[str, int]
        if isinstance(floors, Mapping):
            chosen = {str(name): floor for name, floor in floors.items()}
        else:
            chosen = dict(zip(left, range(1, len(left) + 1) if floors is None else floors, strict=False))
            if floors is not None and len(floors) != len(left):
                raise InputError(f"floors must have {len(left)} entries, one a channel, not {len(floors)}")
        for name in [*chosen, *([str(excitation)] if named else [])]:
            if name not in columns:
                raise InputError(f'there is no channel "{name}" in the table; there are {", ".join(columns)}')
        force: Any = columns[str(excitation)] if named else excitation
        if drive is None:
            drive = "none" if force is None else "force" if input_floor else "base"
        responses = np.column_stack([columns[name] for name in chosen])
        channels = tuple(Channel(name, floor) for name, floor in chosen.items())
        whole = Run(responses, force, input_floor)
        sound = np.all(np.isfinite(whole.responses), axis=1)
        if whole.excitation is not None:
            sound &= np.isfinite(whole.excitation)
        driven = whole.excitation
        runs = tuple(
            Run(whole.responses[piece], None if driven is None else driven[piece], input_floor, f"run {number}")
            for number, piece in enumerate(sound_pieces(sound), 1)
        )
        return TimeRecord(channels, runs=runs, sampling_rate=rate, input=drive, **options)

    @property
    def duration(self) -> float:
        """Length of all runs together, s."""
        return sum(run.samples for run in self.runs) / self.sampling_rate

    @property
    def largest(self) -> float:
        """Largest motion of a channel about its mean, in the unit of the responses."""
        return max(float(np.abs(run.responses - run.responses.mean(axis=0)).max()) for run in self.runs)


@dataclass(frozen=True, eq=False)
class FrfRecord(_Recorded):
    """Frequency response functions on one common, evenly spaced frequency axis.

    Parameters
    ----------
    channels, stories, quantity, band, exponential_window, name
        As for `TimeRecord`.
    runs : sequence of FrfRun
        One a driving point, or several repetitions of one.
    frequencies : array_like, shape (lines,)
        Hz, ascending by one step, starting at zero or at a whole multiple of the step.
    truncated : bool, optional
        Whether the functions were computed from responses cut off at the end of the window before they had decayed
        (leakage), rather than being samples of the true functions.

    Raises
    ------
    InputError
        Naming the channel or the run, and what would be right.
    """

    runs: tuple[FrfRun, ...] = ()
    frequencies: Floats = field(default_factory=lambda: np.zeros(0))
    truncated: bool = True

    def __post_init__(self) -> None:
        self._check_common()
        frequencies = checks.vector(self.frequencies, "record: frequencies", least=0.0)
        object.__setattr__(self, "frequencies", frequencies)
        checks.put(self, "truncated", checks.flag, "record: truncated")
        if len(frequencies) < FEWEST_LINES:
            raise InputError(f"record: {len(frequencies)} frequency lines; at least {FEWEST_LINES} are needed")
        _check_even_lines(frequencies)
        for run in self.runs:
            if run.responses.shape != (len(frequencies), len(self.channels)):
                raise InputError(
                    f"{run.name} has {run.responses.shape[0]} lines of {run.responses.shape[1]} channels, the record "
                    f"{len(frequencies)} of {len(self.channels)}"
                )
            checks.whole(run.floor, f"{run.name}: input_floor", least=1, most=self.stories)
            for column, channel in enumerate(self.channels):
                _refuse_nonfinite(run.responses[:, column], f"{run.name}: {channel}")
        _order_by_floor(self)

    @property
    def step(self) -> float:
        """Spacing of the lines, Hz."""
        return float(self.frequencies[-1] - self.frequencies[0]) / (len(self.frequencies) - 1)

    @property
    def sampling_rate(self) -> float:
        """Twice the highest line: the rate of the impulse responses, Hz."""
        return 2.0 * float(self.frequencies[-1])


Record = TimeRecord | FrfRecord


def _refuse_nonfinite(values: NDArray[Any], where: str) -> None:
    bad = np.flatnonzero(~(np.abs(values) <= checks.LARGEST))
    if bad.size:
        raise InputError(f"{where} holds {values[bad[0]]} at sample {bad[0] + 1} ({bad.size} such in all)")


def _check_even_lines(frequencies: Floats) -> None:
    steps = np.diff(frequencies)
    step = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - step) > 0.01 * step)
    if step <= 0 or uneven.size:
        place = int(uneven[0]) if uneven.size else 0
        raise InputError(
            f"record: the frequency lines must ascend by one step; after {frequencies[place]:g} Hz comes "
            f"{frequencies[place + 1]:g} Hz where the step is {step:g} Hz"
        )
    if not math.isclose(frequencies[0] / step, round(frequencies[0] / step), abs_tol=0.02):
        raise InputError(
            f"record: the first line, {frequencies[0]:g} Hz, must be a whole multiple of the step, {step:g} Hz"
        )


def _order_by_floor(record: TimeRecord | FrfRecord) -> None:
    """Put the channels and the columns of every run into ascending order of floors."""
    order = np.argsort(record.floors, kind="stable")
    if np.all(np.diff(order) > 0):
        return
    put = object.__setattr__
    put(record, "channels", tuple(record.channels[place] for place in order))
    for run in record.runs:
        put(run, "responses", checks.frozen(run.responses[:, order].copy()))


#: Sentence of each kind of finding; a key with a slash is one case of a kind.
SENTENCES: dict[str, str] = tomllib.loads(
    resources.files("cvxshear.records").joinpath("findings.toml").read_text(encoding="utf-8")
)

#: Units of gaps, with the factor for a ratio or for seconds.
SCALES = {"%": 1e2, "ms": 1e3, "ppm": 1e6}


class _Gaps(Formatter):
    """Fills gaps; for example `{share:.0f %}` is a number with a unit."""

    def format_field(self, value: object, format_spec: str) -> str:
        form, _, unit = format_spec.partition(" ")
        return f"{format(SCALES[unit] * value, form)} {unit}" if unit else format(value, form)  # type: ignore[operator]


def finding(key: str, numbers: Json, /, **words: object) -> Finding:
    """Report something that is wrong with a record, or that it cannot tell.

    Parameters
    ----------
    key : str
        Key of `SENTENCES`; the part before a slash is the kind of finding.
    numbers : dict
        For programs, and for the gaps of the sentence.
    **words
        What else its gaps hold.
    """
    return Finding(key.partition("/")[0], _Gaps().vformat(SENTENCES[key], (), {**numbers, **words}), numbers)
