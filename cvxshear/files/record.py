"""The record file: a small TOML text that says which column of which file is which floor, and what drove it.

Its tables are `[record]` (kind, input, file, sampling rate, ...), one `[[channel]]` for each column used
(column, floor, axis, sign, calibration) and, where there are several files, one `[[run]]` for each; docs/modal.md
has them all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.files.columns import LIMIT, Columns, sampling_rate_of
from cvxshear.files.csv import read_csv
from cvxshear.files.mat import read_mat
from cvxshear.files.reading import MEGABYTE, named_after
from cvxshear.files.record_tables import (
    ChannelDeclaration,
    added_mass_of,
    channels_of,
    driver_of,
    placed,
    runs_of,
    tables_of,
)
from cvxshear.files.uff import read_uff
from cvxshear.measurement.experiment import MOST_STORIES
from cvxshear.records.record import INPUTS, Channel, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

RECORD_KEYS = (
    "name",
    "kind",
    "input",
    "input_floor",
    "file",
    "sampling_rate",
    "time",
    "frequency",
    "axis",
    "stories",
    "quantity",
    "band",
    "exponential_window",
    "truncated",
    "pick",
    "size_limit",
)
TIME_NAMES = ("time", "time_s", "t", "t_s", "Time", "TIME", "seconds")
FREQUENCY_NAMES = ("frequency", "frequency_hz", "freq", "f", "f_hz", "Frequency", "hz")


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A record, and what its file says of the frame besides.

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
    """

    record: Record
    frame: Mapping[str, object] = field(default_factory=dict)
    priors: Sequence[Mapping[str, object]] = ()
    added_mass: Sequence[float] | None = None
    state: str | None = None
    pick: Sequence[float] | None = None
    files: tuple[Path, ...] = ()


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
        Naming the file, and the key or the channel and the line, and what would be right.
    """
    path = Path(path)
    table, lines = tables_of(path)
    where = str(path)
    frame = table.get("frame", {})
    priors = table.get("prior", [])
    tables = isinstance(priors, list) and all(isinstance(prior, Mapping) for prior in priors)
    if not isinstance(frame, Mapping) or not tables:
        raise InputError(f"{where}: frame must be a table [frame], prior a list of tables [[prior]]")
    added = added_mass_of(table, path)
    state = None if table.get("state") is None else checks.text(table["state"], f"{where}: state")
    with placed(path):
        record = _record(table, path, lines)
    files = (path, *(path.parent / run["file"] for run in runs_of(table, table["record"])))
    picked = table["record"].get("pick")
    if picked is not None:
        picked = checks.vector(picked, f"{where}: record: pick", above=0.0).tolist()
    return RecordFile(record, frame, priors, added, state, picked, files)


def _record(table: Mapping[str, Any], path: Path, lines: list[int]) -> Record:
    declared = checks.keys(table["record"], RECORD_KEYS, [], "record")
    kind = checks.choice(declared.get("kind", "time"), ("time", "frf"), "record: kind")
    for key in ("time", "frequency", "axis"):
        if key in declared:
            checks.text(declared[key], f"record: {key}")
    channels = channels_of(table["channel"], declared, path, lines)
    common = {
        "stories": checks.whole(declared.get("stories", 0), "record: stories", least=0, most=MOST_STORIES),
        "quantity": declared.get("quantity", "acceleration"),
        "band": declared.get("band"),
        "exponential_window": declared.get("exponential_window"),
        "name": checks.text(declared.get("name", named_after(path)), "record: name"),
    }
    runs = runs_of(table, declared)
    if kind == "frf":
        return _frf_record(declared, channels, runs, common, path)
    return _time_record(declared, channels, runs, common, path)


def _floor(run: Mapping[str, Any], declared: Mapping[str, Any], otherwise: int | None, place: int) -> int:
    """Where the force of a run acts."""
    floor = run.get("input_floor", declared.get("input_floor", otherwise))
    if floor is None:
        raise InputError(f"run {place}: the key 'input_floor' is missing: which floor does the force act on?")
    return checks.whole(floor, f"run {place}: input_floor", least=1, most=MOST_STORIES)


def columns_of(run: Mapping[str, Any], declared: Mapping[str, Any], path: Path) -> Columns:
    """The columns of a run's file."""
    file = path.parent / run["file"]
    suffix = file.suffix.lower()
    limit = MEGABYTE * checks.number(declared.get("size_limit", LIMIT / MEGABYTE), "record: size_limit (MB)", above=0.0)
    if suffix == ".mat":
        return read_mat(file, limit)
    return read_uff(file, limit)[0] if suffix in (".uff", ".unv", ".u58") else read_csv(file, limit)


def _time_record(
    declared: Mapping[str, Any],
    channels: list[ChannelDeclaration],
    runs: list[Mapping[str, Any]],
    common: Mapping[str, Any],
    path: Path,
) -> TimeRecord:
    kind = checks.choice(declared.get("input", "none"), INPUTS, "record: input")
    driver = driver_of(channels, kind)
    responses = [item for item in channels if item is not driver and item.responds]
    quantities = {item.quantity for item in responses}
    if len(quantities) > 1:
        raise InputError(f"the responses are {' and '.join(sorted(quantities))}; a record holds one quantity")
    rates: list[tuple[float, str]] = []
    made = []
    for place, run in enumerate(runs, 1):
        columns = columns_of(run, declared, path)
        rates.append((rate_of(declared, columns), columns.source))
        excitation = None
        if driver is not None:
            excitation = driver.factor * columns.column(driver.column, driver.place or path.name)
        floor = 0 if driver is None or kind != "force" else _floor(run, declared, driver.floor or None, place)
        made.append(Run(_table(columns, responses, path), excitation, floor, run.get("name", Path(run["file"]).name)))
    refuse_two_rates(rates)
    quantity = quantities.pop() if quantities else common["quantity"]
    return TimeRecord(
        _made(responses), **{**common, "quantity": quantity}, runs=tuple(made), sampling_rate=rates[0][0], input=kind
    )


def _made(responses: list[ChannelDeclaration]) -> tuple[Channel, ...]:
    return tuple(Channel(item.column, item.floor, item.axis, item.place) for item in responses)


def _table(columns: Columns, responses: list[ChannelDeclaration], path: Path) -> Floats:
    if not responses:
        raise InputError("no channel is on a floor above the ground")
    return np.column_stack([item.factor * columns.column(item.column, item.place or path.name) for item in responses])


def rate_of(declared: Mapping[str, Any], columns: Columns) -> float:
    """The sampling rate, from the time column, from the declaration, or from both where they agree."""
    name = declared.get("time") or next((item for item in TIME_NAMES if item in columns.names), None)
    said = declared.get("sampling_rate")
    if said is not None:
        said = checks.number(said, "record: sampling_rate", above=0.0)
    if name is None:
        if said is None:
            raise InputError(
                f"record: give sampling_rate, in Hz, or time, the name of the time column of {columns.source}"
            )
        return said
    rate = sampling_rate_of(columns.column(name, "record: time"), columns, name, said)
    if said is not None:
        if abs(rate - said) > 0.01 * said:
            raise InputError(
                f'record: sampling_rate = {said:g} Hz, but column "{name}" of {columns.source} ticks at {rate:.6g} Hz'
            )
        return said
    return rate


def refuse_two_rates(rates: list[tuple[float, str]]) -> None:
    """Raise `InputError` where files of one record were sampled at different rates."""
    for rate, source in rates[1:]:
        if abs(rate - rates[0][0]) > 1e-3 * rates[0][0]:
            raise InputError(
                f"{source} is sampled at {rate:.6g} Hz, {rates[0][1]} at {rates[0][0]:.6g} Hz: two sampling rates in "
                "one record; resample one of them"
            )


def _frf_record(
    declared: Mapping[str, Any],
    channels: list[ChannelDeclaration],
    runs: list[Mapping[str, Any]],
    common: Mapping[str, Any],
    path: Path,
) -> FrfRecord:
    if declared.get("input", "force") != "force":
        raise InputError('record: frequency response functions have input = "force"')
    made, axes = [], []
    for place, run in enumerate(runs, 1):
        columns = columns_of(run, declared, path)
        name = declared.get("frequency") or next((item for item in FREQUENCY_NAMES if item in columns.names), None)
        if name is None:
            raise InputError(f"record: give frequency, the name of the frequency column of {columns.source}")
        axes.append((columns.column(name, "record: frequency"), columns.source))
        floor = _floor(run, declared, None, place)
        responses = np.column_stack([_complex(columns, item, path) for item in channels])
        made.append(FrfRun(responses, floor, run.get("name", Path(run["file"]).name)))
    for axis, source in axes[1:]:
        if axis.shape != axes[0][0].shape or not np.allclose(axis, axes[0][0], rtol=1e-6):
            raise InputError(f"{source} and {axes[0][1]} have different frequency lines; a record has one axis")
    return FrfRecord(
        _made(channels), **common, runs=tuple(made), frequencies=axes[0][0], truncated=declared.get("truncated")
    )


def _complex(columns: Columns, item: ChannelDeclaration, path: Path) -> Any:
    asked = item.place or path.name
    real, imaginary = f"{item.column}_re", f"{item.column}_im"
    return item.factor * (columns.column(real, asked) + 1j * columns.column(imaginary, asked))
