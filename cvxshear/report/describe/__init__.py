"""Results in words: one description each, which terminal, report, notebook and `print` arrange."""

# Each of these modules, and those that they build on, registers how results of its types are described.
from cvxshear.report.describe import closed_loop, from_records, planned, responses, studied  # noqa: F401
from cvxshear.report.describe.vocabulary import Document, Facts, Points, Row, Section, Sentence, Table, describe, line

__all__ = ["Document", "Facts", "Points", "Row", "Section", "Sentence", "Table", "describe", "line"]
