"""Draws the gallery's figures before the pages are read, and shows them with the words that the table of figures has.

A page writes, with the names of an example and of one or several of its figures,

    ```{gallery} paper findings shapes
    ```
"""

import json
import runpy
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

FOLDER = "gallery/figures"


def draw(app: Sphinx) -> None:
    """Draw every figure beside the gallery's page."""
    runpy.run_path(str(Path(app.srcdir) / "gallery" / "draw.py"))["draw"](Path(app.srcdir) / FOLDER)


class Gallery(SphinxDirective):
    """Figures of an example, or of all examples."""

    required_arguments = 1
    optional_arguments = 99

    def run(self) -> list[nodes.Node]:
        """Each figure with its alternative text and caption."""
        words = json.loads((Path(self.env.srcdir) / FOLDER / "figures.json").read_text(encoding="utf-8"))
        example, *names = self.arguments
        names = names or [key.split()[1] for key in words if key.split()[0] == example]
        shown: list[nodes.Node] = []
        for name in names:
            _, alternative, caption = words[f"{example} {name}"]
            figure = nodes.figure()
            figure += nodes.image(uri=f"/{FOLDER}/{example}-{name}.svg", alt=alternative)
            figure += nodes.caption(text=caption)
            shown.append(figure)
        return shown


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw before the first page is read."""
    app.connect("builder-inited", draw)
    app.add_directive("gallery", Gallery)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
