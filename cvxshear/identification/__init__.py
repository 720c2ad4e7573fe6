"""Identification of floor masses and story stiffnesses."""

from cvxshear.identification.methods import METHODS, identify
from cvxshear.identification.programs_of import compare_backends, programs_of
from cvxshear.identification.results import Identification, IdentifiedFrame, Prediction, SingleIdentification

__all__ = [
    "METHODS",
    "Identification",
    "IdentifiedFrame",
    "Prediction",
    "SingleIdentification",
    "compare_backends",
    "identify",
    "programs_of",
]
