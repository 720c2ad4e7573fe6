"""Closing the loop between measurement and model."""

from cvxshear.loop.results import LoopResult
from cvxshear.loop.verdicts import VERDICTS

__all__ = ["VERDICTS", "LoopResult"]
