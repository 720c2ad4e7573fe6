"""Functions that take a result and return a matplotlib Figure, independent of windows and settings.

`style` has their table. Importing this package loads matplotlib.
"""

# The order of these imports is the order of the figures in a report.
# isort: off
from cvxshear.report.figures.drawn_frame import findings, frame
from cvxshear.report.figures.charts import convergence, noise_boxes, noise_variation, plan, residual
from cvxshear.report.figures.frequency_figures import coherence, functions, stabilization
from cvxshear.report.figures.drawn_shapes import mac, modal_mac, modal_shapes, shapes
from cvxshear.report.figures.response import (
    reconstructed_histories,
    response_histories,
    response_peaks,
    story_drifts,
    transfer_functions,
)
from cvxshear.report.figures.style import FigureEntry, drawn_figure, figure, figures_of, save
# isort: on

__all__ = [
    "FigureEntry", "coherence", "convergence", "drawn_figure", "figure", "figures_of", "findings", "frame",
     "functions", "mac", "modal_mac", "modal_shapes", "noise_boxes", "noise_variation", "plan",
    "reconstructed_histories", "residual", "response_histories", "response_peaks", "save", "shapes", "stabilization",
    "story_drifts", "transfer_functions",
]  # fmt: skip
