"""What looks wrong in a measurement file or a record, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import RenderableType
from rich.text import Text

from cvxshear.experiment import Experiment
from cvxshear.modal.findings import Finding as Diagnostic
from cvxshear.screening import Finding


def screening(
    experiment: Experiment, found: Sequence[Finding], diagnostics: Sequence[Diagnostic] = ()
) -> Iterator[RenderableType]:
    """Every finding with what to change, mistakes first, then what a record's own diagnostics say."""
    accepted = experiment.frame.accept
    if accepted:
        yield Text(f"accepted beforehand: {', '.join(accepted)}")
    if not found and not diagnostics:
        yield Text(f"{experiment.name}: nothing looks wrong", style="green")
    for item in found:
        yield from _finding(item)
    for diagnostic in diagnostics:
        yield Text(f"RECORD: {diagnostic.kind}", style="yellow")
        yield Text(f"  found   {diagnostic.message}")


def _finding(item: Finding) -> Iterator[RenderableType]:
    word, style = ("MISTAKE", "bold red") if item.refuses else ("WARNING", "yellow")
    where = f' in configuration "{item.configuration}"' if item.configuration else ""
    yield Text(f"{word}: {' or '.join((item.name, *item.rivals))}{where}", style=style)
    yield Text(f"  found   {item.found}")
    yield Text(f"  change  {item.change}")
    yield Text(f"  accept  {item.how_to_accept}, if it is right as it is")


def warnings(found: Sequence[Finding]) -> Iterator[RenderableType]:
    """Doubts above a result that was computed all the same, a line each."""
    for item in found:
        yield Text(f"WARNING: {item.found}; {item.change} ({item.how_to_accept} silences this)", style="yellow")
