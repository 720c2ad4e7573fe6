"""Figures as the drawings of a page."""

from __future__ import annotations

from collections.abc import Mapping

from markupsafe import Markup
from matplotlib.figure import Figure

from cvxshear.report.figures.output import inline_svg


def drawings(figures: Mapping[str, Figure]) -> dict[str, Markup]:
    """The drawings by name; matplotlib has escaped the texts in them."""
    return {name: Markup(inline_svg(figure, name)) for name, figure in figures.items()}
