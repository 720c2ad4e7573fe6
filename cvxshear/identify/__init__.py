"""Identification of floor masses and story stiffnesses."""

from cvxshear.identify.identify import METHODS, identify
from cvxshear.identify.results import Identification, IdentifiedFrame, Part, Prediction

__all__ = ["METHODS", "Identification", "IdentifiedFrame", "Part", "Prediction", "identify"]
