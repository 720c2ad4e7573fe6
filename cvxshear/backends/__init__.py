"""Backends: interchangeable solvers of the least-squares programs, each solution certified here."""

from cvxshear.backends.base import Backend
from cvxshear.backends.benchmark import BackendResult, BenchmarkProgram, Comparison, ProgramKind, compare
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.certificate import Certificate, Solution
from cvxshear.backends.installed import ListedBackend, available, get, listed, register

__all__ = [
    "Answer", "Backend", "BackendResult", "BenchmarkProgram", "Canonical", "Certificate", "Comparison",
    "ListedBackend", "ProgramKind", "Solution", "available", "compare", "get", "listed", "register",
]  # fmt: skip
