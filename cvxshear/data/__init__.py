"""Kinds of measured data: one class a kind, each with its noise, residual, derivative, count, label and errors."""

from cvxshear.data.base import (
    Datum,
    Deviation,
    ErrorFigure,
    Model,
    NoiseFactors,
    NoiseKind,
    Residual,
    data_of,
    noise_kinds,
    register,
)  # fmt: skip
from cvxshear.data.kinds import Frequencies, Shapes, Static

__all__ = [
    "Datum", "Deviation", "ErrorFigure", "Frequencies", "Model", "NoiseFactors", "NoiseKind", "Residual", "Shapes",
    "Static", "data_of", "noise_kinds", "register",
]  # fmt: skip

for _kind in (Frequencies, Shapes, Static):
    register(_kind)
