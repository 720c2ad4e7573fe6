"""Planning of tests: the floors to measure and the masses to add."""

from cvxshear.planning.design import Design, measurement_of, read_design
from cvxshear.planning.expected_tests import Declared
from cvxshear.planning.planner import ExpectedAccuracy, Plan, plan, predicted, write_template

__all__ = [
    "Declared", "Design", "ExpectedAccuracy", "Plan", "measurement_of", "plan", "predicted", "read_design",
    "write_template",
]  # fmt: skip
