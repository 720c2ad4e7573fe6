"""Backends: interchangeable solvers of the least-squares programs. Every solution is certified here.

>>> from cvxshear import backends
>>> backends.get("auto").name, "osqp" in backends.available()
('auto', True)
"""

from cvxshear.backends.base import Backend, Recorder, SolvedProgram
from cvxshear.backends.benchmark import BackendResult, BenchmarkProgram, Comparison, ProgramKind, compare
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.solvers import Cvxpy, Qpsolvers, Solver, available, get, listed, register
from cvxshear.programs import Acceptance, Certificate, Solution

__all__ = [
    "Acceptance", "Answer", "Backend", "BackendResult", "BenchmarkProgram", "Canonical", "Certificate", "Comparison",
    "Cvxpy", "ProgramKind", "Qpsolvers", "Recorder", "Solution", "SolvedProgram", "Solver", "available", "compare",
    "get", "listed", "register",
]  # fmt: skip
