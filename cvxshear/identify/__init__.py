"""Identification of floor masses and story stiffnesses."""

from cvxshear.identify.identify import METHODS, identify
from cvxshear.identify.results import IdentifiedFrame, Identification, Part, Prediction

__all__ = ["METHODS", "IdentifiedFrame", "Identification", "Part", "Prediction", "identify"]
