"""Which figures each result has, by the name that a person asks for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from matplotlib.figure import Figure

from cvxshear.report.figures.convergence import convergence
from cvxshear.report.figures.frame import frame
from cvxshear.report.figures.functions import coherence, functions
from cvxshear.report.figures.mac import mac
from cvxshear.report.figures.modal_shapes import modal_mac, modal_shapes
from cvxshear.report.figures.ranking import ranking
from cvxshear.report.figures.residual import residual
from cvxshear.report.figures.shapes import shapes
from cvxshear.report.figures.stabilization import stabilization

Figures = Mapping[str, Callable[..., Figure]]

OF_A_CLOSURE: Figures = {"residual": residual, "frame": frame, "shapes": shapes, "ranking": ranking, "mac": mac}
OF_AN_IDENTIFICATION: Figures = {"frame": frame, "mac": mac, "convergence": convergence}
OF_RECORDS: Figures = {
    "stabilization": stabilization,
    "functions": functions,
    "coherence": coherence,
    "shapes": modal_shapes,
    "mac": modal_mac,
}
"""The first of each is drawn where a file is named and no kind."""
