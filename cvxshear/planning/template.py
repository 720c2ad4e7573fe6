"""The planned tests as an experiment: predicted by the model, or a measurement file to fill in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cvxshear.files.measurement import write_measurement
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.planning.model import Expected
from cvxshear.planning.results import Plan
from cvxshear.util.typing import Floats, Ints, Json


def predicted(plan: Plan) -> Experiment:
    """The planned tests, measured without error on the frame as it is expected.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    Experiment
        With what is declared of the frame, and what was measured of it before.

    Raises
    ------
    InputError
        Where the tests would not tell how heavy the frame is.
    """
    floors = plan.chosen.floors - 1
    tests = tuple(
        _configuration(plan, name, masses, plan.model.expected(masses), floors)
        for name, masses in zip(plan.names, plan.tests, strict=True)
    )
    design = plan.model.design
    before = design.measured.configurations if design.measured is not None else ()
    return Experiment(design.frame, (*before, *tests), design.priors, design.name)


def _configuration(plan: Plan, name: str, masses: Floats, test: Expected, floors: Ints) -> Configuration:
    which = plan.model.which
    return Configuration(
        frequencies=test.found.frequencies[which],
        mode_shapes=test.shapes[:, floors],
        name=name,
        added_mass=masses,
        measured_floors=floors + 1,
        modes=which + 1,
        frequency_std=test.frequency_std,
        mode_shape_std=relative_std(test, floors),
    )


def relative_std(test: Expected, floors: Ints) -> Floats:
    """The entries' standard deviations, shape (m, n), as a file has them: of a mode's largest measured entry."""
    largest = np.max(np.abs(test.shapes[:, floors]), axis=1, keepdims=True)
    result: Floats = test.shape_std[:, floors] / largest
    return result


def write_template(path: str | Path, plan: Plan) -> None:
    """Write a measurement file with the planned tests, nan in place of what is to be measured.

    Parameters
    ----------
    path : str or Path
    plan : Plan

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    exact = predicted(plan)
    declared = exact.to_dict()
    declared["configuration"] = [
        _to_fill_in(table) if table["name"] in plan.names else table for table in declared["configuration"]
    ]
    comments = [
        "Planned by cvxshear plan: put what you measure in place of every nan.",
        f"Sensors on floors {', '.join(map(str, plan.sensors))}; {plan.model.noise.describe()} expected.",
        *(
            f"{each.name}: expected frequencies {', '.join(f'{value:.4g}' for value in each.frequencies)} Hz"
            for each in exact.configurations
            if each.name in plan.names
        ),
    ]
    write_measurement(path, declared, comments)


def _to_fill_in(table: Json) -> Json:
    """The table of a planned test without its predictions."""
    shapes = np.full(np.shape(table["mode_shapes"]), np.nan)
    return {**table, "frequencies": np.full(len(table["frequencies"]), np.nan).tolist(), "mode_shapes": shapes.tolist()}
