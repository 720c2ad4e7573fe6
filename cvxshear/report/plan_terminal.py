"""The report of a plan, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from cvxshear.planning.apart import SUFFICES
from cvxshear.planning.results import Outlook, Plan
from cvxshear.quantities import percent, scaled, significant
from cvxshear.report.terminal import plain_table
from cvxshear.typing import Floats

PROVEN = 1e-9
"""Gap below which a choice is the best there is."""


def plan(result: Plan) -> Iterator[RenderableType]:
    """Where to put the sensors and the masses, what that will tell, and what one sensor more or less would."""
    n = result.model.design.stories
    yield Text(headline(result), style="bold")
    yield Text(f"{sure(result)}\n")
    yield Text(f"{result.model.design.name}: {n} stories; expected noise: {result.model.noise.describe()}\n")
    yield modes(result)
    yield Text("")
    yield masses(result)
    yield Text("")
    if result.apart:
        yield verdicts(result)
        yield Text("\n".join([*conclusions(result), ""]))
    yield accuracy(result)
    yield Text("")
    yield counts(result)


def headline(result: Plan) -> str:
    """The choice in a sentence."""
    floors = ", ".join(map(str, result.sensors))
    everywhere = len(result.sensors) == result.model.design.stories
    where = "every floor" if everywhere else f"floor{'s' * (len(result.sensors) > 1)} {floors}"
    return f"Measure {where} in {len(result.tests)} test{'s' * (len(result.tests) > 1)}, for {result.goal}."


def sure(result: Plan) -> str:
    """The objective, and how far from the best the choice can be."""
    unit = "of the effects' sizes" if result.apart else "relative"
    said = f"{result.measure} ({result.criterion}): {percent(result.objective)} {unit}"
    if len(result.sensors) == result.model.design.stories:
        return said
    if result.gap < PROVEN:
        return f"{said}; every choice of as many floors was looked at, none is better"
    if not np.isfinite(result.gap):
        return f"{said}; the convex program gives no bound"
    return f"{said}; no choice of as many floors is below {percent(result.bound)} (gap {percent(result.gap, 1)})"


def modes(result: Plan) -> Table:
    """The modes of the first test, and how well they will be known."""
    title = f"expected modes ({result.names[0]})"
    table = plain_table(title, "mode", "frequency, Hz", "std", "std of a shape's entry", "std of damping")
    for each in result.expected_modes:
        table.add_row(
            str(each.mode),
            significant(each.frequency),
            percent(each.frequency_std, 4),
            percent(each.mode_shape_std, 3),
            percent(each.damping_std, 1),
        )
    return table


def masses(result: Plan) -> Table:
    """Added mass of each test, the top floor first."""
    table = plain_table("tests: added mass, kg", "floor", *result.names, "sensor")
    for floor in reversed(range(result.model.design.stories)):
        sensor = "x" if floor + 1 in result.sensors else ""
        table.add_row(str(floor + 1), *(significant(float(test[floor])) for test in result.tests), sensor)
    return table


def verdicts(result: Plan) -> Table:
    """How far each effect is told from none and from the others."""
    table = plain_table(
        "how far they will be told apart",
        "if it is", "size", "from none, std", "hardest to tell from", "std", "right verdict",
    )  # fmt: skip
    for each in result.apart:
        table.add_row(
            each.label,
            significant(each.size, 3),
            significant(each.distance, 3),
            each.nearest or "–",
            significant(each.nearest_distance, 3),
            percent(each.probability, 0),
        )
    return table


def conclusions(result: Plan) -> list[str]:
    """Whether the tests suffice, in words, one line an effect."""
    return [
        f"{each.label}: these tests {'can' if each.probability >= SUFFICES else 'cannot'} show it"
        for each in result.apart
        if each.size is not None
    ]


def accuracy(result: Plan) -> Table:
    """Expected standard deviations of every mass and stiffness: as planned, one sensor less and more, all floors."""
    design = result.model.design
    options = [("as planned", result.chosen), ("one less", result.fewer), ("one more", result.more)]
    options.append(("all floors", result.everywhere))
    shown = [(name, each) for name, each in options if each is not None]
    factor, unit = scaled(design.story_stiffness.tolist(), "N/m")
    table = plain_table(
        "expected standard deviations (of the shear model)",
        "floor / story", "mass, kg", *(name for name, _ in shown), f"stiffness, {unit}", *(name for name, _ in shown),
    )  # fmt: skip
    for i in reversed(range(design.stories)):
        table.add_row(
            str(i + 1),
            significant(float(design.floor_mass[i])),
            *(_std(each.floor_mass_std, i, float(design.floor_mass[i])) for _, each in shown),
            significant(float(design.story_stiffness[i]) / factor),
            *(_std(each.story_stiffness_std, i, float(design.story_stiffness[i])) for _, each in shown),
        )
    return table


def _std(std: Floats, at: int, value: float) -> str:
    """A standard deviation, relative."""
    if np.isnan(std[at]):
        return "open"
    return "exact" if std[at] < 1e-9 * value else percent(float(std[at]) / value)


def counts(result: Plan) -> Table:
    """The objective against the number of sensors."""
    table = plain_table(f"{result.measure}, by number of sensors", "sensors", "floors", "value", "no choice below")
    rows: dict[int, Outlook] = {
        len(each.floors): each
        for each in (result.fewer, result.chosen, result.more, result.everywhere)
        if each is not None
    }
    for count, each in sorted(rows.items()):
        everywhere = count == result.model.design.stories
        floors = "all" if everywhere else ", ".join(map(str, each.floors))
        table.add_row(str(count), floors, percent(each.objective), percent(each.bound))
    return table
