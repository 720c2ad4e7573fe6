"""Backends: interchangeable solvers of the least-squares programs, each solution certified here."""

from cvxshear.backends.base import Backend
from cvxshear.backends.benchmark import BackendResult, BenchmarkProgram, Comparison, ProgramKind, compare
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.certificate import Certificate, Solution
from cvxshear.backends.installed import available, get, listed, register
from cvxshear.backends.solvers import Solver

__all__ = [
    "Answer", "Backend", "BackendResult", "BenchmarkProgram", "Canonical", "Certificate", "Comparison",
    "ProgramKind", "Solution", "Solver", "available", "compare", "get", "listed", "register",
]  # fmt: skip
