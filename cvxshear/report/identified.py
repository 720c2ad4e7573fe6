"""Describe the measured and declared data, and the identified frame with the fit of each configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from cvxshear.data import Frequencies, noise_kinds
from cvxshear.fit import results
from cvxshear.fit.turning_floors import TurningFrame
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.motions import THREE_MOTIONS
from cvxshear.programs.certificate import ActiveConstraint
from cvxshear.report import blocks
from cvxshear.util import quantities
from cvxshear.util.typing import Floats

if TYPE_CHECKING:
    from cvxshear.loop import LoopResult


@blocks.describe.register
def _experiment(experiment: Experiment) -> blocks.Document:
    counts = {"story": experiment.stories, "configuration": len(experiment.configurations)}
    counts |= {"static test": len(experiment.static)} if experiment.static else {}
    said = ", ".join(quantities.counted(number, noun) for noun, number in counts.items())
    section = declared(experiment, units_for(experiment))
    return blocks.Document(experiment.name, f"{experiment.name}: {said}", (section,))


def units_for(experiment: Experiment) -> quantities.Units:
    """Choose the units: relative units if the total mass is unknown."""
    return quantities.Units(relative=experiment.frame.total_mass_placeholder)


def declared(experiment: Experiment, units: quantities.Units) -> blocks.Section:
    """List the declarations of the frame, and each test in a line."""
    facts = blocks.Facts(tuple(_facts(experiment, units)))
    # All masses have one unit. A known mass of the frame determines this unit.
    sums = [float(each.added_mass.sum()) for each in experiment.configurations]
    mass = units.of_mass([*sums, experiment.frame.known_total or 0.0])
    head = ("configuration", "modes", "floors", "added mass", "noise")
    rows = (_test(each, mass) for each in experiment.configurations)
    tests = blocks.table_of_rows("tests", "What was tested", head, rows, words=(0, 3, 4))
    return blocks.section("declared", "Measured and declared", facts, tests, appendix=True)


def _facts(experiment: Experiment, units: quantities.Units) -> Iterator[tuple[str, str]]:
    frame = experiment.frame
    yield "test", experiment.name
    yield "stories", str(experiment.stories)
    yield "story heights", "not declared" if frame.story_heights is None else each_or_all(frame.story_heights, "m")
    if frame.total_mass_placeholder:
        yield "total mass", "not given: 1 stands for it, and masses and stiffnesses are relative to it"
    elif frame.known_total:
        factor, unit = units.of_mass([frame.known_total])
        off = "" if frame.total_mass_std is None else f" ± {100 * frame.total_mass_std:g} %"
        yield "total mass", f"{frame.known_total / factor:g} {unit}{off}, without added mass"
    else:
        yield "total mass", "not declared"
    if frame.reference is not None:
        yield "reference state", frame.reference
    for test in experiment.configurations:
        if test.repeats is not None:
            yield f'"{test.name}"', test.repeats.describe()
    for each in experiment.static:
        yield f'static test "{each.name}"', f"displacements of {quantities.counted(int(each.measured.sum()), 'floor')}"
    for prior in experiment.priors:
        yield "known beforehand", prior.describe().replace("_", " ")
    for expected in experiment.expected:
        yield "expected beforehand", expected.name.replace("_", " ")


def _test(each: Configuration, mass: tuple[float, str]) -> tuple[str, ...]:
    seen = {sensor.floor for sensor in each.sensors} if each.sensors else each.measured_floors
    floors = str(len(seen)) if each.measured.any() else "none"
    return each.name, str(len(each.frequencies)), floors, _added(each.added_mass, *mass), _noise(each)


def _noise(each: Configuration) -> str:
    """Return whether the file states the standard deviations of the measured quantities."""
    stated = [each.frequency_std is not None]
    if each.measured.any():
        stated.append(each.mode_shape_std is not None)
    return "stated" if all(stated) else "partly stated" if any(stated) else "not stated"


def _added(mass: Floats, factor: float, unit: str) -> str:
    """Write the added mass and its floors."""
    floors = [int(place) + 1 for place in np.flatnonzero(mass)]
    return f"{mass.sum() / factor:g} {unit} on {quantities.numbered('floor', floors)}" if floors else "none"


def each_or_all(values: Floats, unit: str) -> str:
    """Write the values, or one value if all are equal."""
    shown = [f"{value:g}" for value in values]
    same = len(set(shown)) == 1 and len(shown) > 1
    return f"{shown[0]} {unit} each" if same else f"{', '.join(shown)} {unit}"


#: Plurals of the quantities with one value for each floor or story.
PLURALS = {
    "floor_mass": "floor masses", "story_stiffness": "story stiffnesses", "inertia": "inertias",
    **{f"{center}_center_{axis}": f"{center} centers {axis}" for center in ("mass", "stiffness") for axis in "xy"},
    **{name: name.replace("_stiffness", " stiffnesses") for name in THREE_MOTIONS.stiffness_names},
}  # fmt: skip


def in_words(names: Iterable[str]) -> str:
    """Write names of parameters in words: "story stiffnesses 1 to 4 and floor mass 2".

    Parameters
    ----------
    names : iterable of str
        Names such as "story_stiffness 3"; other names, such as "gravity: gamma", stay unchanged.
    """
    places: dict[str, list[int]] = {}
    for name in names:
        kind, _, place = name.rpartition(" ")
        known = kind in PLURALS and place.isdecimal()
        places.setdefault(kind if known else name, []).extend([int(place)] if known else [])
    said = []
    for kind, at in places.items():
        plain = (PLURALS[kind] if len(at) > 1 else kind).replace("_", " ")
        said.append(f"{plain} {quantities.ranged(sorted(at))}" if at else plain)
    return quantities.listed(said)


def frame_table(
    frame: results.IdentifiedFrame, title: str, units: quantities.Units, key: str = "identified"
) -> blocks.Table:
    """Tabulate floor masses, their sum and story stiffnesses, the top first; values at a bound have no deviation."""
    columns = [blocks.places(len(frame.floor_mass), "floor / story", "floor")]
    turns = isinstance(frame, TurningFrame)
    plain = (
        (name, unit, getattr(frame, name), getattr(frame, f"{name}_std"))
        for name, unit in results.UNITS_OF_FRAME.items()
    )
    for name, unit, values, std in frame.columns if isinstance(frame, TurningFrame) else plain:
        known = {"kg": units.of_mass, "N/m": units.of_stiffness}.get(unit)
        factor, shown = known(values.tolist()) if known else quantities.fitting(values.tolist(), unit)
        at_bound = frame.stopped(name)
        texts = (
            f"{quantities.significant(value / factor, 5)} (at a bound)" if stopped else text
            for value, text, stopped in zip(values.tolist(), _column(values, std, factor), at_bound, strict=True)
        )
        head = f"{name.removeprefix('story_').removeprefix('floor_').replace('_', ' ')}, {shown}"
        columns.append(blocks.exact(name, values, np.where(at_bound, np.nan, std), unit, head, texts))
    factor, _ = units.of_mass(frame.floor_mass.tolist())
    foot = ("sum", quantities.significant(float(frame.floor_mass.sum()) / factor, 5), "")
    return blocks.Table(key, title, tuple(columns), foot=() if turns else foot, top_first=True)


def turning_words(frame: results.IdentifiedFrame) -> Iterator[blocks.Sentence]:
    """State what data of floors that turn leave open, and what tells it."""
    if not isinstance(frame, TurningFrame):
        return
    if frame.unseen:
        unseen = quantities.listed(frame.unseen)
        yield from blocks.warnings(
            [f"No sensor sees {unseen}: the floors are taken as symmetric, so that it moves by itself."]
        )
    for group in frame.undetermined:
        yield blocks.Sentence(f"Not determined: {in_words(group)}.", "warning")
        if {name.rpartition(" ")[0] for name in group} == {"inertia", "story_stiffness rr"}:
            yield blocks.Sentence(
                "No eccentricity couples the rotations with the displacements, so all inertias have an open factor; a "
                "plan in [frame], or a known added mass off the center, tells it."
            )


def frames_table(result: results.Identification) -> blocks.Table:
    """Tabulate the frames of all parts for programs, each part by the name of its configuration."""
    tables = [frame_table(part.frame, "", quantities.AUTOMATIC) for part in result.parts]
    names = tuple(part.name for part in result.parts for _ in part.frame.floor_mass)
    columns = [blocks.Column("configuration", names, name="configuration", values=names)] if len(tables) > 1 else []
    for same in zip(*(each.columns for each in tables), strict=True):
        values = (value for each in same for value in each.values)
        std = np.concatenate([each.std or () for each in same]) if same[0].std else None
        columns.append(blocks.exact(same[0].name, values, std, same[0].unit, same[0].head))
    return blocks.Table("frame", "Identified frame", tuple(columns))


def frequencies_table(experiment: Experiment, predictions: Iterable[results.Prediction]) -> blocks.Table:
    """Tabulate every measured frequency beside that of the model."""
    rows = []
    for item in predictions:
        configuration = next(each for each in experiment.configurations if each.name == item.configuration)
        for mode, measured in zip(item.modes.tolist(), configuration.frequencies.tolist(), strict=True):
            modelled = float(item.frequencies[mode - 1])
            rows.append((configuration.name, mode, measured, modelled, modelled / measured - 1))
    names, modes, measured, model, errors = zip(*rows, strict=True)
    columns = (
        blocks.Column("configuration", names, words=True, name="configuration", values=names),
        blocks.Column("mode", tuple(map(str, modes)), name="mode", values=modes),
        *(
            blocks.exact(name, each, None, "Hz", f"{name}, Hz", (quantities.significant(value, 5) for value in each))
            for name, each in (("measured", measured), ("model", model))
        ),
        blocks.exact("relative_error", errors, None, "", "error", quantities.percents(errors, sign=True)),
    )
    return blocks.Table("modes", "Measured and modelled frequencies", columns)


def in_one_unit(
    values: Floats, stds: Floats, unit_of: Callable[[Iterable[float]], tuple[float, str]]
) -> tuple[list[str], str]:
    """Write values and their standard deviations in one unit; values without any standard deviation have one format.

    Parameters
    ----------
    values, stds : ndarray, shape (N,)
    unit_of : callable
        Function that chooses the size and the name of a unit for values, such as `Units.of_mass`.

    Returns
    -------
    written : list of str
    unit : str
    """
    factor, unit = unit_of(values.tolist())
    return _column(values, stds, factor), unit


def _column(values: Floats, stds: Floats, factor: float) -> list[str]:
    # A fixed value has no deviation; all fixed values have one format.
    fixed = ~np.isnan(values) & ~(stds > quantities.NEGLIGIBLE_STD * np.abs(values))
    shown = iter(_short(quantities.significants((values[fixed] / factor).tolist(), 5)))
    return [
        next(shown) if alone else quantities.with_std(value, std, factor=factor)
        for value, std, alone in zip(values.tolist(), stds.tolist(), fixed, strict=True)
    ]


def _short(written: list[str]) -> list[str]:
    """Remove trailing decimals that are 0 in all texts."""
    while written and all("." in text and text.endswith(("0", ".")) for text in written):
        written = [text[:-1] for text in written]
    return written


#: Smallest p-value of chi-square for a plausible model; 1 minus this value is the largest for a plausible noise.
RULED_OUT = 1e-3


def generous_noise(fit: results.Quality) -> Iterator[str]:
    """Warn if the residual is much smaller than the stated noise predicts.

    Parameters
    ----------
    fit : Quality
    """
    if fit.p_value is not None and fit.p_value > 1 - RULED_OUT:
        size = quantities.significant(math.sqrt(fit.dof / max(fit.chi2, 1e-9)), 2)
        yield (
            f"the residual is {size} times smaller than the stated standard deviations ({_chi_square(fit)}): either "
            "they are too large, and so are those of masses and stiffnesses, or they include errors that all data "
            "share, such as the calibration of a sensor; those that 'modes' writes do"
        )


def _chi_square(fit: results.Quality) -> str:
    freedom = f"{quantities.counted(fit.dof, 'degree')} of freedom"
    return f"chi-square {quantities.significant(fit.chi2)} on {freedom}"


@blocks.describe.register
def _identification(result: results.Identification) -> blocks.Document:
    units = units_for(result.experiment)
    open_ones = blocks.warnings(f"Not determined: {in_words(names)}." for names in result.undetermined)
    sections = (
        declared(result.experiment, units),
        *(part_section(result, part, place, units) for place, part in enumerate(result.parts, 1)),
        other_frames_section(result, units),
        blocks.section("undetermined", "What these data cannot tell", *open_ones),
    )
    predicted = [item for part in result.parts for item in part.predictions]
    data = frames_table(result), frequencies_table(result.experiment, predicted)
    title = result.experiment.report.title or result.experiment.name
    stories = quantities.counted(result.experiment.stories, "story")
    worst = quantities.percent(max(part.fit.max_frequency_error for part in result.parts))
    ended = "" if result.converged else ", not converged"
    line = f"{title}: {result.method}, {stories}, largest frequency error {worst}{ended}"
    return blocks.Document(title, _identification_headline(result), sections, data, line, "Identified frame")


def other_frames_section(result: results.Identification | LoopResult, units: quantities.Units) -> blocks.Section:
    """Tabulate the other frames that fit the data, the most probable first; without parts if there is none."""
    title, frames = "Other frames that fit as well", result.other_frames
    if not frames:
        return blocks.section("other-frames", title)
    mass_factor, mass_unit = units.of_mass(result.frame.floor_mass.tolist())
    factor, unit = units.of_stiffness(result.frame.story_stiffness.tolist())
    test = result.others.next_test
    remedy = "Shapes at two floors or more tell them apart."
    if test is not None:
        others = "the nearest of the other frames" if test.tells_all else "the nearest that added mass tells from it"
        remedy = (
            f"{put_more(test, units)}: the identified frame would then differ from {others} by "
            f"{test.standard_deviations:.1f} standard deviations. {remedy[:-1]} too."
        )
    warning = (
        f"These data fit {len(frames) + 1} frames; a standard deviation above describes the identified one alone. "
        f"{remedy} Searched: {result.others.searched}."
    )
    found = blocks.table("other-frames", "From the lowest floor or story up", {
        f"floor masses, {mass_unit}": [_all(each.floor_mass, mass_factor) for each in frames],
        f"story stiffnesses, {unit}": [_all(each.story_stiffness, factor) for each in frames],
        "chi-square": [quantities.significant(each.chi2, 3) for each in frames],
        "probability": [quantities.percent(each.probability) for each in frames],
    }, words=(0, 1))  # fmt: skip
    return blocks.section("other-frames", title, blocks.Sentence(warning, "warning"), found)


def put_more(test: results.NextTest, units: quantities.Units) -> str:
    """Propose a test with more added mass: the beginning of a sentence."""
    factor, unit = units.of_mass([test.added_mass])
    mass = f"{quantities.significant(test.added_mass / factor, 3)} {unit}"
    return f'Put {mass} more on floor {test.floor} of "{test.state}" and measure again'


def _all(values: Floats, factor: float) -> str:
    return ", ".join(quantities.significant(float(value) / factor, 4) for value in values)


def _identification_headline(result: results.Identification) -> str:
    """Name the frame and the method; put a warning first if the stated noise rules the model out."""
    how = f"method {result.method}, backend {result.backend}"
    fit = result.parts[0].fit
    if not result.joint or fit.p_value is None or fit.p_value >= RULED_OUT:
        return f"{result.experiment.name}: {how}"
    return (
        f"RULED OUT: with the stated noise a shear frame would hardly give these data ({_chi_square(fit)}, "
        f"{quantities.equals(fit.p_value)}): the masses and stiffnesses below are those of a wrong model, and their "
        "standard deviations too small. 'cvxshear loop' on the same file looks for what the model lacks. "
        f"({result.experiment.name}: {how})"
    )


def part_section(
    result: results.Identification, part: results.SingleIdentification, place: int, units: quantities.Units
) -> blocks.Section:
    """Tabulate the frame that one or all configurations give, and its fit."""
    title = "All configurations together" if result.joint else part.name
    frame = frame_table(part.frame, "Identified frame (masses without added mass)", units, key=f"identified-{place}")
    parts = [
        # A value with its deviation takes half as much again of the width; floors come first, then stories.
        *frame.folded(2 * blocks.PAGE_COLUMNS // 3),
        *turning_words(part.frame),
        *blocks.warnings(_bounds(part)),
        *_prices(part, place, units),
        *how_it_ended(part),
        *([] if part.mass_matrix is None else [_matrix(part.mass_matrix, place, units)]),
        _fit(part),
        *blocks.warnings(blocks.sentences(generous_noise(part.fit))),
    ]
    return blocks.section(f"part-{place}", title, *parts)


def _bounds(part: results.SingleIdentification) -> Iterator[str]:
    """Warn of parameters that a bound holds."""
    if part.frame.at_bounds:
        are = "is" if len(part.frame.at_bounds) == 1 else "are"
        yield (
            f"{quantities.capital(in_words(part.frame.at_bounds))} {are} at a bound, a declared one or the least that "
            "counts as positive; the data alone lead beyond it. That is no measurement, and the other standard "
            "deviations hold only as far as the bound is true."
        )


def _prices(part: results.SingleIdentification, place: int, units: quantities.Units) -> Iterator[blocks.Block]:
    """List the active bounds and exact priors, each with its dual value."""
    if part.active:
        misfit = "the objective of the program" if part.name else "chi-square with the noise of the fit"
        yield blocks.Sentence(f"Active bounds and exact priors with their prices (the misfit is {misfit}):", "strong")
        yield blocks.Points(f"active-{place}", tuple(_price(held, units) for held in part.active))


def _price(held: ActiveConstraint, units: quantities.Units) -> str:
    """State the change of the misfit for one more unit on the right side of a constraint."""
    about = f"{held.name} {held.source}"
    known = {} if units.relative else results.UNITS_OF_FRAME
    unit = next((unit for quantity, unit in known.items() if quantity in about), "unit")
    if held.constraint == "lmi":
        # Its dual matrix has an entry for each pair of motions; the report names the inequality.
        return f"{held.name} is at the least that counts as positive: the data alone would have less"
    at_bound = held.constraint in ("lower", "upper")
    where = f"the {held.constraint} bound of {in_words([held.name])}" if at_bound else "the right side"
    change = f"{'lower' if held.dual > 0 else 'raise'} the misfit by {quantities.significant(abs(held.dual), 3)}"
    return f"{held.source or held.name}: one more {unit} on {where} would {change}"


def how_it_ended(part: results.SingleIdentification) -> Iterator[blocks.Sentence]:
    """State the number of iterations and the reason of their end; warn if the fit did not converge."""
    said = f"{quantities.counted(part.iterations, 'iteration')}: {part.reason}."
    stopped = f"NOT CONVERGED. {said} The numbers are where it stopped."
    yield blocks.Sentence(said) if part.converged else blocks.Sentence(stopped, "warning")


def _fit(part: results.SingleIdentification) -> str:
    fit = part.fit
    largest, rms = quantities.percents([fit.max_frequency_error, fit.rms_frequency_error])
    said = [f"Frequency errors: largest {largest}, root mean square {rms}"]
    for figure in (each for kind in noise_kinds().values() for each in kind.figures if kind is not Frequencies.noise):
        if (error := fit.errors[figure.key]) is not None:
            value = quantities.percent(error) if figure.relative else quantities.significant(error, 6)
            said.append(f"{figure.label} {value}")
    test = "" if fit.p_value is None else f" ({quantities.equals(fit.p_value)})"
    return f"{'; '.join([*said, _chi_square(fit)])}{test}."


def _matrix(matrix: Floats, place: int, units: quantities.Units) -> blocks.Table:
    factor, unit = units.of_mass(np.diag(matrix).tolist())
    cells = np.reshape(quantities.significants((matrix / factor).ravel().tolist(), 5), matrix.shape).tolist()
    floors = [str(floor) for floor in range(1, len(matrix) + 1)]
    rows = ((floor, *row) for floor, row in zip(floors, cells, strict=True))
    title = f"Corrected mass matrix, {unit}"
    return blocks.table_of_rows(f"mass-matrix-{place}", title, ("floor", *floors), rows)
