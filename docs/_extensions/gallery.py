"""Draws the gallery's figures before the pages are read, so that they show what this version computes."""

import runpy
from pathlib import Path

from sphinx.application import Sphinx


def draw(app: Sphinx) -> None:
    """Draw every figure beside the gallery's page."""
    script = Path(app.srcdir) / "gallery" / "draw.py"
    runpy.run_path(str(script))["draw"](script.parent / "figures")


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw before the first page is read."""
    app.connect("builder-inited", draw)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
