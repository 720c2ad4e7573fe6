"""Identification of floor masses and story stiffnesses."""

from cvxshear.fit.results import Identification, IdentifiedFrame, Prediction, SingleIdentification
from cvxshear.methods.run import METHODS, compare_backends, identify, programs_of

__all__ = [
    "METHODS", "Identification", "IdentifiedFrame", "Prediction", "SingleIdentification", "compare_backends",
    "identify", "programs_of",
]  # fmt: skip
