"""Tables of an identification and of a comparison of backends, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from cvxshear.experiment import Experiment
from cvxshear.identification import Identification, IdentifiedFrame, Part
from cvxshear.report.numbers import percent, probability, scaled, significant, with_std
from cvxshear.studies.backends import Comparison
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
    for kind in dict.fromkeys(row.kind for row in result.rows):
        rows = [row for row in result.rows if row.kind == kind]
        count = f"{rows[0].programs} program{'s' if rows[0].programs > 1 else ''}"
        table = plain_table(
            f"{kind} ({count}, against the {rows[0].reference})",
            "backend", "difference", "primal", "dual", "gap", "iterations", "time / kkt",
        )  # fmt: skip
        for row in rows:
            if row.failure:
                table.add_row(row.backend, Text(_short(row.failure), style="yellow"))
                continue
            table.add_row(
                row.backend,
                *(
                    f"{value:.1e}"
                    for value in (row.difference, row.primal_residual, row.dual_residual, row.duality_gap)
                    if value is not None
                ),
                "–" if row.iterations is None else str(row.iterations),
                significant(row.relative_time, 2),
            )
        yield table
        yield Text("")


def _short(failure: str) -> str:
    return "takes no active bound" if "takes equalities only" in failure else failure
