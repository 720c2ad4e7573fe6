"""Modes of record files: of one or several as one measurement."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cvxshear.io.formats import named_after
from cvxshear.io.record_tables import read_record
from cvxshear.io.toml import files_of, is_record_file, load, write_measurement
from cvxshear.measurement.experiment import Experiment
from cvxshear.records.identify import identify_modes
from cvxshear.records.record import Finding
from cvxshear.records.result import IdentifiedRecord, ModalResult, merged, scale_unknown
from cvxshear.util import parallel
from cvxshear.util.errors import CvxshearError, NoSolutionError
from cvxshear.util.typing import Json
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
    if scale_unsaid([test]):
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
    comments = [f"scale: {UNKNOWN_SCALE}"] if scale_unsaid(tests) else []
    for test in tests:
        modes = test.modes
        comments.append(f"Modes of {modes.name} by {modes.method}; standard deviations: {modes.uncertainty}")
        comments.extend(f"{modes.name}: {finding.kind}: {finding.message}" for finding in modes.findings)
    write_measurement(path, declared, comments)


def scale_unsaid(tests: Sequence[IdentifiedRecord]) -> bool:
    """Return whether the scale of the masses is unknown and no finding reports it."""
    return scale_unknown(tests) and not any(each.kind == "scale" for test in tests for each in test.modes.findings)


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
