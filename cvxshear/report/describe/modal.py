"""The modes of a record."""

from __future__ import annotations

from cvxshear.modal import ModalResult
from cvxshear.quantities import AUTOMATIC, Units, counted, percents, significant
from cvxshear.report.describe.dispatch import describe, line
from cvxshear.report.describe.vocabulary import Block, Document, Section, Sentence, Table, columns


@describe.register
def _modes(of: ModalResult, units: Units = AUTOMATIC) -> Document:
    scale = "1/sqrt(kg)" if of.mass_normalized else "the largest entry is 1"
    parts: list[Block] = [
        Sentence(f"Method {of.method}; uncertainty by {of.uncertainty}."),
        _table(of),
        _shapes(of, scale),
        *(Sentence(f"{finding.kind}: {finding.message}", "warning") for finding in of.findings),
    ]
    return Document(of.name, f"{of.name}: {_headline(of)}", (Section("modes", "Modes", tuple(parts)),))


@line.register
def _line(of: ModalResult) -> str:
    found = ", ".join(f"{frequency:.4g}" for frequency in of.frequencies[:4])
    more = ", ..." if len(of.frequencies) > 4 else ""
    return f"<ModalResult {of.name}: {_headline(of)}, {found}{more} Hz>"


def _headline(of: ModalResult) -> str:
    floors = ", ".join(map(str, of.floors))
    return f"{counted(len(of.frequencies), 'mode')} at floor{'s' if len(of.floors) > 1 else ''} {floors}"


def _table(of: ModalResult) -> Table:
    damping = percents([*of.damping_ratios.tolist(), *of.damping_std.tolist()])
    count = len(of.frequencies)
    rows = columns(
        [str(mode) for mode in of.modes],
        [f"{frequency:.4f}" for frequency in of.frequencies],
        percents(of.frequency_std.tolist()),
        damping[:count],
        damping[count:],
        [significant(value) for value in of.phase_collinearity.tolist()],
        [f"{value:.1f}°" for value in of.lost_phase],
    )
    head = ("mode", "frequency, Hz", "std", "damping", "std", "MPC", "lost phase")
    return Table("identified-modes", "Modes", head, rows)


def _shapes(of: ModalResult, scale: str) -> Table:
    rows = columns(
        [str(mode) for mode in of.modes],
        *(
            [
                f"{value:.4f} ± {significant(100 * std, 2)} %"
                for value, std in zip(of.mode_shapes[:, at], of.mode_shape_std[:, at], strict=True)
            ]
            for at in range(len(of.floors))
        ),
    )
    title = f"Mode shapes ({scale}; deviations relative to the mode's largest entry)"
    return Table("identified-shapes", title, ("mode", *(f"floor {floor}" for floor in of.floors)), rows)
