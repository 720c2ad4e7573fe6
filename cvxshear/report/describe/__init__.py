"""Describe results in words; terminal, report, notebook and `print` arrange the same description."""

# Each of these modules registers the descriptions of its result types.
from cvxshear.report.describe import closed_loop, from_records, planned, responses, studied  # noqa: F401
from cvxshear.report.describe.vocabulary import Document, Facts, Points, Row, Section, Sentence, Table, describe, line

__all__ = ["Document", "Facts", "Points", "Row", "Section", "Sentence", "Table", "describe", "line"]
