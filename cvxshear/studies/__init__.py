"""Many identifications at once."""

from cvxshear.studies.noise import NoiseStudy, noise_study, paper_setups, six_story_study

__all__ = ["NoiseStudy", "noise_study", "paper_setups", "six_story_study"]
