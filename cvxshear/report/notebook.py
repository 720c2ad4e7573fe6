"""Results that show themselves in a notebook: short tables; plain text where jinja2 is not installed."""

from __future__ import annotations

import html

from cvxshear.report.describe import describe
from cvxshear.report.terminal import text


def notebook_html(result: object) -> str:
    """A result as a piece of HTML."""
    try:
        from cvxshear.report.pages import environment  # noqa: PLC0415 - jinja2 is optional
    except ImportError:
        return f"<pre>{html.escape(text(result))}</pre>"
    return environment().get_template("notebook.html").render(document=describe(result))
