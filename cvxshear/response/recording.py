"""Accelerations that sensors on some floors recorded, with gaps, and the excitation.

Sensor faults that the record itself shows are corrected first. The checks are the same as in `cvxshear modes`. They use
the segments that every sensor recorded. Corrections of certain faults apply to the whole record, including the parts
with gaps.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear.io.csv import Columns
from cvxshear.io.record_tables import ChannelDeclaration, RecordFile
from cvxshear.records import data_frames, examination, prepare
from cvxshear.records.identify import identify_modes
from cvxshear.records.motion import DrivenRecord, DrivenRun, of_channels, trend
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.response.state_space import ROUNDING
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.quantities import NORMAL_95
from cvxshear.util.typing import Bools, Floats

RecordSource = str | Path | TimeRecord | DrivenRecord

#: Kinds of findings that concern the sensors. The smoother handles spikes and straight lines by its weights.
SAID = (
    "dead channel", "stuck channel", "clipped channel", "direction", "sign", "unit",
    "swapped channels", "clock offset", "clock drift", "lost samples", "low-pass", "resonance", "gain step",
)  # fmt: skip


def recording_of(source: RecordSource, stories: int = 0) -> DrivenRecord:
    """Read a record, correct the certain faults of its sensors, and combine the sensors of each floor.

    Reversed channels are inverted, units converted and delays removed. Dead and stuck channels and spikes are left out.
    Uncertain faults are only reported.

    Parameters
    ----------
    source : str, Path, TimeRecord or DrivenRecord
        A file is a record file; cells of its floors' columns may be nan or empty. Responses other than accelerations
        are left out.
    stories : int, optional
        Number of stories of the frame; by default, the highest floor with a sensor.

    Raises
    ------
    InputError
        If the file cannot be read, the record does not tell what drove the frame, a channel shows no motion, or two
        channels on one floor contradict each other.
    """
    match source:
        case DrivenRecord():
            channels = [Channel(f"floor {floor}", int(floor)) for floor in source.floors]
            record = source.replaced(
                responses=(
                    np.full((run.samples, len(channels)), np.nan) if run.responses is None else run.responses
                    for run in source.runs
                )
            )
        case TimeRecord():
            record = of_channels(source)
            channels = list(source.channels) if record.floors.size else []
        case str() | Path():
            channels, record = _of_file(Path(source))
        case _:
            raise InputError(
                f"what drives a frame is a record file, a TimeRecord or a DrivenRecord, not {checks.shown(source)}"
            )
    for run in record.runs:
        if not np.any(run.excitation):
            raise InputError(f"{run.name}: the input channel is zero throughout")
    found = _a_column_a_floor(*_set_right(channels, record, stories))
    for column, floor in enumerate(found.floors):
        values = np.concatenate([run.measured[:, column] for run in found.runs])
        there = values[np.isfinite(values)]
        if not len(there) or not np.any(there != there[0]):
            raise InputError(f"{found.name}: the channel on floor {floor} shows no motion; leave it out")
    return found


def _of_file(path: Path) -> tuple[list[Channel], DrivenRecord]:
    """Read the motion that a record file declares, with one column for each channel."""
    tables = RecordFile(path)
    with checks.named(str(path)):
        checks.choice(tables.kind, ("time",), "record: kind, for a motion over time,")
        responses = [item for item in tables.responses if item.quantity == "acceleration"]
        # Clock jumps, declared ends and gaps of the excitation split the file; gaps of a floor do not.
        pieces, rate = tables.pieces([] if tables.driver is None else [tables.driver])
        runs = tuple(
            DrivenRun(
                piece.excitation,
                piece.floor,
                np.column_stack([_with_gaps(piece.columns, item) for item in responses]) if responses else None,
                piece.name,
            )
            for piece in pieces
            if piece.excitation is not None
        )
        floors = np.array([item.floor for item in responses], dtype=np.int64)
        added = None if tables.added_mass is None else np.array(tables.added_mass)
        said = tuple(f"{piece.run}: {piece.left_out}" for piece in pieces if piece.left_out)
        return [*responses], DrivenRecord(runs, rate, tables.input, floors, added, tables.name, tables.state, said)


def _with_gaps(columns: Columns, item: ChannelDeclaration) -> Floats:
    """Return the samples of a sensor in SI units; nan for missing samples."""
    columns.check(item.name, item.place)
    values = columns.values[:, columns.names.index(item.name)]
    if np.isinf(values).any() or np.any(np.abs(values[np.isfinite(values)]) > checks.LARGEST):
        return item.read(columns)
    return item.factor * values


def _set_right(
    channels: Sequence[Channel], record: DrivenRecord, stories: int
) -> tuple[Sequence[Channel], DrivenRecord]:
    """Return the channels and the record without its certain faults; a remark reports each."""
    if not any(np.any(np.ptp(np.nan_to_num(run.measured), axis=0) > 0) for run in record.runs):
        return channels, record
    pieces = whole_pieces(record)
    if not pieces:
        said = "signs and clocks of the sensors were not checked: no stretch in which all recorded is long enough"
        return channels, dataclasses.replace(record, remarks=(*record.remarks, said))
    runs = tuple(
        Run(
            record.runs[place].measured[piece],
            record.runs[place].excitation[piece],
            record.runs[place].floor,
            f"run {number}" if len(pieces) > 1 else "the record",
        )
        for number, (place, piece) in enumerate(pieces, 1)
    )
    most = max(stories, *record.floors.tolist())
    shown = TimeRecord(tuple(channels), stories=most, runs=runs, sampling_rate=record.sampling_rate, input=record.input)
    try:
        findings = identify_modes(shown).findings
    except (NoSolutionError, InputError):
        # A motion without identifiable modes, such as a short one, is checked without modes.
        findings = examination.examined(shown).findings
    return corrected(channels, record, [each for each in findings if each.kind in (*SAID, "spikes")], pieces)


def whole_pieces(record: DrivenRecord) -> list[tuple[int, slice]]:
    """List the segments that every sensor recorded while the frame was driven, each with the index of its run."""
    found = []
    for place, run in enumerate(record.runs):
        there = np.asarray(np.isfinite(run.measured).all(axis=1), dtype=np.bool_)
        for piece in data_frames.sound_pieces(there):
            long = piece.stop - piece.start >= data_frames.FEWEST_SAMPLES
            if long and there[piece].all() and np.any(run.excitation[piece]):
                found.append((place, piece))
    return found


def corrected(
    channels: Sequence[Channel], record: DrivenRecord, findings: Sequence[Finding], pieces: Sequence[tuple[int, slice]]
) -> tuple[Sequence[Channel], DrivenRecord]:
    """Correct the certain faults among the findings; the pieces are those that were checked."""
    factors, late, out = np.ones(len(channels) + 1), np.zeros((len(channels) + 1, 2)), set()
    measured, said, floors = [run.measured.copy() for run in record.runs], list(record.remarks), record.floors.copy()
    for finding in findings:
        numbers, message = finding.numbers, finding.message
        columns = _columns(channels, numbers.get("channels", [numbers.get("channel")]))
        if finding.kind in ("dead channel", "stuck channel") or numbers.get("out"):
            out.update(columns)
        elif finding.kind == "spikes":
            for column, (place, piece) in itertools.product(columns, pieces):
                spiked = examination.spikes_in(record.runs[place].measured[piece])[0][:, column]
                measured[place][piece][spiked, column] = np.nan
        elif finding.kind in ("sign", "unit") and numbers["corrected"]:
            factors[columns] *= -1.0 if finding.kind == "sign" else numbers["factor"]
        elif finding.kind == "swapped channels" and numbers["corrected"]:
            floors[columns] = np.unique(record.floors[columns]).sum() - record.floors[columns]
        elif finding.kind == "clock offset" and abs(numbers["seconds"]) * record.sampling_rate < NORMAL_95:
            # A damper turns the phases of the modes, too. The fit of the frame weighs both; its delays have a standard
            # deviation of one sample.
            continue
        elif finding.kind in ("clock offset", "clock drift") and numbers.get("corrected", True):
            late[columns] += numbers["seconds"], numbers.get("drift", 0.0)
            message = message if message.endswith("taken out") else f"{message}; taken out"
        if finding.kind != "spikes":
            said.append(message)
    kept = [column for column in range(len(channels)) if column not in out]
    # A delayed input is equivalent to sensors that are all early.
    right = on_time(record.replaced(responses=measured), late[:-1] - late[-1])
    right = right.replaced(
        floors[kept],
        responses=((factors[:-1] * run.measured)[:, kept] for run in right.runs),
        excitation=(factors[-1] * run.excitation for run in right.runs),
    )
    return [channels[column] for column in kept], dataclasses.replace(right, remarks=tuple(said))


def _columns(channels: Sequence[Channel], names: Sequence[str | None]) -> list[int]:
    """List the columns of the named channels; "a + b" names several sensors of a floor, and -1 is the input."""
    single = {part for name in names if name is not None for part in (name, *name.split(" + "))}
    found = [column for column, channel in enumerate(channels) if channel.name in single]
    return [*found, -1] if "input" in single and not found else found


def _a_column_a_floor(channels: Sequence[Channel], record: DrivenRecord) -> DrivenRecord:
    """Return the record with one column for each floor, ascending.

    A motion is nan if a sample of one of its sensors is missing. Sensors across the direction of the test are left out.
    Several sensors on a floor give the motion of the floor's center.
    """
    cosines = np.cos(np.radians([each.direction or 0.0 for each in channels]))
    along = np.abs(cosines) >= np.cos(np.radians(examination.ACROSS))
    floors = np.unique(record.floors[along])
    groups = [np.flatnonzero(along & (record.floors == floor)) for floor in floors]
    weights = [examination.center_weights(channels, group)[0] / cosines[group] for group in groups]

    def motion(run: DrivenRun) -> Floats:
        own = (run.measured[:, group] @ weight for group, weight in zip(groups, weights, strict=True))
        return np.column_stack([np.zeros((run.samples, 0)), *own])

    return record.replaced(floors, responses=map(motion, record.runs))


def on_time(record: DrivenRecord, late: Floats) -> DrivenRecord:
    """Remove the delay (s) of each channel and its growth (s/s), shape (channels, 2), over all runs in their order."""
    measured, started = [], 0
    for run in record.runs:
        measured.append(prepare.on_time(run.measured, late, record.sampling_rate, started))
        started += run.samples
    return record.replaced(responses=measured)


def without_base_line(record: DrivenRecord) -> DrivenRecord:
    """Subtract the straight line from a measured base acceleration; raise InputError if no motion remains."""
    if record.input != "base":
        return record
    found = record.replaced(excitation=(run.excitation - trend(run.excitation) for run in record.runs))
    for run, whole in zip(found.runs, record.runs, strict=True):
        if np.abs(run.excitation).max() <= np.sqrt(ROUNDING) * np.abs(whole.excitation).max():
            raise InputError(f"{record.name}, {run.name}: the input channel shows no motion but a straight line")
    return found


def without_lines(record: DrivenRecord, expected: Sequence[Floats]) -> DrivenRecord:
    """Subtract the straight line through each channel minus its expected accelerations, (samples, m) per run.

    The vibration itself has a line, too: the last, incomplete cycle has a nonzero mean.
    """
    pairs = zip(record.runs, expected, strict=True)
    return record.replaced(responses=(run.measured - trend(run.measured - own) for run, own in pairs))


def rms(values: Floats) -> float:
    """Return the root mean square of the finite values; 0 without such values."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else 0.0


#: A part of a run, and the mask of the m sensors that recorded in it, shape (m,).
Piece = tuple[slice, Bools]


def parted(run: DrivenRun, least: int) -> list[Piece]:
    """Split a run at gaps of `least` samples or more; return the parts and their recording channels."""
    recorded = np.ones(run.measured.shape, dtype=bool)
    for column, there in enumerate(np.isfinite(run.measured).T):
        for first, last in data_frames.stretches(~there).tolist():
            recorded[first:last, column] = last - first < least
    edges = [0, *(np.flatnonzero(np.any(np.diff(recorded, axis=0), axis=1)) + 1).tolist(), len(recorded)]
    return [(slice(first, last), recorded[first]) for first, last in itertools.pairwise(edges)]


def cut(record: DrivenRecord, channels: Bools, parts: Sequence[slice]) -> DrivenRecord:
    """Return one part of each run, one slice per run, without the samples of the other channels."""
    pairs = list(zip(record.runs, parts, strict=True))
    return record.replaced(
        responses=(np.where(channels, run.measured, np.nan)[part] for run, part in pairs),
        excitation=(run.excitation[part] for run, part in pairs),
        between=(run.drive[part, 0] for run, part in pairs),
    )
