"""Functions that take a result and return a matplotlib Figure, independent of windows and settings.

`style` has their table. Importing this package loads matplotlib.
"""

# The order of these imports is the order of the figures in a report.
# isort: off
from cvxshear.report.figures.drawn_frame import findings, frame, planned, plans
from cvxshear.report.figures.charts import changes_over_time, noise_boxes, noise_variation
from cvxshear.report.figures.mode_figures import (
    functions, mac, modal_shapes, modes_over_amplitude, plan_shapes, shapes, stabilization,
)  # fmt: skip
from cvxshear.report.figures.response import (
    animations, reconstructed_histories, response_histories, response_peaks, story_drifts,
)  # fmt: skip
from cvxshear.report.figures.style import FigureEntry, drawn_figure, figure, figures_of, save
# isort: on

__all__ = [
    "FigureEntry", "animations", "changes_over_time", "drawn_figure", "figure", "figures_of", "findings", "frame",
    "functions", "mac", "modal_shapes", "modes_over_amplitude", "noise_boxes",
    "noise_variation", "plan_shapes", "planned", "plans", "reconstructed_histories", "response_histories",
    "response_peaks", "save", "shapes", "stabilization", "story_drifts",
]  # fmt: skip
