"""Describe the measured and declared data."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.report.describe.vocabulary import Block, Document, Facts, Row, Section, Sentence, Table, describe, line
from cvxshear.util.quantities import AUTOMATIC, Units, counted, numbered, percents, significant
from cvxshear.util.typing import Floats

FLOOR_COLUMNS = 11
"""Largest number of floors in one table of measured modes, by the width of a page; more tables hold the other
floors."""


@describe.register
def _experiment(experiment: Experiment, units: Units = AUTOMATIC) -> Document:
    sections = declared(experiment, units), measured_modes(experiment, units)
    return Document(experiment.name, f"{experiment.name}: {_headline(experiment)}", sections)


@line.register
def _line(experiment: Experiment) -> str:
    return f"<Experiment {experiment.name}: {_headline(experiment)}>"


def _headline(experiment: Experiment) -> str:
    tests = [counted(len(experiment.configurations), "configuration")]
    if experiment.static:
        tests.append(counted(len(experiment.static), "static test"))
    return f"{counted(experiment.stories, 'story')}, {', '.join(tests)}"


def units_for(experiment: Experiment, units: Units) -> Units:
    """Choose the units: relative units if the total mass is unknown."""
    return dataclasses.replace(units, relative=True) if experiment.frame.total_mass_placeholder else units


def declared(experiment: Experiment, units: Units = AUTOMATIC) -> Section:
    """List the declarations of the frame, and each test in a line."""
    facts = Facts(tuple(_facts(experiment, units)))
    # All masses have one unit. A known mass of the frame determines this unit.
    sums = [float(each.added_mass.sum()) for each in experiment.configurations]
    mass = units.of_mass([*sums, experiment.frame.known_total or 0.0])
    head = ("configuration", "modes", "floors", "added mass", "noise")
    rows = tuple(_test(each, mass) for each in experiment.configurations)
    tests = Table("tests", "What was tested", head, rows, words=(0, 3, 4))
    return Section("declared", "Measured and declared", (facts, tests))


def _facts(experiment: Experiment, units: Units) -> Iterator[tuple[str, str]]:
    frame = experiment.frame
    yield "test", experiment.name
    yield "stories", str(experiment.stories)
    yield "story heights", "not declared" if frame.story_heights is None else listed(frame.story_heights, "m")
    if frame.total_mass_placeholder:
        yield "total mass", "not given: 1 stands for it, and masses and stiffnesses are relative to it"
    else:
        yield "total mass", f"{_total(experiment, units)}, without added mass" if frame.known_total else "not declared"
    if frame.reference is not None:
        yield "reference state", frame.reference
    for each in experiment.static:
        yield f'static test "{each.name}"', f"displacements of {counted(int(each.measured.sum()), 'floor')}"
    for prior in experiment.priors:
        yield "known beforehand", prior.describe().replace("_", " ")
    for expected in experiment.expected:
        yield "expected beforehand", expected.name.replace("_", " ")


def _total(experiment: Experiment, units: Units) -> str:
    total = experiment.frame.known_total
    assert total is not None
    factor, unit = units.of_mass([total])
    off = "" if experiment.frame.total_mass_std is None else f" ± {100 * experiment.frame.total_mass_std:g} %"
    return f"{total / factor:g} {unit}{off}"


def _test(each: Configuration, mass: tuple[float, str]) -> Row:
    floors = str(len(each.measured_floors)) if each.measured.any() else "none"
    return Row((each.name, str(len(each.frequencies)), floors, _added(each.added_mass, *mass), _noise(each)))


def _noise(each: Configuration) -> str:
    """Return whether the file states the standard deviations of the measured quantities."""
    stated = [each.frequency_std is not None]
    if each.measured.any():
        stated.append(each.mode_shape_std is not None)
    return "stated" if all(stated) else "partly stated" if any(stated) else "not stated"


def _added(mass: Floats, factor: float, unit: str) -> str:
    """Write the added mass and its floors."""
    floors = [int(place) + 1 for place in np.flatnonzero(mass)]
    if not floors:
        return "none"
    return f"{mass.sum() / factor:g} {unit} on {numbered('floor', floors)}"


def listed(values: Floats, unit: str, factor: float = 1.0) -> str:
    """Write the values, or one value if all are equal."""
    shown = [f"{value / factor:g}" for value in values]
    same = len(set(shown)) == 1 and len(shown) > 1
    return f"{shown[0]} {unit} each" if same else f"{', '.join(shown)} {unit}"


def measured_modes(experiment: Experiment, units: Units = AUTOMATIC) -> Section:
    """Tabulate the measured modes of every configuration."""
    parts: list[Block] = []
    for place, each in enumerate(experiment.configurations, 1):
        parts += _modes(each, place, units)
    return Section("modes", "Measured modes", tuple(parts), detail=True, below=True)


def _modes(each: Configuration, place: int, units: Units) -> Iterator[Block]:
    factor, unit = units.of_mass(each.added_mass.tolist())
    # The masses are listed by floor unless only one floor has added mass.
    single = np.count_nonzero(each.added_mass) < 2
    added = _added(each.added_mass, factor, unit) if single else listed(each.added_mass, unit, factor)
    doubt = "" if _noise(each) == "stated" else " Standard deviations that are not stated are the default's."
    yield Sentence(f"{each.name}. Added mass: {added}.{doubt}")
    largest = np.max(np.abs(np.where(each.measured, each.mode_shapes, 0.0)), axis=1, keepdims=True, initial=0.0)
    scale = np.where(largest > 0, largest, 1.0)
    shape_std = percents(np.max(each.entry_std / scale, axis=1, initial=0.0).tolist())
    frequency_std = percents([float(std) for std in each.log_frequency_std])
    floors = [f"floor {floor}" for floor in each.measured_floors]
    rows = []
    for j, mode in enumerate(each.modes):
        shape = ("–" if np.isnan(value) else f"{value:+.4f}" for value in each.mode_shapes[j] / scale[j])
        of_shape = shape_std[j] if each.measured[j].any() else "–"
        frequency = significant(float(each.frequencies[j]), 5)
        rows.append(Row((str(mode), frequency, frequency_std[j], *shape, of_shape)))
    head = ("mode", "frequency, Hz", "std", *floors, "std of the shape")
    title = "Shapes are scaled to a largest entry of 1" if floors else "Frequencies alone"
    yield from Table(f"modes-{place}", title, head, tuple(rows)).folded(FLOOR_COLUMNS)
