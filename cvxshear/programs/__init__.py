"""Least-squares programs of the identification, in the one form that every backend takes."""

from cvxshear.programs.least_squares import LeastSquares
from cvxshear.programs.orthogonality import mass_correction, one_shot_masses, story_stiffnesses

__all__ = ["LeastSquares", "mass_correction", "one_shot_masses", "story_stiffnesses"]
