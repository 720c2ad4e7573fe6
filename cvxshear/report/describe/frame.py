"""A frame's masses and stiffnesses, as every result shows them."""

from __future__ import annotations

import numpy as np

from cvxshear.identification import IdentifiedFrame
from cvxshear.quantities import Units, with_std
from cvxshear.report.describe.vocabulary import Row, Table
from cvxshear.typing import Floats


def frame_table(
    frame: IdentifiedFrame, title: str, units: Units, *, key: str = "identified", averaged: IdentifiedFrame | None = None
) -> Table:
    """Floor masses and story stiffnesses, the top of the frame first, and beside them those averaged over models."""
    mass_factor, mass_unit = units.of_mass(frame.floor_mass.tolist())
    factor, unit = units.of_stiffness(frame.story_stiffness.tolist())
    head = ["floor / story", f"mass, {mass_unit}", f"stiffness, {unit}"]
    shown = [frame] if averaged is None else [frame, averaged]
    if averaged is not None:
        head += [f"averaged mass, {mass_unit}", f"averaged stiffness, {unit}"]
    rows = []
    for i in reversed(range(len(frame.floor_mass))):
        cells = [str(i + 1)]
        for each in shown:
            cells.append(_cell(each.floor_mass, each.floor_mass_std, i, mass_factor))
            cells.append(_cell(each.story_stiffness, each.story_stiffness_std, i, factor))
        rows.append(Row(tuple(cells)))
    return Table(key, title, tuple(head), tuple(rows))


def _cell(values: Floats, stds: Floats | None, i: int, factor: float) -> str:
    return with_std(float(values[i]), None if stds is None or np.isnan(stds[i]) else float(stds[i]), factor=factor)
