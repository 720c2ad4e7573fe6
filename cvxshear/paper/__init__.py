"""Recomputation of the paper's printed figures, and a noise study compared with the Cramer-Rao bound."""

from cvxshear.paper.reproduction import reproduce
from cvxshear.paper.scatter import NoiseStudy, Scatter, noise_study, paper_setups, six_story_study
from cvxshear.paper.tables import PaperRow, PaperSection, Reproduction

__all__ = [
    "NoiseStudy",
    "PaperRow",
    "PaperSection",
    "Reproduction",
    "Scatter",
    "noise_study",
    "paper_setups",
    "reproduce",
    "six_story_study",
]  # fmt: skip
