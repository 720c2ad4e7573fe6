"""The damping of an identified frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cvxshear.report.describe.dispatch import describe
from cvxshear.report.describe.vocabulary import Block, Document, Section, Sentence, Table, plain_rows
from cvxshear.response import IdentifiedDamping
from cvxshear.util.quantities import AUTOMATIC, Units, counted, significant, with_std


@describe.register
def _damping(of: IdentifiedDamping, units: Units = AUTOMATIC) -> Document:
    remarks = tuple(Sentence(each, "warning") for each in of.remarks)
    headline = f"{of.kind} damping of {counted(len(of.ratios), 'mode')}"
    return Document("damping", headline, (damping_section(of), Section("remarks", "", remarks)))


def damping_section(of: IdentifiedDamping) -> Section:
    """Damping ratios of the modes, and the dashpots or Rayleigh's factors where there are such."""
    return Section("damping", "Damping", tuple(_parts(of)))


def _parts(of: IdentifiedDamping) -> Iterator[Block]:
    measured = np.full(len(of.ratios), np.nan) if of.measured is None else of.measured
    ratios = plain_rows(
        (str(mode), with_std(float(ratio), float(std), factor=0.01), significant(100 * float(seen), 3))
        for mode, (ratio, std, seen) in enumerate(zip(of.ratios, of.ratios_std, measured, strict=True), 1)
    )
    yield Table("damping-ratios", f"damping ({of.kind})", ("mode", "ratio, %", "measured, %"), ratios)
    if of.story_dashpot is not None and of.story_dashpot_std is not None:
        dashpots = plain_rows(
            (str(story), with_std(float(dashpot), float(std)))
            for story, (dashpot, std) in enumerate(zip(of.story_dashpot, of.story_dashpot_std, strict=True), 1)
        )
        yield Table("story-dashpots", "story dashpots", ("story", "N s/m"), dashpots[::-1])
    if of.rayleigh is not None:
        a, b = of.rayleigh
        yield Sentence(f"C = a M + b K, a = {significant(float(a))} 1/s, b = {significant(float(b))} s")
