"""Closing the loop between measurement and model."""

from cvxshear.loop.results import VERDICTS, LoopResult

__all__ = ["VERDICTS", "LoopResult"]
