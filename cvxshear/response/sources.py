"""Where the model of a prediction comes from: a measurement, a record, a closed loop, its JSON."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from cvxshear.backends import Backend
from cvxshear.files.modes import experiment_from_file
from cvxshear.files.record_file import read_motion
from cvxshear.files.toml import is_record_file, load, parse, read_result, read_text, with_modes_read
from cvxshear.fit.efficient import Estimate
from cvxshear.loop import Closure, close_loop
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.modal import Record
from cvxshear.records.motion import Motion
from cvxshear.records.record import FrfRecord, TimeRecord
from cvxshear.response.fitted import Fitted, Models
from cvxshear.response.recording import Recording
from cvxshear.util.checks import choice, shown
from cvxshear.util.errors import InputError, NoScaleError
from cvxshear.util.quantities import listed, percent
from cvxshear.util.typing import Floats

DRIVING = {"base": "base motion", "force": "force"}
"""Kinds of measured excitation, in words."""

ModelSource = str | Path | Experiment | Closure | Estimate | Models
MotionSource = str | Path | Record | Motion


def models_of(source: ModelSource, backend: Backend) -> Models:
    """Return the models before and after closing the loop, which is closed here where it was not before.

    Parameters
    ----------
    source : str, Path, Experiment, Closure, Estimate or Models
        A file is a measurement file, a record file, or what `loop --json` wrote.
    backend : Backend

    Raises
    ------
    InputError
        Where a file cannot be read, or is none of these.
    """
    match source:
        case Models():
            found = source
        case Closure():
            found = models_of_loop(source)
        case Estimate():
            found = Models(None, Fitted.of(source))
        case Experiment():
            found = models_of_loop(close_loop(source, backend=backend))
        case str() | Path():
            found = _of_file(source, backend)
        case _:
            raise InputError(
                "the model of a prediction is a file, an Experiment, a Closure, an Estimate or Models, not "
                + shown(source)
            )
    return found


def _of_file(source: str | Path, backend: Backend) -> Models:
    """Read the models of a measurement file, a record file, or what `loop --json` wrote."""
    if Path(source).suffix.lower() == ".json":
        return _of_json(Path(source))
    experiment = experiment_from_file(source) if is_record_file(source) else load_unscaled(source)
    return models_of_loop(close_loop(experiment, backend=backend))


def load_unscaled(path: str | Path) -> Experiment:
    """Read a measurement file that need not tell how heavy the frame is: a total of 1 kg stands in then.

    Parameters
    ----------
    path : str or Path
    """
    try:
        return load(path)
    except NoScaleError:
        path = Path(path)
        declared = dict(with_modes_read(parse(read_text(path), path), path.parent))
        frame = declared.get("frame") or {}
        # A remark of the result says it; doubts about masses that nobody wrote down would puzzle.
        accepted = {*frame.get("accept", ()), "total_mass", "masses"}
        declared["frame"] = {
            **frame, "total_mass": 1.0, "total_mass_placeholder": True, "accept": sorted(accepted)
        }  # fmt: skip
        return Experiment.from_dict(declared, name=path.stem)


def models_of_loop(closure: Closure) -> Models:
    """Return the models that a closed loop began and ended with."""
    return Models(Fitted.of(closure.before.estimate), Fitted.of(closure.estimate))


def _of_json(path: Path) -> Models:
    """Read the models from what `loop --json` wrote."""
    declared = read_result(path)
    if not isinstance(declared.get("model"), dict):
        raise InputError(f"{path} has no key 'model'; write it anew by: cvxshear loop FILE --json {path}")
    return Models.from_dict(declared["model"], f"{path}: model")


def motion_of(source: MotionSource) -> Motion:
    """Read what drives the frame.

    Parameters
    ----------
    source : str, Path, TimeRecord or Motion
        A file is a record file.

    Raises
    ------
    InputError
        Where nothing says what drove the frame.
    """
    if isinstance(source, Motion):
        return source
    if isinstance(source, TimeRecord | FrfRecord):
        return Motion.of(source)
    if not isinstance(source, str | Path):
        raise InputError(f"what drives a frame is a record file, a TimeRecord or a Motion, not {shown(source)}")
    return read_motion(source)


def state_of(experiment: Experiment, record: Motion | Recording, name: str | None = None) -> Configuration:
    """Find the configuration that the frame was in while it moved.

    Parameters
    ----------
    experiment : Experiment
    record : Motion or Recording
    name : str, optional
        Of a configuration, or of a state: its configuration with the record's added mass then. Where none is given:
        that of the record's state; without such, the only configuration, or the one with the record's added mass.

    Raises
    ------
    InputError
        Where there is no such configuration or state, or floors or added mass are of another frame.
    """
    driven = [record.force_floor] if isinstance(record, Recording) else [drive.floor for drive in record.drives]
    highest = max([*record.floors.tolist(), *driven])
    if highest > experiment.stories:
        raise InputError(f"{record.name} speaks of floor {highest}, the frame has {experiment.stories} stories")
    configurations = experiment.configurations
    if name is not None:
        names = {each.name: each for each in configurations}
        choice(name, [*names, *(state for state in experiment.states if state not in names)], "configuration")
        if name in names:
            return names[name]
    state = record.state if name is None else name
    if state is not None and (state in experiment.states or len(experiment.states) > 1):
        configurations = tuple(each for each in configurations if each.state == state)
        if not configurations:
            known = listed([f'"{state}"' for state in experiment.states])
            raise InputError(
                f'{record.name} was recorded in state "{record.state}", the model knows {known}; name one of its '
                "configurations (--configuration), or test that state"
            )
    if record.added_mass is None and len(configurations) == 1:
        return configurations[0]
    added = np.zeros(experiment.stories) if record.added_mass is None else record.added_mass
    if len(added) != experiment.stories:
        raise InputError(f"{record.name}: added_mass has {len(added)} entries, the frame {experiment.stories} stories")
    for each in configurations:
        if np.allclose(each.added_mass, added):
            return each
    return dataclasses.replace(configurations[0], name=_unused(experiment, added), added_mass=added)


def state_remarks(
    experiment: Experiment, record: Motion | Recording, configuration: Configuration, *, named: bool
) -> list[str]:
    """Say what was assumed about the state of the frame while it was recorded.

    Parameters
    ----------
    experiment : Experiment
    record : Motion or Recording
    configuration : Configuration
        What `state_of` found.
    named : bool
        Whether the caller named it: then nothing was assumed.
    """
    if record.state is not None and record.state != configuration.state:
        if named:
            return [f'the record is of state "{record.state}", the model that of "{configuration.state}", as asked']
        return [
            f'the record is of state "{record.state}", of which nothing was measured: the model is that of '
            f'"{configuration.state}"'
        ]
    if not named and record.state is None and len({each.state for each in experiment.configurations}) > 1:
        return [
            f'the record names no state: "{configuration.state}" is taken; write state = "..." in the record file, or '
            "give --configuration"
        ]
    return []


WORTH_A_WORD = 0.01
"""Size of a line taken off, relative to the rms of its channel, from which on it is said: less moves no figure that
anybody reads."""


def line_remarks(size: float, where: str) -> list[str]:
    """Say how large the straight lines were that were taken for the sensors' own, where they were worth a word.

    Parameters
    ----------
    size : float
        The largest, relative to the rms of its channel.
    where : str
        Of which channel the rms is.
    """
    if size < WORTH_A_WORD:
        return []
    return [
        f"a straight line of up to {percent(size, 1)} of {where} was taken for its sensor's and off; --no-detrend "
        "leaves it in"
    ]


def _unused(experiment: Experiment, added: Floats) -> str:
    """Make a name for a state that was not tested, which no effect of a tested one acts on."""
    taken = {each.name for each in experiment.configurations}
    name = f"{added.sum():g} kg added" if np.any(added) else "nothing added"
    while name in taken:
        name += ", not tested"
    return name
