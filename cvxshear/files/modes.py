"""From a record file to a measurement file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from cvxshear.files.measurement import write_measurement
from cvxshear.files.record import RecordFile, read_record
from cvxshear.files.uff import write_uff
from cvxshear.measurement.experiment import Experiment
from cvxshear.modal.identify import identify_modes
from cvxshear.modal.result import ModalResult
from cvxshear.records.record import Finding
from cvxshear.util.typing import Json
from cvxshear.util.writing import check_output

MEASUREMENT_ENDINGS = (".toml",)
UNIVERSAL_ENDINGS = (".uff", ".unv", ".u55")


def modes_from_file(
    path: str | Path,
    *,
    method: str | None = None,
    estimator: str = "h1",
    blocks: int = 20,
    count: int | None = None,
    rule: str = "magnitude",
    correct_clocks: bool = False,
    accept_swapped: bool = False,
    pick: Sequence[float] | None = None,
    output: str | Path | None = None,
    uff: str | Path | None = None,
) -> tuple[ModalResult, Json]:
    """Identify the modes of a record file and write what was asked for.

    Parameters
    ----------
    path : str or Path
        The record file (TOML).
    method, estimator, blocks, count, rule, correct_clocks, accept_swapped
        As for `identify_modes`.
    pick : sequence of float, optional
        The same, in place of the record file's own list.
    output : str or Path, optional
        Where to write the measurement file, `.toml`.
    uff : str or Path, optional
        Where to write a universal file of the modes, `.uff`, `.unv` or `.u55`.

    Returns
    -------
    result : ModalResult
    declared : dict
        Of the measurement file's shape, for `Experiment.from_dict`.

    Raises
    ------
    InputError
        Where the record file or a file it names is wrong, or a file to write would replace one of them; nothing is
        written then.
    NoSolutionError
        Where no mode was found.
    """
    source = read_record(path)
    for place, endings in ((output, MEASUREMENT_ENDINGS), (uff, UNIVERSAL_ENDINGS)):
        if place is not None:
            check_output(place, endings=endings, keep=source.files)
    result = identify_modes(
        source.record,
        method=method,
        estimator=estimator,
        blocks=blocks,
        count=count,
        rule=rule,
        correct_clocks=correct_clocks,
        accept_swapped=accept_swapped,
        pick=source.pick if pick is None else pick,
    )
    result = _with_scale_finding(result, source)
    frame, priors, added_mass, state = source.frame, source.priors, source.added_mass, source.state
    declared = result.to_experiment(frame, priors=priors, added_mass=added_mass, state=state)
    if output is not None:
        write_modes(output, result, frame, priors=priors, added_mass=added_mass, state=state)
    if uff is not None:
        write_uff(uff, result)
    return result, declared


def write_modes(
    path: str | Path,
    result: ModalResult,
    frame: Mapping[str, object] | None = None,
    *,
    priors: Sequence[Mapping[str, object]] = (),
    added_mass: Sequence[float] | None = None,
    state: str | None = None,
) -> None:
    """Write the measurement file of identified modes, the findings as comments at its head.

    Parameters
    ----------
    path : str or Path
    result : ModalResult
    frame, priors, added_mass, state
        As for `ModalResult.to_experiment`.

    Raises
    ------
    InputError
        Where the modes do not make a measurement that `cvxshear.load` would take; nothing is written.
    """
    declared = result.to_experiment(frame, priors=priors, added_mass=added_mass, state=state)
    Experiment.from_dict(declared, name=result.name)
    comments = [f"Modes of {result.name} by {result.method}; standard deviations: {result.uncertainty}"]
    if result.needs_mass(frame or {}, priors) and not any(finding.kind == "scale" for finding in result.findings):
        comments.append("scale: total_mass = 1 stands for a mass nobody gave; masses and stiffnesses are relative")
    comments.extend(f"{finding.kind}: {finding.message}" for finding in result.findings)
    write_measurement(path, declared, comments)


def _with_scale_finding(result: ModalResult, source: RecordFile) -> ModalResult:
    if not result.needs_mass(source.frame, source.priors):
        return result
    finding = Finding(
        "scale",
        "nothing tells how heavy the frame is: total_mass = 1 is written in its place, and masses and stiffnesses come "
        "out per kilogram of the frame; give [frame] total_mass in the record file",
        {"total_mass": 1.0},
    )
    return dataclasses.replace(result, findings=(*result.findings, finding))
