"""Planning of tests: the floors to measure and the masses to add."""

from cvxshear.planning.design import Design, measurement_of, read_design
from cvxshear.planning.expected_noise import Declared, Recorded, TestNoise
from cvxshear.planning.planner import MassLimits, plan
from cvxshear.planning.results import ExpectedAccuracy, Plan, predicted, write_template

__all__ = [
    "Declared",
    "Design",
    "ExpectedAccuracy",
    "MassLimits",
    "Plan",
    "Recorded",
    "TestNoise",
    "measurement_of",
    "plan",
    "predicted",
    "read_design",
    "write_template",
]  # fmt: skip
