"""Backends: interchangeable solvers of the least-squares programs, each solution certified here."""

from cvxshear.backends.base import Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.certificate import Certificate
from cvxshear.backends.registry import available, get, register
from cvxshear.backends.solution import Solution

__all__ = ["Answer", "Backend", "Canonical", "Certificate", "Solution", "available", "get", "register"]
