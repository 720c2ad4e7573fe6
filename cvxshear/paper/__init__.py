"""The paper's printed figures recomputed, and its noise study beside the least scatter that is possible."""

from cvxshear.paper.reproduce import Reproduction, reproduce
from cvxshear.paper.scatter import NoiseStudy, Scatter, noise_study, paper_setups, six_story_study
from cvxshear.paper.tables import Row, Section

__all__ = [
    "NoiseStudy", "Reproduction", "Row", "Scatter", "Section", "noise_study", "paper_setups", "reproduce",
    "six_story_study",
]  # fmt: skip
