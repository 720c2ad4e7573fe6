"""From a record file to a measurement file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cvxshear.modal.findings import Finding
from cvxshear.modal.identify import identify_modes
from cvxshear.modal.result import ModalResult
from cvxshear.typing import Json

if TYPE_CHECKING:
    from cvxshear.formats.record import RecordFile


def run(
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
        Where to write the measurement file.
    uff : str or Path, optional
        Where to write a universal file of the modes.

    Returns
    -------
    result : ModalResult
    declared : dict
        Of the measurement file's shape, for `Experiment.from_dict`.

    Raises
    ------
    InputError
        Where the record file or a file it names is wrong; nothing is written then.
    NoSolutionError
        Where no mode was found.
    """
    # The readers make records of this package, so they are loaded after it.
    from cvxshear.formats.record import read_record  # noqa: PLC0415
    from cvxshear.formats.uff import write_uff  # noqa: PLC0415

    source = read_record(path)
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
        result.write(output, frame, priors=priors, added_mass=added_mass, state=state)
    if uff is not None:
        write_uff(uff, result)
    return result, declared


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
