"""What looks wrong in a measurement file, before anything is fitted: mistakes, which are refused, and doubts."""

from cvxshear.screening.finding import FileFinding, in_json
from cvxshear.screening.screen import Screening, close_loop, refuse_mistakes, screen

__all__ = ["FileFinding", "Screening", "close_loop", "in_json", "refuse_mistakes", "screen"]
