"""How the documentation is built: `python -m sphinx -W -b html docs build/docs`, without a download."""

import sys
from pathlib import Path

import cvxshear

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "cvxshear"
author = "the cvxshear developers"
project_copyright = f"{author}; Apache-2.0"
release = cvxshear.__version__
version = release

# The API reference lists what it shows by itself.
autosummary_generate = False
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "mathml", "gallery"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_extensions"]
templates_path: list[str] = []

myst_enable_extensions = ["dollarmath", "deflist", "attrs_block"]
myst_heading_anchors = 3

# Docstrings state types and shapes themselves.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"cvxshear {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_domain_indices = False
html_show_sphinx = False
# Only what the pages need; a build from a clean checkout reaches no other site.
html_theme_options = {"navigation_with_keys": True}


def escape_bars(app, what, name, obj, options, lines) -> None:  # type: ignore[no-untyped-def]
    """Docstrings write |x| for a size; reStructuredText would take it for a substitution."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def setup(app) -> None:  # type: ignore[no-untyped-def]
    """Keep the docstrings' bars."""
    app.connect("autodoc-process-docstring", escape_bars)
