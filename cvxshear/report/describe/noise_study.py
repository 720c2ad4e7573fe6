"""A noise study: the tables that it prints, with a line for a prompt."""

from __future__ import annotations

from cvxshear.report.describe.vocabulary import Document, Section, Sentence, Table, describe, line, plain_rows
from cvxshear.studies import NoiseStudy
from cvxshear.studies.noise_table import blocks, note
from cvxshear.util.quantities import AUTOMATIC, Units, counted


@describe.register
def _study(of: NoiseStudy, units: Units = AUTOMATIC) -> Document:
    tables = tuple(
        Table(f"level-{place}", block.title, block.header, plain_rows(row for group in block.groups for row in group),
              words=(0, 1))
        for place, block in enumerate(blocks(of), 1)
    )  # fmt: skip
    return Document("noise study", _headline(of), (Section("levels", "Scatter", (*tables, Sentence(note(of)))),))


@line.register
def _line(of: NoiseStudy) -> str:
    return f"<NoiseStudy {_headline(of)}>"


def _headline(of: NoiseStudy) -> str:
    setups = counted(len({id(each.setup) for each in of.scatters}), "setup")
    methods = ", ".join(dict.fromkeys(each.method for each in of.scatters))
    return f"{setups}, {counted(of.samples, 'sample')} each, by {methods}"
