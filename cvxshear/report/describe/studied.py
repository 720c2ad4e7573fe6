"""Describe studies: printed and recomputed figures of the paper, the noise study, the comparison of backends."""

import math
from collections.abc import Iterator
from itertools import groupby

import numpy as np

from cvxshear.backends import Comparison, ProgramKind
from cvxshear.backends.benchmark import BackendResult
from cvxshear.paper import tables as printed
from cvxshear.paper.reproduction import Reproduction
from cvxshear.paper.scatter import NoiseStudy, Scatter
from cvxshear.paper.setups import Setup
from cvxshear.report.describe.vocabulary import (
    Block,
    Document,
    Points,
    Row,
    Section,
    Sentence,
    Table,
    describe,
    plain_rows,
)
from cvxshear.util.quantities import AUTOMATIC, Units, counted, exponential, significant
from cvxshear.util.typing import Floats

MORE_DIGITS = 2
"""Number of decimals of a recomputed figure beyond the printed ones: the reader can see the rounding."""

Cells = tuple[str, ...]


@describe.register
def _reproduction(result: Reproduction, units: Units = AUTOMATIC) -> Document:
    parts = tuple(
        Section(f"section-{place}", section.title, (printed_beside_recomputed(section), *map(Sentence, section.notes)))
        for place, section in enumerate(result.sections, 1)
    )
    summary = Section("summary", "", (Sentence(result.summary),))
    return Document("the paper's figures", "The paper's figures beside recomputed ones.", (*parts, summary))


def printed_beside_recomputed(section: printed.PaperSection) -> Table:
    """Tabulate one section of the paper; each place in the paper is named once."""
    random = any(row.std_error is not None for row in section.rows)
    errors = ("its standard error",) if random else ()
    head = ("where", "what", section.printed_in, "recomputed", *errors, "difference", "agreement")
    rows = [
        (row.where if place == 0 or row.where != section.rows[place - 1].where else "", *_cells(row, random=random))
        for place, row in enumerate(section.rows)
    ]
    return Table(section.title, "", head, plain_rows(rows), words=(0, 1, len(head) - 1))


def _cells(row: printed.PaperRow, *, random: bool) -> Cells:
    if row.printed.startswith("about"):
        return row.what, row.printed, f"{row.recomputed:.2f}", f"{row.std_error or 0.0:.2f}", "", row.verdict
    count = printed.decimals(row.printed)
    # A count of iterations has no decimals.
    more = 0 if row.what == "iterations" or random else MORE_DIGITS
    error = (f"{row.std_error:.{count}f}" if row.std_error is not None else "",) if random else ()
    return (
        row.what, row.printed, _number(row.recomputed, count + more), *error,
        _number(row.difference, count + more, sign=True), row.verdict,
    )  # fmt: skip


def _number(value: float, count: int, *, sign: bool = False) -> str:
    # Adding zero turns the -0.0 of a rounded number into 0.0.
    rounded = round(value, count) + 0.0
    return f"{rounded:+.{count}f}" if sign and rounded else f"{rounded:.{count}f}"


@describe.register
def _study(result: NoiseStudy, units: Units = AUTOMATIC) -> Document:
    levels = [list(alike) for _, alike in groupby(result.scatters, key=lambda each: each.setup)]
    tables = tuple(noise_level(alike, place) for place, alike in enumerate(levels, 1))
    levels_section = Section("levels", "Scatter", (*tables, Sentence(note(result))))
    return Document("noise study", _headline(result), (levels_section,))


def _headline(result: NoiseStudy) -> str:
    setups = counted(len({id(each.setup) for each in result.scatters}), "setup")
    methods = ", ".join(dict.fromkeys(each.method for each in result.scatters))
    return f"{setups}, {counted(result.samples, 'sample')} each, by {methods}"


def noise_level(scatters: list[Scatter], place: int) -> Table:
    """Tabulate every method at one noise level, the Cramer-Rao bound first."""
    setup = scatters[0].setup
    numbers = range(1, setup.stories + 1)
    head = ("method", "figure", *(f"m{i}" for i in numbers), *(f"k{i}" for i in numbers))
    bound = ("least possible", "Cramér-Rao bound, %", *in_percent(scatters[0].relative_bound))
    rows = [bound, *(row for scatter in scatters for row in _lines(scatter))]
    return Table(f"level-{place}", _title(setup), head, plain_rows(rows), words=(0, 1))


def _title(setup: Setup) -> str:
    exact = "exact" if setup.exact_frequencies else f"with {100 * setup.frequency_std:g} %"
    noise = f"{setup.mode_shape_noise} shape noise {100 * setup.mode_shape_std:g} %"
    return f"{setup.name}; {noise}, frequencies {exact}"


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


@describe.register
def _comparison(result: Comparison, units: Units = AUTOMATIC) -> Document:
    tables: list[Block] = [part for kind in result.kinds for part in _kind(result, kind)]
    if result.left_out:
        tables.insert(0, Sentence(f"Without the paper's programs: {result.left_out}."))
    headline = f"{result.experiment}: {_backends_headline(result)}"
    every = Section("worst", "All programs", (worst(result),))
    return Document(result.experiment, headline, (Section("programs", "Programs", tuple(tables)), every))


def _backends_headline(result: Comparison) -> str:
    backends = len({row.backend for row in result.rows})
    return f"{counted(backends, 'backend')} on {counted(len(result.kinds), 'kind')} of programs"


def _kind(result: Comparison, kind: ProgramKind) -> Iterator[Block]:
    rows = [row for row in result.rows if row.kind == kind.kind]
    name = kind.kind.replace(" ", "-")
    title = f"{programs(kind)}, against the {rows[0].reference}"
    figures = ("difference", "primal", "dual", "gap", "error", "iterations", "tolerance")
    head = ("backend", *figures, "time, ms", "time / kkt")
    yield Table(f"kind-{name}", title, head, tuple(_rows([row for row in rows if not row.failure])))
    failures = tuple(f"{row.backend}: {short(row.failure)}" for row in rows if row.failure)
    if failures:
        yield Points(f"failures-{name}", failures)


def programs(kind: ProgramKind) -> str:
    """Name a kind of program and its size."""
    sizes = (
        counted(kind.unknowns, "unknown"),
        counted(kind.rows, "row"),
        counted(kind.equalities, "equality"),
        counted(kind.inequalities, "inequality"),
    )
    condition = "singular" if kind.condition is None else f"condition {significant(kind.condition, 2)}"
    return f"{kind.kind}: {counted(kind.programs, 'program')}, {', '.join(sizes)}, {condition}"


def _rows(rows: list[BackendResult]) -> Iterator[Row]:
    """Yield one row for each backend; the format of the times resolves the fastest."""
    known = [1e3 * row.seconds for row in rows if row.seconds is not None]
    decimals = max(0, 1 - math.floor(math.log10(min(known)))) if known else 0
    for row in rows:
        time = "–" if row.seconds is None else f"{1e3 * row.seconds:.{decimals}f}"
        ratio = "–" if row.relative_time is None else f"{row.relative_time:.1f}"
        yield Row((*_backend_cells(row), time, ratio))


def _backend_cells(row: BackendResult) -> Iterator[str]:
    yield row.backend
    for value in (row.difference, row.primal_residual, row.dual_residual, row.duality_gap, row.error_bound):
        yield "–" if value is None else exponential(value)
    yield "–" if row.iterations is None else str(row.iterations)
    yield "–" if row.tolerance is None else exponential(row.tolerance, 1)


def worst(result: Comparison) -> Table:
    """Tabulate the worst figures of each backend over all programs that the backend accepts."""
    names = dict.fromkeys(row.backend for row in result.rows)
    head = (
        "backend", "programs solved", "as given", "polished", "replaced", "largest difference",
        "largest certificate residual", "remark",
    )  # fmt: skip
    rows = tuple(_worst(name, [row for row in result.rows if row.backend == name]) for name in names)
    return Table("backends-table", "Worst figures of each backend over all programs", head, rows, words=(0, 7))


def _worst(name: str, rows: list[BackendResult]) -> Row:
    solved = [row for row in rows if not row.failure]
    residuals = [each for row in solved for each in (row.primal_residual, row.dual_residual, row.duality_gap)]
    count = f"{sum(row.programs for row in solved)} of {sum(row.programs for row in rows)}"
    accepted = [str(sum(getattr(row, how) for row in rows)) for how in ("as_given", "polished", "replaced")]
    remark = "; ".join(sorted({short(row.failure) for row in rows if row.failure}))
    return Row((name, count, *accepted, _largest([row.difference for row in solved]), _largest(residuals), remark))


def _largest(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return exponential(max(known)) if known else "–"


def short(failure: str) -> str:
    """Shorten the message of a common failure."""
    return "takes no active bound" if "takes equalities only" in failure else failure
