"""Kinds of measured data: one class a kind, each with its residual, derivative, count, label and errors."""

from cvxshear.data.base import NOISES, Datum, Deviation, Model, Noise, Residual
from cvxshear.data.frequencies import Frequencies
from cvxshear.data.kinds import data_of, register
from cvxshear.data.shapes import Shapes
from cvxshear.data.static import Static

__all__ = [
    "NOISES",
    "Datum",
    "Deviation",
    "Frequencies",
    "Model",
    "Noise",
    "Residual",
    "Shapes",
    "Static",
    "data_of",
    "register",
]
