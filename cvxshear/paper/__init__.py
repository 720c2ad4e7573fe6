"""Recomputation of the paper's printed figures, and a noise study compared with the Cramer-Rao bound."""

from cvxshear.paper.reproduction import PaperRow, PaperSection, Reproduction, reproduce
from cvxshear.paper.scatter import NoiseStudy, Scatter, noise_study, six_story_study
from cvxshear.paper.setups import paper_setups

__all__ = [
    "NoiseStudy", "PaperRow", "PaperSection", "Reproduction", "Scatter", "noise_study", "paper_setups", "reproduce",
    "six_story_study",
]  # fmt: skip
