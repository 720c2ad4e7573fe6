"""Accelerations that sensors on some floors recorded, with gaps, and the excitation.

Sensor faults that the record itself shows are corrected first (`SensorRecord`). The checks are the same as in
`cvxshear modes`. They use the segments that every sensor recorded. Corrections of certain faults apply to the whole
record, including the parts with gaps.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from cvxshear.io.csv import Columns
from cvxshear.io.record_tables import ChannelDeclaration, RecordFile, placed
from cvxshear.records import data_frames, examination, prepare
from cvxshear.records.identify import identify_modes
from cvxshear.records.motion import DRIVEN, DrivenRecord, band_limited, trend
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.response.state_space import ROUNDING
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.typing import Bools, Floats, Ints

RecordingSource = str | Path | TimeRecord | DrivenRecord

#: Kinds of findings that concern the sensors. The smoother handles spikes and straight lines by its weights.
SAID = (
    "dead channel", "stuck channel", "clipped channel", "direction", "sign", "unit",
    "swapped channels", "clock offset", "clock drift", "lost samples", "low-pass", "resonance", "gain step",
)  # fmt: skip


#: Periods of a motion whose sums vary independently of the next ones.
BLOCK_PERIODS = 4.0

#: Largest value of a straight line, in standard deviations of the mean motion, that counts as chance: two standard
#: deviations, doubled because a line is largest at its ends.
BY_CHANCE = 4.0

#: Least delay that is removed, in samples. The delay is estimated from the phases of the modes, and there may be only
#: three: with 10 % noise on the base motion, a sound record may show 0.08 samples. A damper in one story turns the
#: phases too; taken for a delay, it leaves false dampers in other stories.
LEAST_DELAY = 0.25


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One uninterrupted run of a recording.

    Parameters
    ----------
    measured : ndarray, shape (samples, m)
        Total accelerations, m/s2; nan in gaps.
    excitation : ndarray, shape (samples,)
        m/s2 or N.
    floor : int, optional
        Floor on which a measured force acts.
    between : ndarray, shape (samples,), optional
        Samples whose straight lines are the excitation between the samples; by default, the samples of `excitation`.
    """

    measured: Floats
    excitation: Floats
    name: str
    floor: int = 0
    between: Floats | None = None

    @property
    def drive(self) -> Floats:
        """Excitation between the samples and at the samples, as in `Dynamics`, shape (samples, 2)."""
        return np.column_stack([self.excitation if self.between is None else self.between, self.excitation])

    def pieces(self, least: int) -> list[tuple[slice, Bools]]:
        """Split the run at gaps of `least` samples or more; return the parts and their recording channels, (m,)."""
        recorded = np.ones(self.measured.shape, dtype=bool)
        for column, there in enumerate(np.isfinite(self.measured).T):
            ends = np.flatnonzero(np.diff(np.concatenate([[True], there, [True]]).astype(np.int8)))
            for first, last in ends.reshape(-1, 2).tolist():
                recorded[first:last, column] = last - first < least
        edges = [0, *(np.flatnonzero(np.any(np.diff(recorded, axis=0), axis=1)) + 1).tolist(), len(recorded)]
        return [(slice(first, last), recorded[first]) for first, last in pairwise(edges)]


@dataclass(frozen=True, eq=False)
class Recording:
    """Accelerations of some floors, and the excitation.

    Parameters
    ----------
    sampling_rate : float
        Hz.
    floors : ndarray of int, shape (m,)
        Ascending.
    input : str
        "base" or "force".
    added_mass : ndarray, shape (N,), optional
        kg.
    remarks : tuple of str
        Sensor faults, and their corrections.
    late : ndarray, shape (m, 2), optional
        Delay (s) and its growth (s/s) that were removed from each floor's motion.
    late_remarks : tuple of str, optional
        Remark on this delay, for each floor.
    """

    runs: tuple[RecordedRun, ...]
    sampling_rate: float
    floors: Ints
    input: str
    added_mass: Floats | None = None
    state: str | None = None
    name: str = "record"
    remarks: tuple[str, ...] = ()
    late: Floats | None = None
    late_remarks: tuple[str, ...] = ()

    @property
    def force_floor(self) -> int:
        """Floor on which a measured force acts; 0 for other excitations."""
        return self.runs[0].floor

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return 1.0 / self.sampling_rate

    @property
    def seconds(self) -> float:
        """Length of all runs together."""
        return sum(len(run.measured) for run in self.runs) / self.sampling_rate

    def rms(self) -> Floats:
        """Compute the root mean square of each channel, shape (m,), m/s2."""
        square: Floats = np.nanmean(np.concatenate([run.measured for run in self.runs]) ** 2, axis=0)
        return np.sqrt(square)

    def replaced(self, **arrays: Iterable[Floats]) -> Recording:
        """Return the recording with other arrays in its runs; each field takes one array per run."""
        every = [dict(zip(arrays, values, strict=True)) for values in zip(*arrays.values(), strict=True)]
        runs = (dataclasses.replace(run, **each) for run, each in zip(self.runs, every, strict=True))
        return dataclasses.replace(self, runs=tuple(runs))

    def without_base_line(self) -> Recording:
        """Subtract the straight line from a measured base acceleration; raise InputError if no motion remains."""
        if self.input != "base":
            return self
        found = self.replaced(excitation=(run.excitation - trend(run.excitation) for run in self.runs))
        for run, whole in zip(found.runs, self.runs, strict=True):
            if np.abs(run.excitation).max() <= np.sqrt(ROUNDING) * np.abs(whole.excitation).max():
                raise InputError(f"{self.name}, {run.name}: the input channel shows no motion but a straight line")
        return found

    def without_lines(self, expected: Sequence[Floats]) -> Recording:
        """Subtract the straight line through each channel minus its expected accelerations, (samples, m) per run.

        The vibration itself has a line, too: the last, incomplete cycle has a nonzero mean. A line that a motion of the
        channel's period may leave by chance stays.
        """
        lines = (_certain_lines(run.measured - own) for run, own in zip(self.runs, expected, strict=True))
        return self.replaced(measured=(run.measured - line for run, line in zip(self.runs, lines, strict=True)))

    def band_limited(self) -> Recording:
        """Return the recording with an excitation that is band-limited between its samples, instead of linear."""
        return self.replaced(between=(band_limited(run.excitation) for run in self.runs))

    def only(self, channels: Bools) -> Recording:
        """Return the recording without the samples of the other channels; the mask has shape (m,)."""
        return self.replaced(measured=(np.where(channels, run.measured, np.nan) for run in self.runs))

    def cut(self, parts: Sequence[slice]) -> Recording:
        """Return the recording with one part of each run; `parts` has one slice per run."""
        pairs = list(zip(self.runs, parts, strict=True))
        return self.replaced(
            measured=(run.measured[part] for run, part in pairs),
            excitation=(run.excitation[part] for run, part in pairs),
            between=(run.drive[part, 0] for run, part in pairs),
        )


def _certain_lines(left: Floats) -> Floats:
    """Fit a straight line to each column, shape (samples, m); zeros where chance may leave this line.

    The variance of the mean is estimated from sums over blocks of `BLOCK_PERIODS` periods. A harmonic has the period
    2 pi (rms of the motion) / (rms of its derivative).
    """
    lines = trend(left)
    for column, values in enumerate((left - lines).T):
        level = rms(values)
        step = max(rms(np.diff(values)), level / len(values))
        width = max(1, round(BLOCK_PERIODS * 2 * np.pi * level / step)) if level else 1
        summed = np.add.reduceat(np.nan_to_num(values), np.arange(0, len(values), width))
        chance = float(np.linalg.norm(summed)) / max(int(np.isfinite(values).sum()), 1)
        lines[:, column] *= np.max(np.abs(lines[:, column])) > BY_CHANCE * chance
    return lines


def rms(values: Floats) -> float:
    """Return the root mean square of the finite values; 0 without such values."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else 0.0


def recording_of(source: RecordingSource, stories: int = 0) -> Recording:
    """Read a recording, and correct the certain faults of its sensors (`SensorRecord`).

    Parameters
    ----------
    source : str, Path, TimeRecord or DrivenRecord
        A file is a record file; cells of its floors' columns may be nan or empty.
    stories : int, optional
        Number of stories of the frame; by default, the highest floor with a sensor.

    Raises
    ------
    InputError
        If the file cannot be read, or no floor's acceleration was recorded.
    """
    match source:
        case DrivenRecord():
            return _of_motion(source, stories)
        case TimeRecord():
            _refuse_other_quantity(source.quantity, source.name)
            runs = [
                RecordedRun(run.responses, run.excitation, run.name, run.floor)
                for run in source.runs
                if run.excitation is not None
            ]
            return _recording(
                source.channels, source.sampling_rate, source.input, runs, stories, name=source.name
            )  # fmt: skip
        case str() | Path():
            return _of_file(Path(source), stories)
    raise InputError(
        f"a reconstruction needs a record file, a TimeRecord or a DrivenRecord, not {checks.shown(source)}"
    )


def _recording(
    channels: Sequence[Channel], rate: float, driven: str, runs: Sequence[RecordedRun], stories: int, **described: Any
) -> Recording:
    """Correct the sensors and combine the sensors of each floor; the runs have one column per channel."""
    if driven not in DRIVEN:
        raise InputError(
            f'{described["name"]} has input = "{driven}"; a reconstruction needs what drove the frame: a channel of '
            "the base motion on floor 0, or of a force"
        )
    if driven == "force" and len({run.floor for run in runs}) > 1:
        raise InputError(f"{described['name']}: the force acts on several floors; reconstruct these runs one by one")
    sensors = SensorRecord(tuple(channels), tuple(runs), rate, driven).set_right(stories)
    floors, right, firsts = sensors.by_floor()
    late = None if sensors.late is None else sensors.late[firsts]
    late_remarks = tuple(sensors.late_remarks[first] for first in firsts) if sensors.late_remarks else ()
    return _refuse_silent(Recording(
        right, rate, floors, driven, **described, remarks=sensors.remarks, late=late, late_remarks=late_remarks
    ))  # fmt: skip


def _refuse_silent(found: Recording) -> Recording:
    """Return a recording, or raise InputError if a floor shows no motion or a part of the excitation is missing."""
    together = np.concatenate([run.measured for run in found.runs])
    for column, floor in enumerate(found.floors):
        there = together[np.isfinite(together[:, column]), column]
        if not len(there) or not np.any(there != there[0]):
            raise InputError(f"{found.name}: the channel on floor {floor} shows no motion; leave it out")
    for run in found.runs:
        if missing := int((~np.isfinite(run.excitation)).sum()):
            raise InputError(
                f"{found.name}, {run.name}: {missing} samples of the excitation are missing; floors may have gaps, "
                "what drives the frame may not"
            )
    return found


def _of_motion(motion: DrivenRecord, stories: int) -> Recording:
    runs = []
    for drive in motion.runs:
        nothing = np.full((drive.samples, len(motion.floors)), np.nan)
        measured = nothing if drive.responses is None else drive.responses
        runs.append(RecordedRun(measured, drive.excitation, drive.name, drive.floor))
    channels = [Channel(f"floor {floor}", int(floor)) for floor in motion.floors]
    return _recording(
        channels, motion.sampling_rate, motion.input, runs, stories, added_mass=motion.added_mass, state=motion.state,
        name=motion.name,
    )  # fmt: skip


def _refuse_other_quantity(quantity: str, name: str) -> None:
    if quantity != "acceleration":
        raise InputError(f"{name}: the floors' {quantity}s were recorded; a reconstruction needs accelerations")


def _of_file(path: Path, stories: int) -> Recording:
    """Read the recording that a record file declares."""
    tables = RecordFile(path)
    with placed(path):
        checks.choice(tables.kind, ("time",), "record: kind, for a reconstruction,")
        for item in tables.responses:
            _refuse_other_quantity(item.quantity, f'channel "{item.name}"')
        # Clock jumps and declared ends split the file; gaps of a floor do not.
        pieces, rate = tables.pieces([])
        runs = []
        for piece in pieces:
            measured = [_with_gaps(piece.columns, item, path) for item in tables.responses]
            together = np.column_stack(measured) if measured else np.zeros((len(piece.columns.values), 0))
            if piece.excitation is not None:
                runs.append(RecordedRun(together, piece.excitation, piece.name, piece.floor))
        return _recording(
            tuple(tables.responses), rate, tables.input, runs, stories,
            added_mass=None if tables.added_mass is None else np.array(tables.added_mass), state=tables.state,
            name=tables.name,
        )  # fmt: skip


def _with_gaps(columns: Columns, item: ChannelDeclaration, path: Path) -> Floats:
    """Return the samples of a sensor in SI units; nan for missing samples."""
    columns.check(item.name, item.place or path.name)
    values = columns.values[:, columns.names.index(item.name)]
    if np.isinf(values).any() or np.any(np.abs(values[np.isfinite(values)]) > checks.LARGEST):
        values = columns.column(item.name, item.place or path.name)
    return item.factor * values


@dataclass(frozen=True, eq=False)
class SensorRecord:
    """Samples of every sensor, with gaps.

    Parameters
    ----------
    channels : tuple of Channel
    runs : tuple of RecordedRun
        One column of accelerations per channel.
    sampling_rate : float
        Hz.
    input : str
        "base" or "force".
    remarks : tuple of str, optional
        Sensor faults that were found.
    late : ndarray, shape (channels, 2), optional
        Delay (s) and its growth (s/s) that were removed from each channel.
    late_remarks : tuple of str, optional
        Remark on this delay, for each channel.
    """

    channels: tuple[Channel, ...]
    runs: tuple[RecordedRun, ...]
    sampling_rate: float
    input: str
    remarks: tuple[str, ...] = ()
    late: Floats | None = None
    late_remarks: tuple[str, ...] = ()

    def set_right(self, stories: int) -> SensorRecord:
        """Return the record without its certain faults; a remark reports each.

        Reversed channels are inverted, units converted and delays removed. Dead and stuck channels and spikes are
        left out. Uncertain faults are only reported.

        Raises
        ------
        InputError
            If every channel is dead, or two channels on one floor contradict each other.
        """
        order = np.argsort([each.floor for each in self.channels], kind="stable")
        whole = dataclasses.replace(
            self,
            channels=tuple(self.channels[column] for column in order),
            runs=tuple(dataclasses.replace(run, measured=run.measured[:, order]) for run in self.runs),
        )
        pieces = whole.pieces()
        if not any(np.any(np.ptp(np.nan_to_num(run.measured), axis=0) > 0) for run in whole.runs):
            return whole
        if not pieces:
            said = "signs and clocks of the sensors were not checked: no stretch in which all recorded is long enough"
            return dataclasses.replace(whole, remarks=(*self.remarks, said))
        return whole.corrected(whole._findings(pieces, stories), pieces)

    def pieces(self) -> list[tuple[int, slice]]:
        """List the segments that every sensor recorded, each with the index of its run."""
        found = []
        for place, run in enumerate(self.runs):
            there = np.isfinite(run.measured).all(axis=1) & np.isfinite(run.excitation)
            for piece in data_frames.sound_pieces(there):
                long = piece.stop - piece.start >= data_frames.FEWEST_SAMPLES
                if long and there[piece].all() and np.any(run.excitation[piece]):
                    found.append((place, piece))
        return found

    def _findings(self, pieces: Sequence[tuple[int, slice]], stories: int) -> list[Finding]:
        """Check the sensors with the methods of `cvxshear modes`."""
        runs = tuple(
            Run(
                self.runs[place].measured[piece],
                self.runs[place].excitation[piece],
                self.runs[place].floor,
                f"run {number}" if len(pieces) > 1 else "the record",
            )
            for number, (place, piece) in enumerate(pieces, 1)
        )
        most = max(stories, *(each.floor for each in self.channels))
        record = TimeRecord(self.channels, stories=most, runs=runs, sampling_rate=self.sampling_rate, input=self.input)
        try:
            findings = identify_modes(record).findings
        except (NoSolutionError, InputError):
            # A motion without identifiable modes, such as a short one, is checked without modes.
            findings = examination.examined(record).findings
        return [each for each in findings if each.kind in (*SAID, "spikes")]

    def corrected(self, findings: Sequence[Finding], pieces: Sequence[tuple[int, slice]]) -> SensorRecord:
        """Correct the certain faults."""
        factors, late, out = np.ones(len(self.channels) + 1), np.zeros((len(self.channels) + 1, 2)), set()
        measured, said = [run.measured.copy() for run in self.runs], list(self.remarks)
        of_clocks: dict[int, str] = {}
        channels = list(self.channels)
        for finding in findings:
            numbers, message = finding.numbers, finding.message
            columns = self._columns(numbers.get("channels", [numbers.get("channel")]))
            if finding.kind in ("dead channel", "stuck channel") or numbers.get("out"):
                out.update(columns)
            elif finding.kind == "spikes":
                for column, (place, piece) in itertools.product(columns, pieces):
                    spiked = examination.spikes_in(self.runs[place].measured[piece])[0][:, column]
                    measured[place][piece][spiked, column] = np.nan
            elif finding.kind in ("sign", "unit") and numbers["corrected"]:
                factors[columns] *= -1.0 if finding.kind == "sign" else numbers["factor"]
            elif finding.kind == "swapped channels" and numbers["corrected"]:
                for column, other in itertools.permutations(columns):
                    channels[column] = dataclasses.replace(self.channels[column], floor=self.channels[other].floor)
            elif finding.kind == "clock offset" and abs(numbers["seconds"]) * self.sampling_rate < LEAST_DELAY:
                continue
            elif finding.kind in ("clock offset", "clock drift") and numbers.get("corrected", True):
                late[columns] += numbers["seconds"], numbers.get("drift", 0.0)
                message = message if message.endswith("taken out") else f"{message}; taken out"
                of_clocks.update(dict.fromkeys(columns, message))
            if finding.kind != "spikes":
                said.append(message)
        kept = [column for column in range(len(self.channels)) if column not in out]
        # A delayed input is equivalent to sensors that are all early.
        late = late[:-1] - late[-1]
        started = 0
        for values in measured:
            for column in np.flatnonzero(late.any(axis=1)):
                values[:, column] = earlier(values[:, column], late[column], self.sampling_rate, started)
            started += len(values)
        right = self.replaced(((factors[:-1] * values)[:, kept] for values in measured), factors[-1])
        return dataclasses.replace(
            right,
            channels=tuple(channels[column] for column in kept),
            remarks=tuple(said),
            late=late[kept],
            late_remarks=tuple(of_clocks.get(column, of_clocks.get(-1, "")) for column in kept),
        )

    def _columns(self, names: Sequence[str | None]) -> list[int]:
        """List the columns of the named channels; "a + b" names several sensors of a floor, and -1 is the input."""
        single = {part for name in names if name is not None for part in (name, *name.split(" + "))}
        found = [column for column, channel in enumerate(self.channels) if channel.name in single]
        return [*found, -1] if "input" in single and not found else found

    def by_floor(self) -> tuple[Ints, tuple[RecordedRun, ...], list[int]]:
        """Return the floors (ascending), runs with one column per floor, and the first channel of each floor.

        A motion is nan if a sample of one of its sensors is missing. Sensors across the direction of the test are left
        out. Several sensors on a floor give the motion of the floor's center.
        """
        cosines = np.cos(np.radians([each.direction or 0.0 for each in self.channels]))
        along = np.abs(cosines) >= np.cos(np.radians(examination.ACROSS))
        floors = np.array([each.floor for each in self.channels], dtype=np.int64)
        named = np.unique(floors[along])
        if not named.size:
            raise InputError("no floor's acceleration was recorded; a reconstruction needs one at least")
        groups = [np.flatnonzero(along & (floors == floor)) for floor in named]
        weights = [examination.center_weights(self.channels, group)[0] / cosines[group] for group in groups]
        motions = (
            np.column_stack([run.measured[:, group] @ own for group, own in zip(groups, weights, strict=True)])
            for run in self.runs
        )
        return named, self.replaced(motions).runs, [int(group[0]) for group in groups]

    def replaced(self, measured: Iterable[Floats], factor: float = 1.0) -> SensorRecord:
        """Return the record with other accelerations, one array per run, and a factor on the excitation."""
        pairs = zip(self.runs, measured, strict=True)
        return dataclasses.replace(self, runs=tuple(
            dataclasses.replace(run, measured=values, excitation=factor * run.excitation) for run, values in pairs
        ))  # fmt: skip


def earlier(values: Floats, late: Floats, rate: float, started: int) -> Floats:
    """Remove a channel's delay (s) and its growth (s/s); the run begins `started` samples after the first run's start.

    The result is nan if a sample that the interpolation needs is missing.
    """
    index, there = np.arange(len(values)), np.isfinite(values)
    if not there.any():
        return values
    places = index + rate * late[0] + late[1] * (started + index)
    unknown = ndimage.maximum_filter1d((~there).astype(np.uint8), prepare.SINC_TERMS + 1, mode="constant", cval=1)
    near = np.clip(np.round(places).astype(np.int64), 0, len(values) - 1)
    result = prepare.between(np.interp(index, index[there], values[there]), places)
    return np.where(unknown[near].astype(bool), np.nan, result)
