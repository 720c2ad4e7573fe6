"""Figures: each a function that takes a result and returns a matplotlib Figure, which no window or setting depends on.

Needs matplotlib (`pip install matplotlib`).
"""

from cvxshear.report.figures.backends import backend_differences
from cvxshear.report.figures.convergence import convergence
from cvxshear.report.figures.frame import frame
from cvxshear.report.figures.functions import coherence, functions
from cvxshear.report.figures.mac import mac
from cvxshear.report.figures.modal_shapes import modal_mac, modal_shapes
from cvxshear.report.figures.noise import noise_boxes, noise_variation
from cvxshear.report.figures.output import save
from cvxshear.report.figures.plan import plan
from cvxshear.report.figures.ranking import ranking
from cvxshear.report.figures.residual import residual
from cvxshear.report.figures.response import (
    floor_spectra,
    reconstructed_histories,
    response_histories,
    response_peaks,
    story_drifts,
    transfer_functions,
)
from cvxshear.report.figures.shapes import shapes
from cvxshear.report.figures.stabilization import stabilization

__all__ = [
    "backend_differences",
    "coherence",
    "convergence",
    "floor_spectra",
    "frame",
    "functions",
    "mac",
    "modal_mac",
    "modal_shapes",
    "noise_boxes",
    "noise_variation",
    "plan",
    "ranking",
    "reconstructed_histories",
    "residual",
    "response_histories",
    "response_peaks",
    "save",
    "shapes",
    "stabilization",
    "story_drifts",
    "transfer_functions",
]
