"""How results are shown is asked of whoever has said how: a result itself knows nothing of it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cvxshear.util.errors import InputError


@dataclass(frozen=True)
class Renderers:
    """What makes a result visible.

    Parameters
    ----------
    line : callable
        The result in one short line.
    text : callable
        Its tables as plain text.
    html : callable
        Its tables for a notebook; None where that cannot be made.
    figure : callable
        One of its figures, by name; the first where the name is empty.
    pick : callable
        The diagram of modes in which poles are chosen by clicking, given the record file that the choice is for.
    """

    line: Callable[[Any], str]
    text: Callable[[Any], str]
    html: Callable[[Any], str | None]
    figure: Callable[[Any, str], Any]
    pick: Callable[[Any, Any], Any]


_home: list[str] = []
_renderers: list[Renderers] = []


def shown_by(module: str) -> None:
    """Name the module that calls `register` when it is imported, which is when a result is first looked at."""
    _home[:] = [module]


def register(renderers: Renderers) -> None:
    """Show results in this way from now on."""
    _renderers[:] = [renderers]


def _found() -> Renderers | None:
    if not _renderers and _home:
        importlib.import_module(_home[0])
    return _renderers[0] if _renderers else None


def drawing() -> Renderers:
    """What draws results.

    Raises
    ------
    InputError
        Where no module has been named for it.
    """
    renderers = _found()
    if renderers is None:
        raise InputError("nobody has said how this result is drawn")
    return renderers


class Shown:
    """A result that a prompt shows in a line, `print` as tables, and a notebook as HTML."""

    def __repr__(self) -> str:
        renderers = _found()
        return object.__repr__(self) if renderers is None else renderers.line(self)

    def __str__(self) -> str:
        renderers = _found()
        return object.__repr__(self) if renderers is None else renderers.text(self)

    def _repr_html_(self) -> str | None:
        """What a notebook shows."""
        renderers = _found()
        return None if renderers is None else renderers.html(self)

    def figure(self, name: str = "") -> Any:
        """Draw a figure of this result.

        Parameters
        ----------
        name : str, optional
            As `--figure list` prints it; the first figure of such a result where not given.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it as the last expression of a cell.

        Raises
        ------
        InputError
            Where there is no figure of that name, the result does not hold what it shows, or matplotlib is missing.
        """
        return drawing().figure(self, name)
