"""A planned test: where to put the sensors and the masses, what that will tell, and what one sensor more would."""

from __future__ import annotations

import numpy as np

from cvxshear.planning.apart import SUFFICES
from cvxshear.planning.results import OPEN, Outlook, Plan
from cvxshear.report.describe.vocabulary import Document, Section, Sentence, Table, describe, plain_rows
from cvxshear.util.quantities import AUTOMATIC, Units, counted, percent, significant
from cvxshear.util.typing import Floats

PROVEN = 1e-9
"""Gap below which a choice is the best there is."""


@describe.register
def _plan(of: Plan, units: Units = AUTOMATIC) -> Document:
    design = of.model.design
    noise = f"{design.name}: {design.stories} stories; expected noise: {of.model.noise.describe()}"
    sections = [
        Section("choice", "", (Sentence(sure(of)), Sentence(noise))),
        Section("tests", "The tests", (expected_modes(of), added_masses(of, units))),
    ]
    if of.apart:
        sections.append(Section("apart", "What they will tell apart", (verdicts(of), *conclusions(of))))
    sections.append(Section("accuracy", "What they will determine", (accuracy(of, units), counts(of))))
    return Document(design.name, headline(of), tuple(sections))


def headline(of: Plan) -> str:
    """The choice in a sentence."""
    floors = ", ".join(map(str, of.sensors))
    everywhere = len(of.sensors) == of.model.design.stories
    where = "every floor" if everywhere else f"floor{'s' * (len(of.sensors) > 1)} {floors}"
    return f"Measure {where} in {counted(len(of.tests), 'test')}, for {of.goal}."


def sure(of: Plan) -> str:
    """The objective, and how far from the best the choice can be."""
    unit = "of the effects' sizes" if of.apart else "relative"
    said = f"{of.measure} ({of.criterion}): {percent(of.objective)} {unit}"
    if of.objective >= OPEN:
        said = f"{of.measure} ({of.criterion}): open, {percent(OPEN, 0)} {unit} or more"
    if len(of.sensors) == of.model.design.stories:
        return said
    if of.gap < PROVEN:
        return f"{said}; every choice of as many floors was looked at, none is better"
    if not np.isfinite(of.gap):
        return f"{said}; the convex program gives no bound"
    if of.bound >= OPEN:
        return f"{said}; no choice of as many floors is better than open"
    gap = "" if of.objective >= OPEN else f" (gap {percent(of.gap, 1)})"
    return f"{said}; no choice of as many floors is below {percent(of.bound)}{gap}"


def expected_modes(of: Plan) -> Table:
    """The modes of the first test, and how well they will be known."""
    rows = plain_rows(
        (
            str(each.mode),
            significant(each.frequency),
            percent(each.frequency_std, 4),
            percent(each.mode_shape_std, 3),
            percent(each.damping_std, 1),
        )
        for each in of.expected_modes
    )
    head = ("mode", "frequency, Hz", "std", "std of a shape's entry", "std of damping")
    return Table("expected-modes", f"expected modes ({of.names[0]})", head, rows)


def added_masses(of: Plan, units: Units) -> Table:
    """Added mass of each test, the top floor first."""
    # They are laid on floors by hand, and asked for in kg, whatever their size.
    factor, unit = (1.0, "kg") if units.mass is None else units.of_mass(np.concatenate(of.tests).tolist())
    rows = plain_rows(
        (
            str(floor),
            *(significant(float(test[floor - 1]) / factor) for test in of.tests),
            "x" if floor in of.sensors else "",
        )
        for floor in range(of.model.design.stories, 0, -1)
    )
    return Table("added-mass", f"tests: added mass, {unit}", ("floor", *of.names, "sensor"), rows)


def verdicts(of: Plan) -> Table:
    """How far each effect is told from none and from the others."""
    rows = plain_rows(
        (
            each.label,
            significant(each.size, 3),
            significant(each.distance, 3),
            each.nearest or "–",
            significant(each.nearest_distance, 3),
            percent(each.probability, 0),
        )
        for each in of.apart
    )
    head = ("if it is", "size", "from none, std", "hardest to tell from", "std", "right verdict")
    return Table("verdicts", "how far they will be told apart", head, rows)


def conclusions(of: Plan) -> list[Sentence]:
    """Whether the tests suffice, in words, one sentence an effect."""
    return [
        Sentence(f"{each.label}: these tests {'can' if each.probability >= SUFFICES else 'cannot'} show it")
        for each in of.apart
        if each.size is not None
    ]


def accuracy(of: Plan, units: Units) -> Table:
    """Expected standard deviations of every mass and stiffness: as planned, one sensor less and more, all floors."""
    design = of.model.design
    options = (
        ("as planned", of.chosen),
        ("one less", of.fewer),
        ("one more", of.more),
        ("all floors", of.everywhere),
    )
    shown = [(name, each) for name, each in options if each is not None]
    names = tuple(name for name, _ in shown)
    mass_factor, mass_unit = units.of_mass(design.floor_mass.tolist())
    factor, unit = units.of_stiffness(design.story_stiffness.tolist())
    rows = plain_rows(
        (
            str(i + 1),
            significant(float(design.floor_mass[i]) / mass_factor),
            *(_std(each.floor_mass_std, i, float(design.floor_mass[i])) for _, each in shown),
            significant(float(design.story_stiffness[i]) / factor),
            *(_std(each.story_stiffness_std, i, float(design.story_stiffness[i])) for _, each in shown),
        )
        for i in reversed(range(design.stories))
    )
    head = ("floor / story", f"mass, {mass_unit}", *names, f"stiffness, {unit}", *names)
    return Table("accuracy-table", "expected standard deviations (of the shear model)", head, rows)


def _std(std: Floats, at: int, value: float) -> str:
    """A standard deviation, relative."""
    if np.isnan(std[at]):
        return "open"
    return "exact" if std[at] < 1e-9 * value else percent(float(std[at]) / value)


def _value(objective: float) -> str:
    """The criterion's standard deviation, relative."""
    return "open" if objective >= OPEN else percent(objective)


def counts(of: Plan) -> Table:
    """The objective against the number of sensors."""
    outlooks: dict[int, Outlook] = {
        len(each.floors): each for each in (of.fewer, of.chosen, of.more, of.everywhere) if each is not None
    }
    rows = plain_rows(
        (
            str(count),
            "all" if count == of.model.design.stories else ", ".join(map(str, each.floors)),
            _value(each.objective),
            _value(each.bound),
        )
        for count, each in sorted(outlooks.items())
    )
    head = ("sensors", "floors", "value", "no choice below")
    return Table("counts", f"{of.measure}, by number of sensors", head, rows)
