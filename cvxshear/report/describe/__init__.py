"""Results in words: one description each, which terminal, report, notebook and `print` arrange."""

# Each of these modules registers how results of its types are described.
from cvxshear.report.describe import (  # noqa: F401
    closed_loop,
    from_records,
    identified,
    measured,
    planned,
    responses,
    studied,
)  # fmt: skip
from cvxshear.report.describe.vocabulary import Document, Facts, Points, Row, Section, Sentence, Table, describe, line

__all__ = ["Document", "Facts", "Points", "Row", "Section", "Sentence", "Table", "describe", "line"]
