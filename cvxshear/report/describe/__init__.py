"""Results in words: one description each, which terminal, report, notebook and `print` arrange."""

from cvxshear.report.describe import (
    backends_compared,
    before_after,
    closed_loop,
    from_records,
    identified,
    measured,
    paper,
    planned,
    prediction,
)
from cvxshear.report.describe.vocabulary import Document, Facts, Points, Row, Section, Sentence, Table, describe, line

__all__ = [
    "Document",
    "Facts",
    "Points",
    "Row",
    "Section",
    "Sentence",
    "Table",
    "backends_compared",
    "before_after",
    "closed_loop",
    "describe",
    "from_records",
    "identified",
    "line",
    "measured",
    "paper",
    "planned",
    "prediction",
]
