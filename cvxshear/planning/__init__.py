"""Planning: which floors to measure and which masses to add, before a test."""

from cvxshear.planning.design import Design
from cvxshear.planning.masses import Limits
from cvxshear.planning.noise import Declared, Recorded, TestNoise
from cvxshear.planning.planner import plan
from cvxshear.planning.results import Outlook, Plan
from cvxshear.planning.rivals import Proposal, best_test
from cvxshear.planning.source import measurement_of, read_design
from cvxshear.planning.template import predicted, write_template

__all__ = [
    "Declared",
    "Design",
    "Limits",
    "Outlook",
    "Plan",
    "Proposal",
    "Recorded",
    "TestNoise",
    "best_test",
    "measurement_of",
    "plan",
    "predicted",
    "read_design",
    "write_template",
]
