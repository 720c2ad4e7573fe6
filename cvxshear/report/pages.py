"""What every page of HTML shares: the templates, figures as drawings in a page, versions, JSON for readers."""

import json
import platform
from collections.abc import Iterator
from functools import cache
from importlib import metadata
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cvxshear.util.text import json_text, printable
from cvxshear.util.typing import Json
from cvxshear.version import __version__

PACKAGES = (
    "numpy", "scipy", "qpsolvers", "clarabel", "cvxpy", "osqp", "scs", "highspy", "piqp", "proxsuite", "quadprog",
    "daqp",
)  # fmt: skip
"""Packages whose versions a report names: what computed its numbers."""


@cache
def environment() -> Environment:
    """Load the templates of the reports."""
    # Escapes every text, whatever the template is called: names and priors come from files.
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
    """Every figure of the table that can be drawn of these results, by name.

    Parameters
    ----------
    *results : object
        All of one type; most figures show one.

    Returns
    -------
    dict of str to dict
        `name`, `title`, `caption`, `alternative` and `section` as in the table of figures; `wide`, the drawing as SVG;
        `narrow`, the same for a telephone, None where the wide one is moved sideways there.
    """
    # Not above: a notebook shows tables where matplotlib is not installed.
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
    """JSON that a person can read."""
    return json_text(value, indent=1)


def versions() -> Iterator[tuple[str, str]]:
    """Names and versions of what computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
