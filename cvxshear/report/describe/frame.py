"""A frame's masses and stiffnesses, as every result shows them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from cvxshear.methods import IdentifiedFrame
from cvxshear.report.describe.vocabulary import Table, columns
from cvxshear.util.quantities import EXACT, UNKNOWN, Units, significant, significants, with_std
from cvxshear.util.typing import Floats


def frame_table(
    frame: IdentifiedFrame,
    title: str,
    units: Units,
    *,
    key: str = "identified",
    averaged: IdentifiedFrame | None = None,
) -> Table:
    """Floor masses and story stiffnesses, the top of the frame first, and beside them those averaged over models."""
    mass_factor, mass_unit = units.of_mass(frame.floor_mass.tolist())
    factor, unit = units.of_stiffness(frame.story_stiffness.tolist())
    head = ["floor / story", f"mass, {mass_unit}", f"stiffness, {unit}"]
    shown = [frame] if averaged is None else [frame, averaged]
    if averaged is not None:
        head += [f"averaged mass, {mass_unit}", f"averaged stiffness, {unit}"]
    cells = [[str(i) for i in range(1, len(frame.floor_mass) + 1)]]
    for each in shown:
        for quantity, values, std, size in (
            ("floor_mass", each.floor_mass, each.floor_mass_std, mass_factor),
            ("story_stiffness", each.story_stiffness, each.story_stiffness_std, factor),
        ):
            stopped = each.stopped(quantity)
            written = _column(values, std, size)
            cells.append([
                f"{significant(value / size, 2)} (at a bound)" if at_bound else text
                for value, text, at_bound in zip(values.tolist(), written, stopped, strict=True)
            ])  # fmt: skip
    return Table(key, title, tuple(head), tuple(reversed(columns(*cells))))


def in_one_unit(
    values: Floats, stds: Floats | None, unit_of: Callable[[Iterable[float]], tuple[float, str]]
) -> tuple[list[str], str]:
    """Values, with their standard deviations where there are any, in one unit and, where there are none, one format.

    Parameters
    ----------
    values, stds : ndarray, shape (N,)
    unit_of : callable
        The size and the name of the unit that fits values, such as `Units.of_mass`.

    Returns
    -------
    written : list of str
    unit : str
    """
    factor, unit = unit_of(values.tolist())
    return _column(values, stds, factor), unit


def _column(values: Floats, stds: Floats | None, factor: float) -> list[str]:
    if stds is None or np.all(np.isnan(stds)):
        written = significants((values / factor).tolist(), 5)
        return [UNKNOWN if np.isnan(value) else text for value, text in zip(values, written, strict=True)]
    fast = ~np.isnan(values) & ~(stds > EXACT * np.abs(values))
    # What is held fast has no deviation, and one format.
    shown = _short(significants((values[fast] / factor).tolist(), 5))
    held = dict(zip(np.flatnonzero(fast).tolist(), shown, strict=True))
    return [
        UNKNOWN if np.isnan(value) else held[place] if place in held else with_std(value, std, factor=factor)
        for place, (value, std) in enumerate(zip(values.tolist(), stds.tolist(), strict=True))
    ]


def _short(written: list[str]) -> list[str]:
    """Decimals of one number, without those that are 0 in all."""
    while written and all("." in text and text.endswith(("0", ".")) for text in written):
        written = [text[:-1] for text in written]
    return written
