"""The modes of many records, over processes or a cluster."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cvxshear.files.record import read_record
from cvxshear.modal import ModalResult, identify_modes
from cvxshear.util.errors import CvxshearError, NoSolutionError
from cvxshear.util.parallel import Progress, each


@dataclass(frozen=True, eq=False)
class IdentifiedRecord:
    """One record with the modes found in it, and what its file says of the frame besides.

    Parameters
    ----------
    file : str
        The record file.
    modes : ModalResult
    frame : dict
        The table `[frame]`.
    priors : sequence of dict
        The tables `[[prior]]`.
    added_mass : sequence of float, optional
        kg on each floor during the record.
    state : str, optional
        The state of the frame that was tested.
    """

    file: str
    modes: ModalResult
    frame: Mapping[str, object]
    priors: Sequence[Mapping[str, object]] = ()
    added_mass: Sequence[float] | None = None
    state: str | None = None


def identify_modes_many(
    files: Iterable[str | Path],
    *,
    jobs: int = 1,
    progress: Progress | None = None,
    **options: Any,
) -> list[IdentifiedRecord | CvxshearError]:
    """`identify_modes` for each of many record files; where one fails, its error stands in its place.

    Parameters
    ----------
    files : iterable of str or Path
        Record files (TOML).
    jobs : int, optional
        Processes; -1 takes every core. Inside `with joblib.parallel_config(backend="dask")` they run on that
        cluster, whose workers must see the files.
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
        Where an option is not one of `identify_modes`.
    """
    return each(partial(_tested, options=options), [str(file) for file in files], jobs=jobs, progress=progress)


def _tested(file: str, *, options: Mapping[str, Any]) -> IdentifiedRecord | CvxshearError:
    try:
        source = read_record(file)
        picked = options.get("pick")
        modes = identify_modes(source.record, **{**options, "pick": source.pick if picked is None else picked})
    except CvxshearError as error:
        return _of_file(error, file)
    return IdentifiedRecord(file, modes, source.frame, source.priors, source.added_mass, source.state)


def _of_file(error: CvxshearError, file: str) -> CvxshearError:
    """The error with its file named."""
    message = str(error)
    if isinstance(error, NoSolutionError):
        return NoSolutionError(error.backend, f"{file}: {error.reason}")
    return error if message.startswith(file) else type(error)(f"{file}: {message}")
