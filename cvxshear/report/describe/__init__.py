"""Results in words: one description each, which terminal, report, notebook and `print` arrange."""

from cvxshear.report.describe import (
    closure,
    comparison,
    damping,
    experiment,
    identification,
    modal,
    paper,
    planned,
    prediction,
    screening,
)
from cvxshear.report.describe.dispatch import describe, line
from cvxshear.report.describe.vocabulary import Document, Facts, Points, Row, Section, Sentence, Table

__all__ = [
    "Document",
    "Facts",
    "Points",
    "Row",
    "Section",
    "Sentence",
    "Table",
    "closure",
    "comparison",
    "damping",
    "describe",
    "experiment",
    "identification",
    "line",
    "modal",
    "paper",
    "planned",
    "prediction",
    "screening",
]
