"""Backends on the same programs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from cvxshear.backends import Comparison, ProgramKind
from cvxshear.backends.benchmark import BackendResult
from cvxshear.report.describe.vocabulary import Block, Document, Points, Row, Section, Sentence, Table, describe, line
from cvxshear.util.quantities import AUTOMATIC, Units, counted, exponential, significant


@describe.register
def _comparison(result: Comparison, units: Units = AUTOMATIC) -> Document:
    tables: list[Block] = [part for kind in result.kinds for part in _kind(result, kind)]
    if result.left_out:
        tables.insert(0, Sentence(f"Without the paper's programs: {result.left_out}."))
    return Document(
        result.experiment,
        f"{result.experiment}: {_headline(result)}",
        (
            Section("programs", "Programs", tuple(tables)),
            Section("worst", "All programs", (worst(result),), detail=True),
        ),
    )


@line.register
def _line(result: Comparison) -> str:
    return f"<Comparison {result.experiment}: {_headline(result)}>"


def _headline(result: Comparison) -> str:
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
    """A kind of program and its size in words."""
    sizes = (
        counted(kind.unknowns, "unknown"),
        counted(kind.rows, "row"),
        counted(kind.equalities, "equality"),
        counted(kind.inequalities, "inequality"),
    )
    condition = "singular" if kind.condition is None else f"condition {significant(kind.condition, 2)}"
    return f"{kind.kind}: {counted(kind.programs, 'program')}, {', '.join(sizes)}, {condition}"


def _rows(rows: list[BackendResult]) -> Iterator[Row]:
    """One row a backend; the times in one format, fine enough for the fastest."""
    known = [1e3 * row.seconds for row in rows if row.seconds is not None]
    decimals = max(0, 1 - math.floor(math.log10(min(known)))) if known else 0
    for row in rows:
        time = "–" if row.seconds is None else f"{1e3 * row.seconds:.{decimals}f}"
        ratio = "–" if row.relative_time is None else f"{row.relative_time:.1f}"
        yield Row((*_cells(row), time, ratio))


def _cells(row: BackendResult) -> Iterator[str]:
    yield row.backend
    for value in (row.difference, row.primal_residual, row.dual_residual, row.duality_gap, row.error_bound):
        yield "–" if value is None else exponential(value)
    yield "–" if row.iterations is None else str(row.iterations)
    yield "–" if row.tolerance is None else exponential(row.tolerance, 1)


def worst(result: Comparison) -> Table:
    """For each backend its worst figures over all programs that it takes."""
    names = dict.fromkeys(row.backend for row in result.rows)
    head = ("backend", "programs solved", "largest difference", "largest certificate residual", "remark")
    rows = tuple(_worst(name, [row for row in result.rows if row.backend == name]) for name in names)
    return Table("backends-table", "Worst figures of each backend over all programs", head, rows, words=(0, 4))


def _worst(name: str, rows: list[BackendResult]) -> Row:
    solved = [row for row in rows if not row.failure]
    residuals = [each for row in solved for each in (row.primal_residual, row.dual_residual, row.duality_gap)]
    return Row(
        (
            name,
            f"{sum(row.programs for row in solved)} of {sum(row.programs for row in rows)}",
            _largest([row.difference for row in solved]),
            _largest(residuals),
            "; ".join(sorted({short(row.failure) for row in rows if row.failure})),
        )
    )


def _largest(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return exponential(max(known)) if known else "–"


def short(failure: str) -> str:
    """A failure that every reader of these tables knows, in a few words."""
    return "takes no active bound" if "takes equalities only" in failure else failure
