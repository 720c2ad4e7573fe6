"""The paper's printed figures recomputed, and its noise study beside the least scatter that is possible."""

from cvxshear.paper.reproduce import Reproduction, reproduce
from cvxshear.paper.scatter import NoiseStudy, Scatter, noise_study, paper_setups, six_story_study
from cvxshear.paper.tables import PaperRow, PaperSection

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
