"""Figures into files and into pages."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cvxshear.report.figures.style import settings
from cvxshear.util.writing import ending_of, write_file

KINDS = ("svg", "png", "pdf")
ENLARGED = 1.4
"""Pixels of a page a point of a figure: letters of the size of the text around them."""

RESOLUTION = 200
"""Dots an inch of a PNG."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure into a file, in one piece.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        Ending in .svg, .png or .pdf; a device is written SVG to.

    Raises
    ------
    InputError
        Where the ending is another, or the file cannot be written.
    """
    write_file(path, encoded(figure, kind_of(path)))


def kind_of(path: str | Path) -> str:
    """The kind of figure that a file name asks for.

    Raises
    ------
    InputError
        Where it ends in something else.
    """
    return ending_of(path, KINDS, "a figure is written as")


def encoded(figure: Figure, kind: str, *, transparent: bool = False) -> bytes:
    """A figure as the content of a file; the same figure gives the same bytes."""
    no_date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    out = BytesIO()
    FigureCanvasAgg(figure)
    with mpl.rc_context():
        mpl.rcParams.update(settings())
        figure.savefig(out, format=kind, dpi=RESOLUTION, metadata=no_date, transparent=transparent)
    # matplotlib puts every text into a comment beside its outlines, where a name would stand as it is.
    return re.sub(rb"<!--.*?-->", b"", out.getvalue(), flags=re.DOTALL) if kind == "svg" else out.getvalue()


def inline_svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element to stand in a page.

    Parameters
    ----------
    figure : Figure
    name : str
        Sets its ids apart from those of the other figures of the page; a plain word.
    """
    # The page shows through, and with it the shade at an edge beyond which a drawing goes on.
    text = encoded(figure, "svg", transparent=True).decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    # The page says what a figure shows; the drawing itself is nothing to be read out.
    width = ENLARGED * 72 * figure.get_figwidth()
    head = re.sub(r' (width|height)="[\d.]+pt"', "", text[: text.index(">")])
    size = f'width="{width:.0f}" style="--width: {width:.0f}px"'
    head = head.replace("<svg ", f'<svg aria-hidden="true" focusable="false" {size} ', 1)
    return head + text[text.index(">") :]
