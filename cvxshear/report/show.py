"""Says how results show themselves; imported when the first of them is looked at."""

from __future__ import annotations

from cvxshear.report.describe import line
from cvxshear.report.notebook import notebook_html
from cvxshear.report.terminal import text
from cvxshear.util.showing import Renderers, register
from cvxshear.util.text import printable

register(Renderers(line=lambda result: printable(line(result)), text=text, html=notebook_html))
