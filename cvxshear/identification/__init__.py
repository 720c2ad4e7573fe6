"""Identification of floor masses and story stiffnesses."""

from cvxshear.identification.methods import METHODS, identify
from cvxshear.identification.programs_of import compare_backends, programs_of
from cvxshear.identification.results import Identification, IdentifiedFrame, Part, Prediction

__all__ = [
    "METHODS",
    "Identification",
    "IdentifiedFrame",
    "Part",
    "Prediction",
    "compare_backends",
    "identify",
    "programs_of",
]
