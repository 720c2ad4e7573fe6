"""Provide the common parts of all HTML pages: templates, figures as SVG, versions, readable JSON."""

import json
import platform
from collections.abc import Iterator
from functools import cache
from importlib import metadata
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cvxshear.util.errors import printable
from cvxshear.util.typing import Json
from cvxshear.util.writing import json_text
from cvxshear.version import __version__

PACKAGES = (
    "numpy", "scipy", "qpsolvers", "clarabel", "cvxpy", "osqp", "scs", "highspy", "piqp", "proxsuite", "quadprog",
    "daqp",
)  # fmt: skip
"""Packages that may compute the numbers of a report; the report lists their versions."""


@cache
def environment() -> Environment:
    """Load the templates of the reports."""
    # Every text is escaped in every template: names and priors come from files.
    found = Environment(
        loader=PackageLoader("cvxshear.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["printable"] = printable
    found.filters["exact"] = json.dumps
    return found


def drawings(*results: Any) -> dict[str, Json]:
    """Draw all figures that apply to these results, by name.

    Parameters
    ----------
    *results : object
        Results of one type; most figures show one result.

    Returns
    -------
    dict of str to dict
        `name`, `title`, `caption`, `alternative` and `section` as in the table of figures; `wide`, the drawing as SVG;
        `narrow`, the drawing for a telephone, or None if the telephone scrolls the wide drawing.
    """
    # Imported here, because a notebook shows tables without matplotlib.
    from cvxshear.report.figures import style  # noqa: PLC0415
    from cvxshear.report.figures.figure_table import applicable  # noqa: PLC0415

    found = {}
    for entry in applicable(*results):
        # matplotlib has escaped the texts in a drawing.
        wide, narrow = Markup(style.inline_svg(entry.draw(*results), entry.name)), None
        if entry.narrow:
            with style.for_narrow_page():
                narrow = Markup(style.inline_svg(entry.draw(*results), f"{entry.name}-narrow"))
        words = {"caption": entry.caption_of(*results), "alternative": entry.alternative_of(*results)}
        place = {"name": entry.name, "title": entry.title, "section": entry.section}
        found[entry.name] = {**place, **words, "wide": wide, "narrow": narrow}
    return found


def readable_json(value: object) -> str:
    """Write indented JSON for readers."""
    return json_text(value, indent=1)


def versions() -> Iterator[tuple[str, str]]:
    """Yield names and versions of the packages that computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
