"""Planning: which floors to measure and which masses to add, before a test."""

from cvxshear.planning.design import Design, measurement_of, read_design
from cvxshear.planning.expected_noise import Declared, Recorded, TestNoise
from cvxshear.planning.planner import Limits, plan
from cvxshear.planning.results import Outlook, Plan, predicted, write_template

__all__ = [
    "Declared", "Design", "Limits", "Outlook", "Plan", "Recorded", "TestNoise", "measurement_of", "plan",
    "predicted", "read_design", "write_template",
]  # fmt: skip
