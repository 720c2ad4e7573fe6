"""Screening of a measurement file before the fit: refuse mistakes and report doubts."""

from cvxshear.screening.doubts import FileFinding, in_json
from cvxshear.screening.screen import Screening, close_loop, refuse_mistakes, screen
from cvxshear.screening.trends import History, StiffnessChange, history

__all__ = [
    "FileFinding", "History", "Screening", "StiffnessChange", "close_loop", "history", "in_json", "refuse_mistakes",
    "screen",
]  # fmt: skip
