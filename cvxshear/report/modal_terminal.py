"""The modes of a record, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.text import Text

from cvxshear.modal import ModalResult
from cvxshear.quantities import percent, significant
from cvxshear.report.terminal import plain_table
from cvxshear.text import printable


def modes(result: ModalResult) -> Iterator[RenderableType]:
    """Frequencies, damping and shapes with their standard deviations, and what the record itself gets wrong."""
    yield Text(
        f"{printable(result.name)}: {len(result.frequencies)} modes at floors {', '.join(map(str, result.floors))}"
    )
    yield Text(f"method {result.method}; uncertainty by {result.uncertainty}\n")
    floors = [f"floor {floor}" for floor in result.floors]
    table = plain_table("modes", "mode", "frequency, Hz", "std", "damping", "std", *floors, "MPC", "lost phase")
    for j in range(len(result.frequencies)):
        table.add_row(
            str(result.modes[j]),
            f"{result.frequencies[j]:.4f}",
            f"{significant(100 * float(result.frequency_std[j]), 2)} %",
            percent(float(result.damping_ratios[j]), 3),
            percent(float(result.damping_std[j]), 3),
            *(
                f"{value:.4f} ± {significant(100 * std, 2)} %"
                for value, std in zip(result.mode_shapes[j], result.mode_shape_std[j], strict=True)
            ),
            significant(float(result.phase_collinearity[j])),
            f"{result.lost_phase[j]:.1f}°",
        )
    yield table
    scale = "1/sqrt(kg)" if result.mass_normalized else "the largest entry is 1"
    yield Text(f"shapes: {scale}; their deviations are relative to the mode's largest entry")
    for finding in result.findings:
        yield Text(f"{finding.kind}: {printable(finding.message)}", style="yellow")
