"""Modules above this room: the public face names them, so that nothing imports upward."""

from __future__ import annotations

import importlib
from typing import Any

_modules: dict[str, str] = {}
"""By task."""


def name_module(task: str, module: str) -> None:
    """Name the module that does a task; it is imported when it is first asked.

    Parameters
    ----------
    task : str
        "read", of a module with `experiment_from_file`, which takes a path or the name of a built-in example. "show",
        of one with `line_of` (a result in a short line), `text` (its tables), `notebook_html` (the same for a notebook,
        or None), `drawn` (one of its figures, by name; the first where the name is empty) and `picked` (the diagram in
        which poles are chosen).
    module : str
    """
    _modules[task] = module


def ask(task: str, function: str, *given: Any) -> Any:
    """Call a function of the module that does a task, and return what it returns.

    Parameters
    ----------
    task, function : str
    *given : object
    """
    return getattr(importlib.import_module(_modules[task]), function)(*given)
