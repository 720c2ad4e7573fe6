"""Functions that take a result and return a matplotlib Figure, independent of windows and settings.

`figure_table` lists them. Importing this package loads matplotlib.
"""

from cvxshear.report.figures.drawn_frame import findings, frame
from cvxshear.report.figures.drawn_shapes import shapes
from cvxshear.report.figures.figure_table import FigureEntry, drawn_figure, figure, figures_of
from cvxshear.report.figures.frequency_figures import coherence, functions, stabilization
from cvxshear.report.figures.judged import ranking, residual, springs
from cvxshear.report.figures.modal_figures import mac, modal_mac, modal_shapes
from cvxshear.report.figures.planned_test import plan
from cvxshear.report.figures.response import (
    floor_spectra,
    reconstructed_histories,
    response_histories,
    response_peaks,
    story_drifts,
    transfer_functions,
)
from cvxshear.report.figures.study_figures import backend_differences, convergence, noise_boxes, noise_variation
from cvxshear.report.figures.style import save

__all__ = [
    "FigureEntry", "backend_differences", "coherence", "convergence", "drawn_figure", "figure", "figures_of",
    "findings", "floor_spectra", "frame", "functions", "mac", "modal_mac", "modal_shapes", "noise_boxes",
    "noise_variation", "plan", "ranking", "reconstructed_histories", "residual", "response_histories", "response_peaks",
    "save", "shapes", "springs", "stabilization", "story_drifts", "transfer_functions",
]  # fmt: skip
