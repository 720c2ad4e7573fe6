"""The modes of a record."""

from __future__ import annotations

import numpy as np

from cvxshear.modal import ModalResult
from cvxshear.report.describe.dispatch import describe, line
from cvxshear.report.describe.vocabulary import Block, Document, Section, Sentence, Table, columns
from cvxshear.util.quantities import AUTOMATIC, Units, capital, counted, percents, ranged, with_stds
from cvxshear.util.typing import Floats

METHODS = {
    "era": "eigensystem realization (era)",
    "okid": "observer identification and eigensystem realization (okid)",
    "subspace": "subspace identification (subspace)",
    "ssi": "stochastic subspace identification (ssi)",
    "given": "modes found elsewhere",
}
"""The methods of `identify_modes` in words; another library's name stands as it is."""


def method_in_words(of: ModalResult) -> str:
    """How the modes were found."""
    return METHODS.get(of.method, of.method)


def scale_in_words(of: ModalResult) -> str:
    """In what the shapes are given."""
    return "1/√kg" if of.mass_normalized else "the largest entry is 1"


def shape_deviations(of: ModalResult) -> Floats:
    """Standard deviations of the shapes' entries as files have them, in the unit of the shapes, shape (m, n)."""
    largest = np.abs(of.mode_shapes).max(axis=1, keepdims=True)
    return np.asarray(of.written_entry_std * largest)


@describe.register
def _modes(of: ModalResult, units: Units = AUTOMATIC) -> Document:
    parts: list[Block] = [
        Sentence(f"{capital(method_in_words(of))}; standard deviations: {of.uncertainty}."),
        _table(of),
        _shapes(of),
        *(Sentence(f"{finding.kind}: {finding.message}", "warning") for finding in of.findings),
    ]
    return Document(of.name, f"{of.name}: {_headline(of)}", (Section("modes", "Modes", tuple(parts)),))


@line.register
def _line(of: ModalResult) -> str:
    found = ", ".join(f"{frequency:.4g}" for frequency in of.frequencies[:4])
    more = ", ..." if len(of.frequencies) > 4 else ""
    return f"<ModalResult {of.name}: {_headline(of)}, {found}{more} Hz>"


def _headline(of: ModalResult) -> str:
    floors = ranged(of.floors.tolist())
    return f"{counted(len(of.frequencies), 'mode')} at floor{'s' if len(of.floors) > 1 else ''} {floors}"


def _table(of: ModalResult) -> Table:
    # A ratio of nothing at all is one that nobody gave, and so is a standard deviation.
    damping, spread = ([value or None for value in each.tolist()] for each in (of.damping_ratios, of.damping_std))
    rows = columns(
        [str(mode) for mode in of.modes],
        [f"{frequency:.4f}" for frequency in of.frequencies],
        percents(of.written_frequency_std.tolist()),
        percents(damping),
        percents(spread),
        [f"{value:.4f}" for value in of.phase_collinearity.tolist()],
        [f"{value:.1f}°" for value in of.lost_phase],
    )
    head = ("mode", "frequency, Hz", "std", "damping", "std", "MPC", "lost phase")
    title = "Phase collinearity (MPC) 1, lost phase 0°: all floors move in step"
    return Table("identified-modes", title, head, rows)


def _shapes(of: ModalResult) -> Table:
    """The shapes side by side, the top of the frame first."""
    shapes, stds = of.mode_shapes.tolist(), shape_deviations(of).tolist()
    rows = columns(
        [str(floor) for floor in of.floors],
        *(with_stds(values, std) for values, std in zip(shapes, stds, strict=True)),
    )
    title = f"Mode shapes ± standard deviation ({scale_in_words(of)})"
    return Table("identified-shapes", title, ("floor", *(f"mode {mode}" for mode in of.modes)), tuple(reversed(rows)))
