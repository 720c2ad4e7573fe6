"""Figures: each a function that takes a result and returns a matplotlib Figure, which no window or setting depends on.

Needs matplotlib (`pip install cvxshear[plot]`).
"""

from cvxshear.report.figures.backends import backend_differences
from cvxshear.report.figures.convergence import convergence
from cvxshear.report.figures.frame import frame
from cvxshear.report.figures.mac import mac
from cvxshear.report.figures.noise import noise_boxes, noise_variation
from cvxshear.report.figures.output import save
from cvxshear.report.figures.ranking import ranking
from cvxshear.report.figures.residual import residual
from cvxshear.report.figures.response import floor_spectra, response_histories, response_peaks, transfer_functions
from cvxshear.report.figures.shapes import shapes

__all__ = [
    "backend_differences",
    "convergence",
    "floor_spectra",
    "frame",
    "mac",
    "noise_boxes",
    "noise_variation",
    "ranking",
    "residual",
    "response_histories",
    "response_peaks",
    "save",
    "shapes",
    "transfer_functions",
]
