"""Tables of an identification and of a comparison of backends, for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from cvxshear.backends import Comparison, ListedBackend, ProgramKind
from cvxshear.experiment import Experiment
from cvxshear.identification import Identification, IdentifiedFrame, Part
from cvxshear.quantities import percent, probability, scaled, significant, with_std
from cvxshear.text import printable


class HouseTable(Table):
    """A table whose title is as long as it needs to be; rich would wrap it to the table's width.

    Parameters
    ----------
    heading : str
    **options
        Of `rich.table.Table`.
    """

    def __init__(self, heading: str, **options: Any) -> None:
        super().__init__(**options)
        self.heading = heading

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(self.heading, style="bold")
        yield from super().__rich_console__(console, options)


def plain_table(title: str, *columns: str) -> Table:
    """A table in the house style: left-aligned first column, numbers to the right, no box around."""
    table = HouseTable(title, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for place, column in enumerate(columns):
        table.add_column(column, justify="left" if place == 0 else "right")
    return table


def frame_table(frame: IdentifiedFrame, title: str) -> Table:
    """Floor masses and story stiffnesses, the top of the frame first."""
    table = plain_table(title, "floor / story", "mass, kg", "stiffness")
    factor, unit = scaled(frame.story_stiffness.tolist(), "N/m")
    table.columns[2].header = f"stiffness, {unit}"
    for i in reversed(range(len(frame.floor_mass))):
        mass_std = None if frame.floor_mass_std is None else float(frame.floor_mass_std[i])
        stiffness_std = None if frame.story_stiffness_std is None else float(frame.story_stiffness_std[i])
        table.add_row(
            str(i + 1),
            with_std(float(frame.floor_mass[i]), mass_std),
            with_std(float(frame.story_stiffness[i]), stiffness_std, factor=factor),
        )
    return table


def declared(experiment: Experiment) -> Text:
    """What was measured and declared, in a few lines."""
    frame = experiment.frame
    total = "not declared" if frame.known_total is None else f"{frame.known_total:g} kg"
    lines = [
        f"{printable(experiment.name)}: {experiment.stories} stories, {len(experiment.configurations)} "
        f"configuration{'s' if len(experiment.configurations) > 1 else ''}, total mass {total}"
    ]
    for each in experiment.configurations:
        noise = "noise not declared (default weights)" if not each.noise_declared else "noise declared"
        lines.append(
            f"  {printable(each.name)}: {len(each.frequencies)} modes at {len(each.measured_floors)} floors, "
            f"added mass {each.added_mass.sum():g} kg, {noise}"
        )
    lines += [f"  prior: {printable(prior.describe())}" for prior in experiment.priors]
    return Text("\n".join(lines))


def identification(result: Identification, beside: Identification | None = None) -> Iterator[RenderableType]:
    """The tables of an identification, and of another one for comparison."""
    yield declared(result.experiment)
    yield Text(f"\nmethod {result.method}, backend {result.backend}\n")
    for part in result.parts:
        yield from _part(result, part)
    for names in result.undetermined:
        yield Text(f"not determined by these data: {printable(' and '.join(names))}", style="yellow")
    if beside is not None:
        yield Text(f"for comparison: method {beside.method}, each configuration by itself\n")
        for part in beside.parts:
            yield from _part(beside, part)


def _part(result: Identification, part: Part) -> Iterator[RenderableType]:
    title = "all configurations together" if result.joint else printable(part.name)
    yield frame_table(part.frame, f"{title} (masses without added mass)")
    yield Text(f"{part.iterations} iterations, {part.reason}")
    if part.mass_matrix is not None:
        yield Text(
            "corrected mass matrix, kg:\n"
            + "\n".join("  " + "  ".join(f"{entry:10.3f}" for entry in row) for row in part.mass_matrix)
        )
    fit = part.fit
    chi2 = f"chi-square {significant(fit.chi2)} on {fit.dof} degrees of freedom"
    test = "" if fit.p_value is None else f", p = {probability(fit.p_value)}"
    yield Text(
        f"frequency error: largest {percent(fit.max_frequency_error)}, rms {percent(fit.rms_frequency_error)}; "
        f"smallest MAC {significant(fit.min_mac, 6)}; {chi2}{test}\n"
    )


def comparison(result: Comparison) -> Iterator[RenderableType]:
    """The table of a comparison, one block a kind of program."""
    if result.left_out:
        yield Text(f"Without the paper's programs: {result.left_out}\n")
    for kind in result.kinds:
        rows = [row for row in result.rows if row.kind == kind.kind]
        table = plain_table(
            f"{_programs(kind)}, against the {rows[0].reference}",
            "backend", "difference", "primal", "dual", "gap", "error", "iterations", "told", "time", "time / kkt",
        )  # fmt: skip
        for row in rows:
            if row.failure:
                table.add_row(row.backend, Text(_short(row.failure), style="yellow"))
                continue
            figures = (row.difference, row.primal_residual, row.dual_residual, row.duality_gap, row.error_bound)
            table.add_row(
                row.backend,
                *("–" if value is None else f"{value:.1e}" for value in figures),
                "–" if row.iterations is None else str(row.iterations),
                "–" if row.tolerance is None else f"{row.tolerance:.0e}",
                "–" if row.seconds is None else f"{significant(1e3 * row.seconds, 3)} ms",
                significant(row.relative_time, 2),
            )
        yield table
        yield Text("")


def _programs(kind: ProgramKind) -> str:
    """A kind of program and its size in words."""
    sizes = [
        counted(number, unit)
        for number, unit in (
            (kind.unknowns, "unknown"), (kind.rows, "row"), (kind.equalities, "equality"),
            (kind.inequalities, "inequality"),
        )
    ]  # fmt: skip
    condition = "singular" if kind.condition is None else f"condition {significant(kind.condition, 2)}"
    return f"{kind.kind}: {counted(kind.programs, 'program')}, {', '.join(sizes)}, {condition}"


def counted(number: int, unit: str) -> str:
    """A number of things."""
    plural = f"{unit.removesuffix('y')}ies" if unit.endswith("y") else f"{unit}s"
    return f"{number} {unit if number == 1 else plural}"


def backends(listed: Iterable[ListedBackend]) -> Iterator[RenderableType]:
    """Which backends are installed, with the version of their solver, and how to get the others."""
    everything = list(listed)
    there = plain_table("installed", "backend", "solver", "version", "called by")
    for each in everything:
        if each.installed:
            there.add_row(each.name, each.solver or "this library", each.version or "–", each.through or "–")
    yield there
    missing = [each for each in everything if not each.installed]
    if missing:
        yield Text("")
        absent = plain_table("not installed", "backend", "how to get it")
        absent.columns[1].justify = "left"
        for each in missing:
            absent.add_row(each.name, each.how_to_get)
        yield absent


def _short(failure: str) -> str:
    return "takes no active bound" if "takes equalities only" in failure else failure
