"""What a function takes in place of an experiment: the file that it stands in, or a built-in's name."""

from __future__ import annotations

from pathlib import Path

from cvxshear.measurement.experiment import Experiment
from cvxshear.util.checks import shown
from cvxshear.util.errors import InputError
from cvxshear.util.reader import experiment_in

Measurement = str | Path | Experiment
"""An experiment, the path of a measurement file or a record file, or the name of a built-in example."""


def opened(source: Measurement) -> Experiment:
    """Return an experiment as it is, or read it from its file.

    Parameters
    ----------
    source : Experiment, str or Path
        A path, of a measurement file or of a record file, whose modes are then identified; or a built-in's name.

    Raises
    ------
    InputError
        Where it is none of these, or the file cannot be read.
    NoSolutionError
        Where no mode was found in a record.
    """
    if isinstance(source, Experiment):
        return source
    if not isinstance(source, str | Path):
        raise InputError(
            f"an Experiment, the path of its file or the name of a built-in example is needed, not {shown(source)}"
        )
    found: Experiment = experiment_in(source)
    return found
