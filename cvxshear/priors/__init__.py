"""Priors: what is known of the masses and stiffnesses before anything is measured."""

from cvxshear.priors.base import QUANTITIES, QUANTITY_UNITS, Constraints, Prior, check_prior, check_quantity
from cvxshear.priors.bounds import Bounds
from cvxshear.priors.monotone import Monotone
from cvxshear.priors.nominal import Nominal
from cvxshear.priors.ratio import Ratio
from cvxshear.priors.value import Value

__all__ = [
    "QUANTITIES", "QUANTITY_UNITS", "Bounds", "Constraints", "Monotone", "Nominal", "Prior", "Ratio", "Value",
    "check_prior", "check_quantity",
]  # fmt: skip
