"""Screening of a measurement file before the fit: refuse mistakes and report doubts."""

from cvxshear.screening.doubts import FileFinding, in_json
from cvxshear.screening.screen import Screening, close_loop, refuse_mistakes, screen

__all__ = ["FileFinding", "Screening", "close_loop", "in_json", "refuse_mistakes", "screen"]
