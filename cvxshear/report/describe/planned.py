"""Describe a planned test: the places of sensors and masses, the expected accuracy, and the gain of one more sensor."""

import dataclasses

import numpy as np

from cvxshear.planning.chances import SUFFICES
from cvxshear.planning.design import UNKNOWN_STD
from cvxshear.planning.results import ExpectedAccuracy, Plan
from cvxshear.report.describe.vocabulary import Document, Section, Sentence, Table, describe, plain_rows, table
from cvxshear.util.quantities import AUTOMATIC, Units, counted, percent, percents, significant
from cvxshear.util.typing import Floats

PROVEN = 1e-9
"""Largest gap between the objective and its bound for a choice that counts as optimal."""


@describe.register
def _plan(result: Plan, units: Units = AUTOMATIC) -> Document:
    design = result.model.design
    noise = f"{design.name}: {design.stories} stories; expected noise: {result.model.noise.words}"
    sections = [
        Section("choice", "", (Sentence(sure(result)), *cautions(result), Sentence(noise))),
        Section("tests", "The tests", (expected_modes(result), added_masses(result, units), *grid(result))),
    ]
    if result.apart:
        sections.append(Section("apart", "Which effects they will show", (verdicts(result), *conclusions(result))))
    sections.append(Section("accuracy", "What they will determine", (accuracy(result, units), counts(result))))
    return Document(design.name, headline(result), tuple(sections))


def headline(result: Plan) -> str:
    """Write the choice in a sentence."""
    floors = ", ".join(map(str, result.sensors))
    everywhere = len(result.sensors) == result.model.design.stories
    where = "every floor" if everywhere else f"floor{'s' * (len(result.sensors) > 1)} {floors}"
    return f"Measure {where} in {counted(len(result.tests), 'test')}, for {result.goal}."


def sure(result: Plan) -> str:
    """State the objective and the largest possible distance of the choice from the optimum."""
    unit = "of the effects' sizes" if result.apart else "relative"
    said = f"{result.measure} ({result.criterion}): {percent(result.objective)} {unit}"
    if result.objective >= UNKNOWN_STD:
        said = f"{result.measure} ({result.criterion}): open, {percent(UNKNOWN_STD, 0)} {unit} or more"
    if len(result.sensors) == result.model.design.stories:
        return said
    if result.chosen.arbitrary:
        return f"{said}; every choice of as many floors gives the same within 1 %: the floors named are arbitrary"
    if result.gap < PROVEN:
        return f"{said}; every choice of as many floors was looked at, none is better"
    if not np.isfinite(result.gap):
        return f"{said}; the convex program gives no bound"
    if result.bound >= UNKNOWN_STD:
        return f"{said}; no choice of as many floors is better than open"
    gap = "" if result.objective >= UNKNOWN_STD else f" (gap {percent(result.gap, 1)})"
    return f"{said}; no choice of as many floors is below {percent(result.bound)}{gap}"


def cautions(result: Plan) -> list[Sentence]:
    """State the limits of the predicted accuracy: averages over frames, and assumptions about the frame."""
    said = []
    if result.frames > 1:
        said.append(
            f"The design values are vague: what is promised is an average over {result.frames} frames that they allow."
        )
    if result.model.design.effects:
        labels = ", ".join(placed.label for placed in result.model.design.effects)
        state = "" if result.model.design.state is None else f' in state "{result.model.design.state}"'
        said.append(f"The frame is tested{state} with what was found in it: {labels}.")
    worst = result.misfit
    if worst is not None:
        said.append(
            f'The frame of this plan has mode {worst.mode} of "{worst.configuration}" at {significant(worst.expected)} '
            f"Hz; {significant(worst.measured)} Hz were measured ({percent(worst.error)}). The shear model lacks "
            "something: --loop plans for the frame with the effects that the loop finds."
        )
    return [Sentence(each) for each in said]


def grid(result: Plan) -> list[Sentence]:
    """State the bound on tests from the grid of added masses, if the masses were chosen."""
    if result.grid_bound is None:
        return []
    if result.arbitrary_masses:
        return [Sentence("Every choice of added masses gives the same within 1 %: the masses named are arbitrary.")]
    said = (
        "With these sensors, masses of the limit or half of it on one floor, on all floors or on either half reach "
        f"{_value(result.grid_bound)} at best."
    )
    return [Sentence(said)]


def expected_modes(result: Plan) -> Table:
    """Tabulate the modes of the first test, and their expected accuracy if it differs between modes."""
    modes = result.expected_modes
    given = {
        "mode": [str(each.mode) for each in modes],
        "frequency, Hz": [significant(each.frequency) for each in modes],
        "std of it": percents([each.frequency_std for each in modes]),
        "std of a shape's entry": percents([each.mode_shape_std for each in modes]),
        "std of damping": percents([each.damping_std for each in modes]),
    }
    # The sentence about the noise gives every value that is equal for all modes.
    shown = {name: cells for name, cells in given.items() if name == "mode" or len(set(cells)) > 1}
    return table("expected-modes", f"expected modes ({result.names[0]})", shown)


def added_masses(result: Plan, units: Units) -> Table:
    """Tabulate the added mass of each test, the top floor first."""
    # People place these masses by hand; the default unit is kg for every size.
    factor, unit = (1.0, "kg") if units.mass is None else units.of_mass(np.concatenate(result.tests).tolist())
    rows = []
    for floor in range(result.model.design.stories, 0, -1):
        masses = (significant(float(test[floor - 1]) / factor) for test in result.tests)
        rows.append((str(floor), *masses, "x" if floor in result.sensors else ""))
    return Table("added-mass", f"tests: added mass, {unit}", ("floor", *result.names, "sensor"), plain_rows(rows))


def verdicts(result: Plan) -> Table:
    """Tabulate how clearly the data separate each effect from the case without effects and from other effects."""
    return table("verdicts", "probability of the right verdict", {
        "if it is": [each.label for each in result.apart],
        "expected size": [f"{significant(each.size, 3)} {each.unit or ''}".rstrip() for each in result.apart],
        "std from none": [significant(each.distance, 3) for each in result.apart],
        "most like": [each.nearest or "–" for each in result.apart],
        "std from that": [significant(each.nearest_distance, 3) for each in result.apart],
        "right verdict": [percent(each.probability, 0) for each in result.apart],
    }, words=(0, 3))  # fmt: skip


def conclusions(result: Plan) -> list[Sentence]:
    """State for each effect in one sentence whether the tests suffice."""
    return [
        Sentence(
            f"{each.label}: these tests {'can' if each.suffices else 'are not enough to'} show it; the right verdict "
            f"comes with {percent(each.probability, 0)} probability, {percent(SUFFICES, 0)} are needed"
        )
        for each in result.apart
        if each.size is not None
    ]


def accuracy(result: Plan, units: Units) -> Table:
    """Tabulate the expected deviations of masses and stiffnesses: as planned, one sensor fewer or more, all floors."""
    design = result.model.design
    words = ("as planned", "one less", "one more", "all floors")
    options = zip(words, (result.chosen, result.fewer, result.more, result.everywhere), strict=True)
    shown = [(name, each) for name, each in options if each is not None]
    names = tuple(name for name, _ in shown)
    units = dataclasses.replace(units, relative=True) if design.frame.total_mass_placeholder else units
    mass_factor, mass_unit = units.of_mass(design.floor_mass.tolist())
    factor, unit = units.of_stiffness(design.story_stiffness.tolist())
    rows = []
    for i in reversed(range(design.stories)):
        mass, stiffness = float(design.floor_mass[i]), float(design.story_stiffness[i])
        of_mass = (_std(each.floor_mass_std, i, mass) for _, each in shown)
        of_stiffness = (_std(each.story_stiffness_std, i, stiffness) for _, each in shown)
        sizes = significant(mass / mass_factor), significant(stiffness / factor)
        rows.append((str(i + 1), sizes[0], *of_mass, sizes[1], *of_stiffness))
    head = ("floor / story", f"mass, {mass_unit}", *names, f"stiffness, {unit}", *names)
    return Table("accuracy-table", "expected standard deviations (of the shear model)", head, plain_rows(rows))


def _std(std: Floats, at: int, value: float) -> str:
    """Write a standard deviation, relative."""
    if np.isnan(std[at]):
        return "open"
    return "exact" if std[at] < 1e-9 * value else percent(float(std[at]) / value)


def _value(objective: float) -> str:
    """Write the criterion's standard deviation, relative."""
    return "open" if objective >= UNKNOWN_STD else percent(objective)


def counts(result: Plan) -> Table:
    """Tabulate the objective against the number of sensors."""
    options = (result.fewer, result.chosen, result.more, result.everywhere)
    by_count: dict[int, ExpectedAccuracy] = {len(each.floors): each for each in options if each is not None}
    shown = [by_count[count] for count in sorted(by_count)]
    everywhere = result.model.design.stories
    return table("counts", f"{result.measure}, by number of sensors", {
        "sensors": [str(len(each.floors)) for each in shown],
        "floors": ["all" if len(each.floors) == everywhere else ", ".join(map(str, each.floors)) for each in shown],
        "value": [_value(each.objective) for each in shown],
        "no choice below": [_value(each.bound) for each in shown],
    })  # fmt: skip
