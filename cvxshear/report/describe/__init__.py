"""Descriptions of results, one module for each topic."""

from cvxshear.report.blocks import describe, line

__all__ = ["describe", "line"]
