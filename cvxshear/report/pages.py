"""The templates of everything that is shown as HTML."""

from __future__ import annotations

import json
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from cvxshear.util.text import printable


@cache
def environment() -> Environment:
    """The templates of the reports."""
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
