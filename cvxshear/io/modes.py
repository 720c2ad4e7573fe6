"""Record files: what they declare of a record and the frame, and the modes of one or several as one measurement.

A record file is a small TOML text that assigns columns of files to floors and declares the excitation. Its tables are
`[record]` (kind, input, file, sampling rate, ...), one `[[channel]]` for each column used (column, floor, axis, sign,
calibration) and, where there are several files, one `[[run]]` for each; docs/modal.md has them all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.io import record_tables
from cvxshear.io.csv import Columns
from cvxshear.io.formats import LIMIT, MEGABYTE, named_after, read_columns
from cvxshear.io.record_tables import ChannelDeclaration
from cvxshear.io.toml import files_of, is_record_file, load, write_measurement
from cvxshear.measurement.experiment import MOST_STORIES, Experiment
from cvxshear.records.identify import identify_modes
from cvxshear.records.motion import DrivenRecord, DrivenRun, differentiated
from cvxshear.records.record import INPUTS, Finding, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.records.result import IdentifiedRecord, ModalResult, merged, scale_unknown
from cvxshear.util import checks, parallel
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError
from cvxshear.util.typing import Floats, Json
from cvxshear.util.writing import check_output

UNKNOWN_SCALE = (
    "nothing tells how heavy the frame is: total_mass = 1 is written in its place, and masses and stiffnesses come out "
    "per kilogram of the frame; give [frame] total_mass in a record file"
)


def identify_modes_many(
    files: Iterable[str | Path],
    *,
    each_run: bool = False,
    jobs: int = 1,
    progress: parallel.Progress | None = None,
    **options: Any,
) -> list[IdentifiedRecord | CvxshearError]:
    """Run `identify_modes` for many record files; the result of a failed file is its error.

    Parameters
    ----------
    files : iterable of str or Path
        Record files (TOML).
    each_run : bool, optional
        Identify each run by itself, such as each of several earthquakes.
    jobs : int, optional
        Processes; -1 takes every core. Inside `with joblib.parallel_config(backend="dask")` they run on that cluster.
        Its workers must be able to read the files.
    progress : callable, optional
        Called with the number of records done and to do.
    **options
        As for `identify_modes`; `pick` takes precedence over the list in a record file.

    Returns
    -------
    list of IdentifiedRecord or CvxshearError
        In the order of the files; an error's message begins with its file.

    Raises
    ------
    TypeError
        If an option is not one of `identify_modes`.
    """
    records: list[tuple[str, int | None]] = [(str(file), None) for file in files]
    if each_run:
        records = [(file, place) for file, _ in records for place in range(len(read_record(file).record.runs))]
    return parallel.each(partial(_tested, options=options), records, jobs=jobs, progress=progress)


def modes_from_file(path: str | Path, *, output: str | Path | None = None, **options: Any) -> tuple[ModalResult, Json]:
    """Identify the modes of a record file, and write the measurement file if `output` is given.

    Parameters
    ----------
    path : str or Path
        The record file (TOML).
    output : str or Path, optional
        File for the measurement file, `.toml`.
    **options
        As for `identify_modes`; `pick` takes precedence over the list in the record file.

    Returns
    -------
    result : ModalResult
    declared : dict
        Of the measurement file's shape, for `Experiment.from_dict`.

    Raises
    ------
    InputError
        The record file or a file that it names is wrong, or a file to write would replace one of them. No file is
        written then.
    NoSolutionError
        If no mode was found.
    """
    if output is not None:
        check_output(output, endings=(".toml",), keep=files_of(path))
    test = _tested((str(path), None), options=options)
    if isinstance(test, CvxshearError):
        raise test
    if scale_unknown([test]) and not any(finding.kind == "scale" for finding in test.modes.findings):
        scale = Finding("scale", UNKNOWN_SCALE, {"total_mass": 1.0})
        modes = dataclasses.replace(test.modes, findings=(*test.modes.findings, scale))
        test = dataclasses.replace(test, modes=modes)
    declared = merged([test])
    if output is not None:
        write_merged(output, [test])
    return test.modes, declared


def experiment_from_file(path: str | Path) -> Experiment:
    """Read a measurement file, or identify the modes of a record file.

    Parameters
    ----------
    path : str or Path
        Or the name of a built-in example.

    Raises
    ------
    InputError
        If a file cannot be read or is wrong.
    NoSolutionError
        If no mode was found in a record.
    """
    if not is_record_file(path):
        return load(path)
    return Experiment.from_dict(modes_from_file(path)[1], name=named_after(path))


def write_merged(path: str | Path, tests: Sequence[IdentifiedRecord]) -> None:
    """Write the measurement file of several records, with their findings as comments at its head.

    Parameters
    ----------
    path : str or Path
    tests : sequence of IdentifiedRecord

    Raises
    ------
    InputError
        Two records contradict each other, or `cvxshear.load` would refuse the file. No file is written then.
    """
    declared = merged(tests)
    Experiment.from_dict(declared, name=Path(path).stem)
    said = any(finding.kind == "scale" for test in tests for finding in test.modes.findings)
    comments = [f"scale: {UNKNOWN_SCALE}"] if scale_unknown(tests) and not said else []
    for test in tests:
        modes = test.modes
        comments.append(f"Modes of {modes.name} by {modes.method}; standard deviations: {modes.uncertainty}")
        comments.extend(f"{modes.name}: {finding.kind}: {finding.message}" for finding in modes.findings)
    write_measurement(path, declared, comments)


def _tested(item: tuple[str, int | None], *, options: Mapping[str, Any]) -> IdentifiedRecord | CvxshearError:
    file, place = item
    try:
        source = read_record(file)
        record, picked = source.record, options.get("pick")
        if place is not None:
            run: Any = record.runs[place]
            changes: dict[str, Any] = {"runs": (run,), "name": run.name}
            record, file = dataclasses.replace(record, **changes), f"{file}, {run.name}"
        modes = identify_modes(record, **{**options, "pick": source.pick if picked is None else picked})
        if source.notes:
            modes = dataclasses.replace(modes, findings=(*source.notes, *modes.findings))
    except CvxshearError as error:
        if isinstance(error, NoSolutionError):
            return NoSolutionError(error.backend, f"{file}: {error.reason}")
        return error if str(error).startswith(file) else type(error)(f"{file}: {error}")
    return IdentifiedRecord(file, modes, source.frame, source.priors, source.added_mass, source.state)


RECORD_KEYS = (
    "name", "kind", "input", "input_floor", "file", "sampling_rate", "time", "time_unit", "frequency", "axis",
    "stories", "quantity", "band", "exponential_window", "truncated", "pick", "size_limit",
)  # fmt: skip

FREQUENCY_NAMES = ("frequency", "frequency_hz", "freq", "f", "f_hz", "Frequency", "hz")


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A record, and the declarations of its file about the frame.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    frame : dict
        The table `[frame]`, for the measurement file.
    priors : list of dict
        The tables `[[prior]]`, for the measurement file.
    added_mass : list of float, optional
        kg on each floor during the record.
    state : str, optional
        The state of the frame that was tested; records of one state share it.
    pick : list of float, optional
        Hz; frequencies of the modes, chosen by hand.
    files : tuple of Path
        The record file and those it names.
    notes : tuple of Finding
        Samples that were left out.
    """

    record: Record
    frame: Mapping[str, object] = field(default_factory=dict)
    priors: Sequence[Mapping[str, object]] = ()
    added_mass: Sequence[float] | None = None
    state: str | None = None
    pick: Sequence[float] | None = None
    files: tuple[Path, ...] = ()
    notes: tuple[Finding, ...] = ()


def read_record(path: str | Path) -> RecordFile:
    """Read a record file and the files it names.

    Parameters
    ----------
    path : str or Path
        Of the TOML text; the files it names are looked for beside it.

    Returns
    -------
    RecordFile

    Raises
    ------
    InputError
        The message names the file, the key or the channel with its line, and the expected input.
    """
    path = Path(path)
    tables = RecordTables(path)
    frame, priors = tables.table.get("frame", {}), tables.table.get("prior", [])
    in_tables = isinstance(priors, list) and all(isinstance(prior, Mapping) for prior in priors)
    if not isinstance(frame, Mapping) or not in_tables:
        raise InputError(f"{path}: frame must be a table [frame], prior a list of tables [[prior]]")
    notes: list[Finding] = []
    with record_tables.placed(path):
        record = _frf_record(tables) if tables.kind == "frf" else _time_record(tables, notes)
    files = (path, *(path.parent / run["file"] for run in tables.runs))
    picked = tables.declared.get("pick")
    if picked is not None:
        picked = checks.vector(picked, f"{path}: record: pick", above=0.0).tolist()
    return RecordFile(record, frame, priors, tables.added_mass, tables.state, picked, files, tuple(notes))


class RecordTables:
    """Declarations of a record file; each key is checked separately.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    table, declared : dict
        The whole file, and its table `[record]`.
    kind : str
        "time" or "frf".
    input : str
        One of `INPUTS`.
    channels : list of ChannelDeclaration
    runs : list of dict
    name : str
    turns : bool
        Whether the floors turn (frame: motions).
    added_mass : list of float or None
        kg.
    state : str or None

    Raises
    ------
    InputError
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.table, lines = record_tables.tables_of(path)
        with record_tables.placed(path):
            self.declared = declared = checks.keys(self.table["record"], RECORD_KEYS, [], "record")
            self.kind = checks.choice(declared.get("kind", "time"), ("time", "frf"), "record: kind")
            for key in ("time", "frequency", "axis"):
                if key in declared:
                    checks.text(declared[key], f"record: {key}")
            frame = self.table.get("frame")
            self.turns = isinstance(frame, Mapping) and frame.get("motions", ["x"]) != ["x"]
            if self.turns and self.kind == "frf":
                raise InputError("frame: motions: functions of floors that turn are not read; give time histories")
            self.channels = record_tables.channels_of(self.table["channel"], declared, path, lines, self.turns)
            self.input = checks.choice(declared.get("input", "none"), INPUTS, "record: input")
            self.name = checks.text(declared.get("name", named_after(path)), "record: name")
            self.runs = record_tables.runs_of(self.table, declared)
            state = self.table.get("state")
            self.state = None if state is None else checks.text(state, "state")
        added = self.table.get("added_mass")
        self.added_mass = None if added is None else checks.vector(added, f"{path}: added_mass", least=0.0).tolist()

    @property
    def driver(self) -> ChannelDeclaration | None:
        """The channel of the excitation."""
        return record_tables.driver_of(self.channels, self.input)

    @property
    def responses(self) -> list[ChannelDeclaration]:
        """The channels on floors."""
        driver = self.driver
        return [item for item in self.channels if item is not driver and item.responds]

    def columns(self, run: Mapping[str, Any]) -> Columns:
        """Read the columns of a run's file."""
        limit = self.declared.get("size_limit", LIMIT / MEGABYTE)
        found: Columns = read_columns(
            self.path.parent / run["file"], MEGABYTE * checks.number(limit, "record: size_limit (MB)", above=0.0)
        )
        return found

    def floor(self, place: int, otherwise: int | None = None) -> int:
        """Find the floor of the force of a run; runs are counted from 1."""
        floor = self.runs[place - 1].get("input_floor", self.declared.get("input_floor", otherwise))
        if floor is None:
            raise InputError(f"run {place}: the key 'input_floor' is missing: which floor does the force act on?")
        return checks.whole(floor, f"run {place}: input_floor", least=1, most=MOST_STORIES)

    def pieces(self, needed: Sequence[ChannelDeclaration]) -> tuple[list[Piece], float]:
        """Read every uninterrupted stretch of every run, and the sampling rate, Hz.

        Parameters
        ----------
        needed : sequence of ChannelDeclaration
            Whose columns must hold numbers throughout.

        Raises
        ------
        InputError
            If a file cannot be read, or two were sampled at different rates.
        """
        driver, found, rates = self.driver, [], []
        for place, run, star, columns in self._parts(needed):
            name = " ".join(filter(None, (str(run.get("name", Path(run["file"]).name)), star)))
            floor = 0 if driver is None or self.input != "force" else self.floor(place, driver.floor or None)
            stretches, rate, left_out = record_tables.pieces_of(columns, needed, self.declared, run, self.path)
            rates.append((rate, columns.source))
            if abs(rate - rates[0][0]) > 1e-3 * rates[0][0]:
                raise InputError(
                    f"{columns.source} is sampled at {rate:.6g} Hz, {rates[0][1]} at {rates[0][0]:.6g} Hz: two "
                    "sampling rates in one record; resample one of them"
                )
            for number, rows in enumerate(stretches, 1):
                part = columns.rows(rows)
                excitation, noise_from = None, None
                if driver is not None:
                    excitation = driver.factor * part.column(driver.name, driver.place or self.path.name)
                    if driver.quantity in ("velocity", "displacement"):
                        excitation, noise_from = differentiated(excitation, rate, driver.quantity)
                called = name if len(stretches) == 1 else f"{name}, piece {number}"
                whole = rows == slice(0, len(columns.values))
                clock = None if whole else record_tables.since_first(columns, self.declared)
                span = (None, None) if clock is None else (round(clock[rows.start], 9), round(clock[rows.stop - 1], 9))
                said = left_out if number == 1 else ""
                found.append(Piece(name, called, part, excitation, floor, span, said, noise_from))
        return found, rates[0][0]

    def _parts(self, needed: Sequence[ChannelDeclaration]) -> Iterator[tuple[int, Mapping[str, Any], str, Columns]]:
        """Read the file of every run; a `*` in the columns' names makes a run of each name that it can stand for."""
        names = [name for name in (*(item.name for item in needed), self.declared.get("time", "")) if "*" in name]
        for place, run in enumerate(self.runs, 1):
            columns = self.columns(run)
            if not names:
                yield place, run, "", columns
                continue
            # scipy.io loads slowly.
            arrays = import_module("cvxshear.io.arrays")
            for star, part in arrays.parts_of(columns, names):
                yield place, run, star, part


@dataclass(frozen=True, eq=False)
class Piece:
    """An uninterrupted stretch of a run.

    Parameters
    ----------
    run, name : str
        Names of the run, and of the piece where it has several.
    columns : Columns
    excitation : ndarray, shape (samples,), or None
        m/s2 or N.
    floor : int
        Floor of the force; 0 without a force.
    span : tuple of (float or None, float or None)
        Start and end in its file, s; None where the piece is all of it.
    left_out : str
        What of the run is in no piece, said by its first one.
    noise_from : float, optional
        Where the excitation was differentiated: the frequency above which it is noise, Hz.
    """

    run: str
    name: str
    columns: Columns
    excitation: Floats | None
    floor: int
    span: tuple[float | None, float | None]
    left_out: str
    noise_from: float | None = None


def _common(tables: RecordTables) -> dict[str, Any]:
    """Return the arguments of both kinds of records."""
    declared = tables.declared
    return {
        "stories": checks.whole(declared.get("stories", 0), "record: stories", least=0, most=MOST_STORIES),
        "quantity": declared.get("quantity", "acceleration"),
        "band": declared.get("band"),
        "exponential_window": declared.get("exponential_window"),
        "name": tables.name,
        "turns": tables.turns,
    }


def _time_record(tables: RecordTables, notes: list[Finding]) -> TimeRecord:
    driver, responses = tables.driver, tables.responses
    quantities = {item.quantity for item in responses}
    if len(quantities) > 1:
        raise InputError(f"the responses are {' and '.join(sorted(quantities))}; a record holds one quantity")
    pieces, rate = tables.pieces([*responses, *([] if driver is None else [driver])])
    for piece in pieces:
        if piece.left_out:
            count = sum(each.run == piece.run for each in pieces)
            notes.append(Finding("pieces", f"{piece.run}: {piece.left_out}", {"pieces": count}))
    noise_from = min((piece.noise_from for piece in pieces if piece.noise_from is not None), default=None)
    if noise_from is not None and driver is not None:
        said = f"the ground was recorded as a {driver.quantity} and is differentiated up to {noise_from:.3g} Hz"
        numbers = {"channel": driver.name, "quantity": driver.quantity, "noise_from": noise_from}
        notes.append(Finding("ground", f"{said}, where it is above its noise; higher modes are not excited", numbers))
    if not responses:
        raise InputError("no channel is on a floor above the ground")
    runs = []
    for each in pieces:
        table = [item.factor * each.columns.column(item.name, item.place or tables.path.name) for item in responses]
        runs.append(Run(np.column_stack(table), each.excitation, each.floor, each.name, *each.span))
    common = {**_common(tables), **({"quantity": quantities.pop()} if quantities else {})}
    return TimeRecord(tuple(responses), **common, runs=tuple(runs), sampling_rate=rate, input=tables.input)


def _frf_record(tables: RecordTables) -> FrfRecord:
    declared, channels = tables.declared, tables.channels
    if declared.get("input", "force") != "force":
        raise InputError('record: frequency response functions have input = "force"')
    made, axes = [], []
    for place, run in enumerate(tables.runs, 1):
        columns = tables.columns(run)
        name = declared.get("frequency") or next((item for item in FREQUENCY_NAMES if item in columns.names), None)
        if name is None:
            raise InputError(f"record: give frequency, the name of the frequency column of {columns.source}")
        axes.append((columns.column(name, "record: frequency"), columns.source))
        floor = tables.floor(place)
        responses = np.column_stack([_complex(columns, item, tables.path) for item in channels])
        made.append(FrfRun(responses, floor, run.get("name", Path(run["file"]).name)))
    for axis, source in axes[1:]:
        if axis.shape != axes[0][0].shape or not np.allclose(axis, axes[0][0], rtol=1e-6):
            raise InputError(f"{source} and {axes[0][1]} have different frequency lines; a record has one axis")
    return FrfRecord(
        tuple(channels), **_common(tables), runs=tuple(made), frequencies=axes[0][0],
        truncated=declared.get("truncated", True),
    )  # fmt: skip


def _complex(columns: Columns, item: ChannelDeclaration, path: Path) -> Any:
    asked = item.place or path.name
    real, imaginary = f"{item.name}_re", f"{item.name}_im"
    return item.factor * (columns.column(real, asked) + 1j * columns.column(imaginary, asked))


def read_motion(path: str | Path) -> DrivenRecord:
    """Read the excitation from a record file, and the accelerations of its floors if it has such channels.

    Parameters
    ----------
    path : str or Path
        As for `read_record`; here a channel of the ground, or of the force, is enough.

    Returns
    -------
    DrivenRecord

    Raises
    ------
    InputError
        The same errors as in `read_record`, and a record without an excitation.
    """
    tables = RecordTables(Path(path))
    with record_tables.placed(tables.path):
        driver = tables.driver if tables.kind == "time" else None
        if driver is not None and not tables.responses:
            pieces, rate = tables.pieces([driver])
            added = None if tables.added_mass is None else np.array(tables.added_mass)
            runs = []
            for _, stretches in groupby(pieces, key=lambda each: each.run):
                longest = max(stretches, key=lambda each: len(each.columns.values))
                assert longest.excitation is not None
                runs.append(DrivenRun(longest.excitation, longest.floor, name=longest.run))
            return DrivenRecord(tuple(runs), rate, tables.input, added_mass=added, name=tables.name, state=tables.state)
    found = read_record(path)
    return DrivenRecord.of(found.record, found.added_mass, found.state)
