"""Backends: interchangeable solvers of the least-squares programs. Every solution is certified here.

>>> from cvxshear import backends
>>> backends.get("auto").name, "osqp" in backends.available()
('auto', True)
"""

from typing import TYPE_CHECKING

from cvxshear.backends.base import Backend, Recorder, SolvedProgram
from cvxshear.backends.benchmark import BackendResult, BenchmarkProgram, Comparison, ProgramKind, compare
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.installed import available, get, listed, register
from cvxshear.backends.solvers import Qpsolvers, Solver
from cvxshear.programs import Acceptance, Certificate, Solution

if TYPE_CHECKING:
    from cvxshear.backends.cvxpy_backend import Cvxpy

__all__ = [
    "Acceptance", "Answer", "Backend", "BackendResult", "BenchmarkProgram", "Canonical", "Certificate", "Comparison",
    "Cvxpy", "ProgramKind", "Qpsolvers", "Recorder", "Solution", "SolvedProgram", "Solver", "available", "compare",
    "get", "listed", "register",
]  # fmt: skip

if not TYPE_CHECKING:

    def __getattr__(name):
        if name == "Cvxpy":  # cvxpy takes a second to import
            from cvxshear.backends.cvxpy_backend import Cvxpy  # noqa: PLC0415

            return Cvxpy
        raise AttributeError(f"module 'cvxshear.backends' has no attribute {name!r}")
