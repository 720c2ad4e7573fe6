"""Several tested records as one measurement: a configuration each, what their files say of the frame put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.campaign.many import IdentifiedRecord
from cvxshear.files.measurement import write_measurement
from cvxshear.measurement.experiment import Experiment
from cvxshear.modal.diagnostics import cables_changed
from cvxshear.modal.result import frame_in
from cvxshear.records.record import Finding
from cvxshear.util.checks import shown
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Json

PLACES = ("kind", "quantity", "at", "of", "to")
"""Keys of a prior that say what it speaks of; the others are what it says."""
UNKNOWN_SCALE = (
    "nothing tells how heavy the frame is: total_mass = 1 is written in its place, and masses and stiffnesses come out "
    "per kilogram of the frame; give [frame] total_mass in a record file"
)


def merged(tests: Sequence[IdentifiedRecord]) -> Json:
    """A dict of the measurement file's shape, for `Experiment.from_dict`.

    Parameters
    ----------
    tests : sequence of IdentifiedRecord
        Of one frame; at least one.

    Returns
    -------
    dict
        One configuration a record, in their order. `total_mass` is 1 kg where nothing tells how heavy the frame is.

    Raises
    ------
    InputError
        Where two records contradict each other, naming both files, the key and the values.
    """
    if not tests:
        raise InputError("there is no record whose modes were found; a measurement needs one at least")
    _refuse_shared_names(tests)
    frame = frame_in(_frame(tests), {test.state or test.modes.name for test in tests})
    priors = _priors(tests)
    if scale_unknown(tests):
        frame |= {"total_mass": 1.0, "total_mass_placeholder": True}
    result: Json = {"frame": frame}
    if priors:
        result["prior"] = priors
    result["configuration"] = [test.modes.configuration(added_mass=test.added_mass, state=test.state) for test in tests]
    return result


def write_merged(path: str | Path, tests: Sequence[IdentifiedRecord]) -> None:
    """Write the measurement file of several records, what each got wrong as comments at its head.

    Parameters
    ----------
    path : str or Path
    tests : sequence of IdentifiedRecord

    Raises
    ------
    InputError
        Where two records contradict each other, or `cvxshear.load` would refuse the file; nothing is written then.
    """
    declared = merged(tests)
    Experiment.from_dict(declared, name=Path(path).stem)
    comments = [f"scale: {UNKNOWN_SCALE}"] if scale_unknown(tests) else []
    comments.extend(f"{finding.kind}: {finding.message}" for finding in cables_of(tests))
    for test in tests:
        modes = test.modes
        comments.append(f"Modes of {modes.name} by {modes.method}; standard deviations: {modes.uncertainty}")
        comments.extend(f"{modes.name}: {finding.kind}: {finding.message}" for finding in modes.findings)
    write_measurement(path, declared, comments)


def cables_of(tests: Sequence[IdentifiedRecord]) -> list[Finding]:
    """What changed between each record and the first that a cable explains, before any damage is looked for."""
    return [finding for test in tests[1:] for finding in cables_changed(tests[0].modes, test.modes)]


def scale_unknown(tests: Sequence[IdentifiedRecord]) -> bool:
    """Whether nothing in any record file, nor a change of added mass between them, tells how heavy the frame is."""
    if not all(test.modes.needs_mass(test.frame, test.priors) for test in tests):
        return False
    stories = max(test.modes.stories for test in tests)
    added = [np.zeros(stories) if test.added_mass is None else np.asarray(test.added_mass) for test in tests]
    return all(np.array_equal(mass, added[0]) for mass in added)


def _refuse_shared_names(tests: Sequence[IdentifiedRecord]) -> None:
    seen: dict[str, str] = {}
    for test in tests:
        name = test.modes.name
        if name in seen:
            raise InputError(f'{seen[name]} and {test.file} are both named "{name}"; give each its own record: name')
        seen[name] = test.file


def _frame(tests: Sequence[IdentifiedRecord]) -> dict[str, Any]:
    """The table [frame], every key that any file gives."""
    frame: dict[str, Any] = {}
    said: dict[str, str] = {}
    for test in tests:
        for key, value in {"stories": test.modes.stories, **test.frame}.items():
            if key in frame and not _same(frame[key], value):
                raise InputError(
                    f"frame: {key} is {shown(frame[key])} by {said[key]}, {shown(value)} by {test.file}; {_remedy(key)}"
                )
            frame.setdefault(key, value)
            said.setdefault(key, test.file)
    return frame


def _remedy(key: str) -> str:
    if key == "stories":
        return "say record: stories in each file whose top floor has no sensor"
    return "records of one frame must agree, and one of them is enough to say it"


def _same(one: object, other: object) -> bool:
    """Whether two values say the same; one number for all stories equals a list of it."""
    numbers = (int, float, list)
    if isinstance(one, numbers) and isinstance(other, numbers):
        try:
            a, b = np.broadcast_arrays(np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64))
        except (TypeError, ValueError):
            return False
        return bool(np.allclose(a, b, rtol=1e-9, atol=0.0))
    return one == other


def _priors(tests: Sequence[IdentifiedRecord]) -> list[dict[str, object]]:
    """The tables [[prior]], each once."""
    kept: list[tuple[dict[str, object], str]] = []
    for test in tests:
        for prior in test.priors:
            if any(_same_prior(other, prior) for other, _ in kept):
                continue
            for other, file in kept:
                if file != test.file and all(_same(other.get(key), prior.get(key)) for key in PLACES):
                    raise InputError(
                        f"prior: {shown(other)} by {file} and {shown(dict(prior))} by {test.file} speak of the same "
                        "thing and differ; leave one out"
                    )
            kept.append((dict(prior), test.file))
    return [prior for prior, _ in kept]


def _same_prior(one: Mapping[str, object], other: Mapping[str, object]) -> bool:
    return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
