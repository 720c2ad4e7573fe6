"""Describe histories, planned tests, the recomputed figures of the paper, the noise study, and compared backends."""

import math
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from cvxshear.backends import Comparison, ProgramKind
from cvxshear.backends.benchmark import BackendResult
from cvxshear.fit.results import UNITS_OF_FRAME
from cvxshear.paper import reproduction as printed
from cvxshear.paper.scatter import NoiseStudy, Scatter
from cvxshear.planning.design import UNKNOWN_STD
from cvxshear.planning.planner import ExpectedAccuracy, Plan
from cvxshear.report import blocks
from cvxshear.report.identified import put_more, units_for
from cvxshear.screening import History
from cvxshear.util import quantities
from cvxshear.util.typing import Floats


@blocks.describe.register
def _history(result: History) -> blocks.Document:
    skipped = blocks.warnings(f"skipped: {each}" for each in result.skipped)
    sections = (
        blocks.section("changes", "Changes of stiffness", *_changes(result), *skipped),
        blocks.section("tests", "The tests", *history_data(result).folded(blocks.PAGE_COLUMNS)),
    )
    title, tests = result.loop.experiment.name, quantities.counted(len(result.fitted), "test")
    said = [
        f"{'perhaps ' if each.probability < quantities.SURE else ''}{each.text} "
        f"({quantities.chance(each.probability)} probable)"
        for each in result.changes
    ]
    headline = f"{title}, {tests}: {'; '.join(said) or 'no change is more than scatter'}"
    return blocks.Document(title, headline, sections, (history_data(result),), heading="History of a frame")


def _changes(result: History) -> Iterator[blocks.Block | str]:
    """Tabulate the changes with their rivals, and state the noise."""
    if result.loop.provisional:
        yield blocks.Sentence("A significant residual is left, so that every change is provisional.", "warning")
    if result.changes:
        units = {"temperature": "% per °C", "amplitude": "% per factor of ten"}
        sizes = [(each.size, each.std, units.get(each.kind, "%")) for each in result.changes]
        cells = {
            "kind": [each.kind for each in result.changes],
            "story": [str(each.story or "all") for each in result.changes],
            "from": [each.test or "" for each in result.changes],
            "change of stiffness": [quantities.with_std(*each, factor=0.01) for each in sizes],
            "probability": [quantities.chance(each.probability) for each in result.changes],
            "or from": [", ".join(each.other_tests) for each in result.changes],
            "or in its place": [", ".join(each.rivals) for each in result.changes],
        }
        told = {head: texts for head, texts in cells.items() if any(texts)}
        words = tuple(place for place, head in enumerate(told) if head not in ("change of stiffness", "probability"))
        yield blocks.table("changes-table", "", told, words=words)
    yield f"It rests on {result.loop.rests_on[0]}; masses are the same in all tests."
    yield from blocks.sentences(result.loop.information)


def history_data(result: History) -> blocks.Table:
    """Tabulate date, temperature, amplitude, frequencies, damping and stiffnesses of every test."""
    tests = result.loop.experiment.configurations
    names = tuple(each.name for each in tests)
    columns = [blocks.Column("test", names, words=True, name="test", values=names)]
    for key, unit in (("date", ""), ("temperature", "°C"), ("amplitude", "")):
        values = tuple(getattr(each, key) for each in tests)
        if None not in values:
            texts = values if key == "date" else tuple(map(quantities.significant, values))
            head = f"{key}, {unit}" if unit else key
            columns.append(blocks.Column(head, texts, name=key, values=values, unit=unit))
    for key, name, head, unit, scale in (
        ("frequencies", "frequency", "mode {}, Hz", "Hz", 1.0),
        ("damping_ratios", "damping_ratio", "damping {}, %", "", 100.0),
    ):
        for mode, found in result.by_mode(key).items():
            values = tuple(found.tolist())
            texts = tuple(quantities.significants([scale * value for value in values], 4))
            columns.append(blocks.Column(head.format(mode), texts))
            columns.append(blocks.exact(f"{name}_{mode}", values, unit=unit))
    factor, unit = units_for(result.loop.experiment).of_stiffness(result.story_stiffness.ravel().tolist())
    for story, both in enumerate(zip(result.story_stiffness.T, result.story_stiffness_std.T, strict=True), 1):
        pairs = zip(*(each.tolist() for each in both), strict=True)
        written = [quantities.with_std(value, std, factor=factor) for value, std in pairs]
        columns.append(blocks.exact(f"story_stiffness_{story}", *both, "N/m", f"story {story}, {unit}", written))
    return blocks.Table("history", "Measured modes, and the stiffnesses of each test alone", tuple(columns))


@blocks.describe.register
def _plan(result: Plan) -> blocks.Document:
    design, noise = result.model.design, f"Expected noise: {result.model.noise.words}."
    modes = blocks.table("expected-modes", f"expected modes ({result.names[0]})", {
        "mode": [str(each["mode"]) for each in result.expected_modes],
        "frequency, Hz": quantities.significants([each["frequency"] for each in result.expected_modes]),
    })  # fmt: skip
    everywhere = len(result.sensors) == design.stories
    where = "every floor" if everywhere else quantities.numbered("floor", result.sensors)
    headline = f"Measure {where} in {quantities.counted(len(result.tests), 'test')}, for {result.goal}."
    sections = [
        blocks.section("choice", "", typical(result), *other_frames(result), sure(result), noise),
        blocks.section("tests", "The tests", modes, added_masses(result), grid(result)),
        blocks.section("accuracy", "What they will determine", accuracy(result), remedies(result), counts(result)),
    ]
    return blocks.Document(design.name, headline, tuple(sections), (floors_data(result),), heading="Planned test")


def floors_data(result: Plan) -> blocks.Table:
    """Tabulate design values, expected standard deviations and added masses of every floor, for programs."""
    design, std = result.model.design, result.chosen.std
    numbers = blocks.places(design.stories, "floor", "floor")
    columns = [
        numbers,
        blocks.exact("sensor", (floor in result.sensors for floor in numbers.values)),
        *(blocks.exact(name, getattr(design, name), std[name], unit) for name, unit in UNITS_OF_FRAME.items()),
        *(blocks.exact(f"added_mass_kg: {name}", mass) for name, mass in zip(result.names, result.tests, strict=True)),
    ]
    return blocks.Table("floors", "Plan", tuple(columns))


def typical(result: Plan) -> str:
    """State the typical deviation of a floor and of a story, and what would lower it most."""
    mass, stiffness = map(_value, result.typical_std)
    said = f"Expected deviation (root mean square): floor mass {mass}, story stiffness {stiffness}."
    if not result.remedies:
        return said
    name, after = min(result.remedies.items(), key=lambda each: each[1][0] ** 2 + each[1][1] ** 2)
    if max(after) >= UNKNOWN_STD:
        return said
    return f"{said} Most would help: {name} ({' and '.join(map(_value, after))})."


def remedies(result: Plan) -> blocks.Table:
    """Tabulate the typical deviations after each thing that would lower them, the cheapest first."""
    rows = [("as planned", result.typical_std), *result.remedies.items()]
    return blocks.table("remedies", "what would lower the typical deviations", {
        "change": [name for name, _ in rows],
        "floor mass": [_value(mass) for _, (mass, _) in rows],
        "story stiffness": [_value(stiffness) for _, (_, stiffness) in rows],
    }, words=(0,))  # fmt: skip


def other_frames(result: Plan) -> Iterator[blocks.Sentence]:
    """Say that several frames will fit the planned tests, and which further test tells them apart."""
    others, relative = result.other_frames, result.model.design.frame.total_mass_placeholder
    if others.frames and result.objective < UNKNOWN_STD:
        remedy = "Shapes at two floors or more tell them apart."
        if others.next_test is not None:
            test = put_more(others.next_test, quantities.Units(relative=relative))
            remedy = f"{test} to tell them apart, or measure shapes at two floors or more."
        said = f"These tests will fit {len(others.frames) + 1} frames of which one is the design. {remedy}"
        yield blocks.Sentence(said, "warning")


def sure(result: Plan) -> str:
    """State the objective and the largest possible distance of the choice from the optimum."""
    unknown = f", {quantities.percent(UNKNOWN_STD, 0)} or more" if result.objective >= UNKNOWN_STD else ""
    said = f"{quantities.capital(result.measure)} (criterion {result.criterion}): {_value(result.objective)}{unknown}"
    if len(result.sensors) == result.model.design.stories:
        return said
    if result.floors_arbitrary:
        return f"{said}; every choice of as many floors gives the same within 1 %: the floors named are arbitrary"
    if result.gap < quantities.NEGLIGIBLE_STD:
        return f"{said}; every choice of as many floors was looked at, none is better"
    if not np.isfinite(result.gap):
        return f"{said}; the convex program gives no bound"
    gap = "" if result.objective >= UNKNOWN_STD else f" (gap {quantities.percent(result.gap, 1)})"
    return f"{said}; no choice of as many floors is better than {_value(result.bound)}{gap}"


def grid(result: Plan) -> str:
    """State the bound on tests from the grid of added masses, if the masses were chosen."""
    if result.of_grid is None:
        return ""
    if result.of_grid.arbitrary:
        return "Every choice of added masses gives the same within 1 %: the masses named are arbitrary."
    return (
        "With these sensors, no tests with the largest added mass or half of it, on one floor, all floors or either "
        f"half of them, get below {_value(result.of_grid.bound)}."
    )


def added_masses(result: Plan) -> blocks.Table:
    """Tabulate the added mass of each test, the top floor first."""
    rows = []
    for floor in range(result.model.design.stories, 0, -1):
        masses = (quantities.significant(float(test[floor - 1])) for test in result.tests)
        rows.append((str(floor), *masses, "x" if floor in result.sensors else ""))
    return blocks.table_of_rows("added-mass", "tests: added mass, kg", ("floor", *result.names, "sensor"), rows)


def accuracy(result: Plan) -> blocks.Table:
    """Tabulate the expected deviations of masses and stiffnesses, the top first."""
    design, chosen = result.model.design, result.chosen
    units = quantities.Units(relative=design.frame.total_mass_placeholder)
    mass_factor, mass_unit = units.of_mass(design.floor_mass.tolist())
    factor, unit = units.of_stiffness(design.story_stiffness.tolist())
    return blocks.table("accuracy-table", "expected standard deviations (of the shear model)", {
        "floor / story": [str(i) for i in range(1, design.stories + 1)],
        f"mass, {mass_unit}": [quantities.significant(value / mass_factor) for value in design.floor_mass.tolist()],
        "std of mass": [_value(each) for each in chosen.floor_mass_std / design.floor_mass],
        f"stiffness, {unit}": [quantities.significant(value / factor) for value in design.story_stiffness.tolist()],
        "std of stiffness": [_value(each) for each in chosen.story_stiffness_std / design.story_stiffness],
    }, top_first=True)  # fmt: skip


def _value(std: float) -> str:
    """Write a relative standard deviation."""
    if np.isnan(std) or std >= UNKNOWN_STD:
        return "open"
    return "exact" if std < quantities.NEGLIGIBLE_STD else quantities.percent(std)


def counts(result: Plan) -> blocks.Table:
    """Tabulate the objective against the number of sensors."""
    options = (result.fewer, result.chosen, result.more, result.everywhere)
    by_count: dict[int, ExpectedAccuracy] = {len(each.floors): each for each in options if each is not None}
    shown = [by_count[count] for count in sorted(by_count)]
    everywhere = result.model.design.stories
    return blocks.table("counts", f"{result.measure}, by number of sensors", {
        "sensors": [str(len(each.floors)) for each in shown],
        "floors": ["all" if len(each.floors) == everywhere else ", ".join(map(str, each.floors)) for each in shown],
        "value": [_value(each.choice.value) for each in shown],
        "no choice below": [_value(each.choice.bound) for each in shown],
    })  # fmt: skip


#: Number of decimals of a recomputed figure beyond the printed ones: the reader can see the rounding.
MORE_DIGITS = 2

Cells = tuple[str, ...]


@blocks.describe.register
def _reproduction(result: printed.Reproduction) -> blocks.Document:
    parts = tuple(
        blocks.section(f"section-{place}", section.title, printed_beside_recomputed(section), *section.notes)
        for place, section in enumerate(result.sections, 1)
    )
    summary = blocks.section("summary", "", result.summary)
    return blocks.Document("the paper's figures", "The paper's figures beside recomputed ones.", (*parts, summary))


def printed_beside_recomputed(section: printed.PaperSection) -> blocks.Table:
    """Tabulate one section of the paper; each place in the paper is named once."""
    random = any(row.std_error is not None for row in section.rows)
    errors = ("its standard error",) if random else ()
    head = ("where", "what", "printed", "recomputed", *errors, "difference", "agreement")
    rows = [
        (row.where if place == 0 or row.where != section.rows[place - 1].where else "", *_cells(row, random=random))
        for place, row in enumerate(section.rows)
    ]
    return blocks.table_of_rows(section.title, "", head, rows, words=(0, 1, len(head) - 1))


def _cells(row: printed.PaperRow, *, random: bool) -> Cells:
    if row.printed.startswith("about"):
        return row.what, row.printed, f"{row.recomputed:.2f}", f"{row.std_error or 0.0:.2f}", "", row.verdict
    count = printed.decimals(row.printed)
    # A count of iterations has no decimals.
    more = 0 if row.what == "iterations" or random else MORE_DIGITS
    error = (f"{row.std_error:.{count}f}" if row.std_error is not None else "",) if random else ()
    return (
        row.what, row.printed, quantities.signed(row.recomputed, count + more).removeprefix("+"), *error,
        quantities.signed(row.difference, count + more), row.verdict,
    )  # fmt: skip


@blocks.describe.register
def _study(result: NoiseStudy) -> blocks.Document:
    levels = [list(alike) for _, alike in groupby(result.scatters, key=lambda each: each.setup)]
    tables = tuple(noise_level(alike, place) for place, alike in enumerate(levels, 1))
    levels_section = blocks.section("levels", "Scatter", *tables, note(result))
    setups = quantities.counted(len({id(each.setup) for each in result.scatters}), "setup")
    methods = ", ".join(dict.fromkeys(each.method for each in result.scatters))
    headline = f"{setups}, {quantities.counted(result.samples, 'sample')} each, by {methods}"
    data = (scatter_data(result),)
    return blocks.Document("noise study", headline, (levels_section,), data, heading="Scatter under noise")


def scatter_data(result: NoiseStudy) -> blocks.Table:
    """Tabulate the relative scatter of every mass and stiffness by setup and method, for programs."""
    rows = [
        (each.setup.name, each.setup.mode_shape_std, each.method, f"{quantity} {number}")
        for each in result.scatters
        for quantity in UNITS_OF_FRAME
        for number in range(1, each.setup.stories + 1)
    ]
    names = ("setup", "mode_shape_std", "method", "unknown")
    columns = list(map(blocks.exact, names, zip(*rows, strict=True)))
    figures = ("bias", "bias_error", "variation", "rmse", "relative_bound", "ratio")
    values = ([getattr(each, name) for each in result.scatters] for name in figures)
    columns += map(blocks.exact, figures, map(np.concatenate, values))
    return blocks.Table("scatter", "Scatter", tuple(columns))


def noise_level(scatters: list[Scatter], place: int) -> blocks.Table:
    """Tabulate every method at one noise level, the Cramer-Rao bound first."""
    setup = scatters[0].setup
    numbers = range(1, setup.stories + 1)
    head = ("method", "figure", *(f"m{i}" for i in numbers), *(f"k{i}" for i in numbers))
    bound = ("least possible", "Cramér-Rao bound, %", *in_percent(scatters[0].relative_bound))
    rows = [bound, *(row for scatter in scatters for row in _lines(scatter))]
    exact = "exact" if setup.exact_frequencies else f"with {100 * setup.frequency_std:g} %"
    noise = f"{setup.mode_shape_noise} shape noise {100 * setup.mode_shape_std:g} %"
    title = f"{setup.name}; {noise}, frequencies {exact}"
    return blocks.table_of_rows(f"level-{place}", title, head, rows, words=(0, 1))


def _lines(scatter: Scatter) -> Iterator[Cells]:
    lost = int(np.sum(~scatter.answered))
    method = f"{scatter.method} ({lost} without an answer)" if lost else scatter.method
    yield method, "bias, %", *in_percent(scatter.bias, 3)
    yield "", "its standard error, %", *in_percent(scatter.bias_error, 3)
    yield "", "coefficient of variation, %", *in_percent(scatter.variation)
    yield "", "error, root mean square, %", *in_percent(scatter.rmse)
    yield "", "error / bound", *("" if np.isnan(value) else f"{value:.2f}" for value in scatter.ratio)
    if scatter.coverage is not None:
        yield "", "truth in the 95 % interval, %", *in_percent(scatter.coverage, 1)


def in_percent(values: Floats, digits: int = 2) -> Cells:
    """Write relative values in percent."""
    return tuple(f"{100 * value:.{digits}f}" for value in values)


def note(result: NoiseStudy) -> str:
    """State the random scatter of the study's figures."""
    ratio = 100 / np.sqrt(2 * result.samples)
    covered = 100 * np.sqrt(0.95 * 0.05 / result.samples)
    return (
        f"{result.samples} samples a noise level, seed {result.seed}. Chance alone moves error / bound by "
        f"±{ratio:.1f} % and the share of intervals by ±{covered:.1f} (one standard deviation)."
    )


@blocks.describe.register
def _comparison(result: Comparison) -> blocks.Document:
    without = f"Without the paper's programs: {result.left_out}." if result.left_out else ""
    tables = (part for kind in result.kinds for part in _kind(result, kind))
    backends = quantities.counted(len({row.backend for row in result.rows}), "backend")
    headline = f"{result.experiment}: {backends} on {quantities.counted(len(result.kinds), 'kind')} of programs"
    sections = (
        blocks.section("programs", "Programs", without, *tables),
        blocks.section("worst", "All programs", worst(result)),
    )
    return blocks.Document(result.experiment, headline, sections)


#: Headings of the figures that a backend's answer has for each program.
FIGURES_OF_BACKENDS = {
    "difference": "difference", "primal": "primal_residual", "dual": "dual_residual", "gap": "duality_gap",
    "error": "error_bound",
}  # fmt: skip


def _kind(result: Comparison, kind: ProgramKind) -> Iterator[blocks.Block]:
    """Tabulate the answers of every backend to one kind of programs; the format of the times resolves the fastest."""
    rows = [row for row in result.rows if row.kind == kind.kind]
    solved = [row for row in rows if not row.failure]
    known = [1e3 * row.seconds for row in solved if row.seconds is not None]
    decimals = max(0, 1 - math.floor(math.log10(min(known)))) if known else 0
    name, title = kind.kind.replace(" ", "-"), f"{programs(kind)}, against the {rows[0].reference}"
    yield blocks.table(f"kind-{name}", title, {
        "backend": [row.backend for row in solved],
        **{head: [_power(getattr(row, key)) for row in solved] for head, key in FIGURES_OF_BACKENDS.items()},
        "iterations": ["–" if row.iterations is None else str(row.iterations) for row in solved],
        "tolerance": [_power(row.tolerance, 1) for row in solved],
        "time, ms": ["–" if row.seconds is None else f"{1e3 * row.seconds:.{decimals}f}" for row in solved],
        "time / kkt": ["–" if row.relative_time is None else f"{row.relative_time:.1f}" for row in solved],
    })  # fmt: skip
    failures = (f"{row.backend}: {short(row.failure)}" for row in rows if row.failure)
    yield blocks.Points(f"failures-{name}", tuple(failures))


def _power(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else quantities.exponential(value, digits)


def programs(kind: ProgramKind) -> str:
    """Name a kind of program and its size."""
    nouns = {"program": kind.programs, "unknown": kind.unknowns, "row": kind.rows}
    nouns |= {"equality": kind.equalities, "inequality": kind.inequalities}
    return f"{kind.kind}: {', '.join(quantities.counted(number, noun) for noun, number in nouns.items())}"


def worst(result: Comparison) -> blocks.Table:
    """Tabulate the worst figures of each backend over all programs that the backend accepts."""
    backends = dict.fromkeys(row.backend for row in result.rows)
    every = [[row for row in result.rows if row.backend == backend] for backend in backends]
    *_, bound = FIGURES_OF_BACKENDS
    residuals = [key for head, key in FIGURES_OF_BACKENDS.items() if head not in ("difference", bound)]
    return blocks.table("backends-table", "Worst figures of each backend over all programs", {
        "backend": backends,
        "programs solved": [
            f"{sum(row.programs for row in rows if not row.failure)} of {sum(row.programs for row in rows)}"
            for rows in every
        ],
        **{
            how.replace("_", " "): [str(sum(getattr(row, how) for row in rows)) for rows in every]
            for how in ("as_given", "polished", "replaced")
        },
        "largest difference": [_largest(rows, ["difference"]) for rows in every],
        "largest certificate residual": [_largest(rows, residuals) for rows in every],
        "remark": ["; ".join(sorted({short(row.failure) for row in rows if row.failure})) for rows in every],
    }, words=(0, 7))  # fmt: skip


def _largest(rows: list[BackendResult], keys: Sequence[str]) -> str:
    values = [getattr(row, key) for row in rows if not row.failure for key in keys]
    return _power(max((value for value in values if value is not None), default=None))


def short(failure: str) -> str:
    """Shorten the message of a common failure."""
    return "takes no active bound" if "takes equalities only" in failure else failure
