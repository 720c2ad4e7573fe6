"""How results show themselves at a prompt, by print and in a notebook; imported when the first of them is looked at."""

from __future__ import annotations

import base64
import html
from typing import Any

from cvxshear.report.describe import describe, line
from cvxshear.report.terminal import text
from cvxshear.util.errors import InputError
from cvxshear.util.results import Renderers, register
from cvxshear.util.text import printable

FIRST_SECTION = "verdict"
"""Section of a description whose figures a notebook shows with the tables."""


def notebook_html(result: object) -> str:
    """A result as a piece of HTML: its tables, and above them the picture of its verdict where it has one."""
    try:
        from cvxshear.report.pages import environment  # noqa: PLC0415 - jinja2 is optional
    except ImportError:
        return f"<pre>{html.escape(text(result))}</pre>"
    return environment().get_template("notebook.html").render(document=describe(result), pictures=_pictures(result))


def _pictures(result: object) -> list[tuple[str, str]]:
    """What a figure shows and its address; as a PNG, since the ids of several SVGs in a notebook would clash."""
    try:
        from cvxshear.report.figures.figure_table import applicable  # noqa: PLC0415 - matplotlib is optional
        from cvxshear.report.figures.style import encoded  # noqa: PLC0415
    except ImportError:
        return []
    return [
        (entry.alternative_of(result), base64.b64encode(encoded(entry.draw(result), "png")).decode())
        for entry in applicable(result)
        if entry.section == FIRST_SECTION
    ]


def drawn(result: Any, name: str) -> Any:
    """A figure of a result by its name, the first one where it is empty."""
    try:
        from cvxshear.report import figures  # noqa: PLC0415 - matplotlib is optional
    except ImportError as error:
        raise InputError(f"figures need {error.name}: pip install matplotlib") from None
    first = next(iter(figures.figures_of(type(result))), "")
    return figures.drawn_figure(name or first, result)


def picked(result: Any, record_file: Any) -> Any:
    """The diagram of modes in which poles are chosen by clicking."""
    try:
        from cvxshear.report.figures.picked_poles import opened  # noqa: PLC0415 - matplotlib is optional
    except ImportError as error:
        raise InputError(f"choosing poles in a diagram needs {error.name}: pip install matplotlib") from None
    return opened(result, record_file)


register(
    Renderers(
        line=lambda result: printable(line(result)), text=text, html=notebook_html, figure=drawn, pick=picked
    )
)
