"""The paper's printed figures, and the same figures recomputed."""

from cvxshear.paper.reproduce import reproduce
from cvxshear.paper.results import Reproduction, Row, Section

__all__ = ["Reproduction", "Row", "Section", "reproduce"]
