"""How results show themselves at a prompt, by print and in a notebook; imported when the first of them is looked at."""

from __future__ import annotations

import html

from cvxshear.report.describe import describe, line
from cvxshear.report.terminal import text
from cvxshear.util.showing import Renderers, register
from cvxshear.util.text import printable


def notebook_html(result: object) -> str:
    """A result as a piece of HTML."""
    try:
        from cvxshear.report.pages import environment  # noqa: PLC0415 - jinja2 is optional
    except ImportError:
        return f"<pre>{html.escape(text(result))}</pre>"
    return environment().get_template("notebook.html").render(document=describe(result))


register(Renderers(line=lambda result: printable(line(result)), text=text, html=notebook_html))
