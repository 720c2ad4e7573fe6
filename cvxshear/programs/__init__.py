"""Least-squares programs of the identification, in the one form that every backend takes."""

from cvxshear.programs.orthogonality import mass_correction, one_shot_masses, story_stiffnesses
from cvxshear.programs.statements import LeastSquares

__all__ = ["LeastSquares", "mass_correction", "one_shot_masses", "story_stiffnesses"]
