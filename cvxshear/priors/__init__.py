"""Priors of floor masses and story stiffnesses."""

from cvxshear.priors.base import QUANTITIES, QUANTITY_UNITS, Constraints, Prior, check_prior, check_quantity
from cvxshear.priors.stated import Bounds, Monotone, Nominal, Ratio, Value

__all__ = [
    "QUANTITIES", "QUANTITY_UNITS", "Bounds", "Constraints", "Monotone", "Nominal", "Prior", "Ratio", "Value",
    "check_prior", "check_quantity",
]  # fmt: skip
