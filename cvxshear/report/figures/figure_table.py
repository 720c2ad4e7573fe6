"""Define the table of figures: each figure with its drawing, its texts, and its result types.

Reports, notebooks, the command line and the gallery of the documentation all use this table. The decorator `figure`
adds a drawing function to the table, in this package or in a user's module.
"""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from typing import Any

from matplotlib.figure import Figure

from cvxshear.report.figures.style import styled
from cvxshear.util.errors import InputError

Words = str | Callable[..., str]
"""A text, or a function that makes the text from the results."""


@dataclass(frozen=True)
class FigureEntry:
    """A figure of one kind of result.

    Parameters
    ----------
    name : str
        Name of the figure, such as in `--figure name:OUT.svg`.
    draw : callable
        Takes the results and returns the figure.
    title : str
        Heading of the figure.
    caption : str or callable
        Text below the figure; a callable takes the results.
    alternative : str or callable
        Description for readers who cannot see the figure.
    section : str
        Key of the report section that ends with the figure; if empty, the figure has its own section.
    applies : callable
        Takes the results and returns whether they contain the data of the figure.
    needs : str
        Required data of the results, in words.
    narrow : bool
        Whether the drawing calls `narrow_page` and has a form for a telephone.
    """

    name: str
    draw: Callable[..., Figure]
    title: str
    caption: Words
    alternative: Words
    section: str
    applies: Callable[..., bool]
    needs: str
    narrow: bool

    def caption_of(self, *results: Any) -> str:
        """Write the caption of the figure of these results."""
        return self.caption if isinstance(self.caption, str) else self.caption(*results)

    def alternative_of(self, *results: Any) -> str:
        """Describe the figure of these results for readers who cannot see the figure."""
        return self.alternative if isinstance(self.alternative, str) else self.alternative(*results)


_TABLE: dict[type, dict[str, FigureEntry]] = {}
"""Figures by the type of their result, in the order of a report."""


def figure(
    name: str,
    *results: type,
    title: str,
    caption: Words = "",
    alternative: Words = "",
    section: str = "",
    applies: Callable[..., bool] = lambda *results: True,
    needs: str = "",
    narrow: bool = False,
) -> Callable[[Callable[..., Figure]], Callable[..., Figure]]:
    """Add a drawing function to the table of figures, for each type of result that the function draws.

    Parameters
    ----------
    name : str
    *results : type
        Types such as `LoopResult`. If the user names a file and no figure, the first figure of a type is drawn.
    title, caption, alternative, section, applies, needs, narrow
        As in `FigureEntry`. An empty alternative text becomes the first line of the function's docstring, and an empty
        caption becomes its second paragraph.

    Returns
    -------
    callable
        A decorator. The decorated function draws in the house style, and raises `InputError` if the figure does not
        apply.
    """

    def entered(draw: Callable[..., Figure]) -> Callable[..., Figure]:
        in_style = styled(draw)

        @wraps(draw)
        def drawn(*given: Any, **options: Any) -> Figure:
            if not applies(*given):
                raise InputError(f"the figure {name!r} needs {needs}")
            return in_style(*given, **options)

        drawn.__doc__ = _documented(draw, results)
        said = [" ".join(part.split()) for part in (inspect.getdoc(draw) or "").split("\n\n")]
        words = caption or "".join(part for part in said[1:2] if "---" not in part), alternative or said[0]
        entry = FigureEntry(name, drawn, title, *words, section, applies, needs, narrow)
        for result in results:
            _TABLE.setdefault(result, {})[name] = entry
        return drawn

    return entered


def _documented(draw: Callable[..., Figure], results: tuple[type, ...]) -> str:
    """Complete the docstring of a drawing function by its parameters and its return value."""
    said = inspect.getdoc(draw) or ""
    if "Parameters\n---" in said:
        return said
    several = inspect.getfullargspec(draw).varargs is not None
    taken = f"{'*results' if several else 'result'} : {' or '.join(each.__name__ for each in results)}"
    return f"{said}\n\nParameters\n----------\n{taken}\n\nReturns\n-------\nFigure"


def figures_of(result: type) -> dict[str, FigureEntry]:
    """List the figures of a type of result by name, in the order of the report."""
    return dict(_TABLE.get(result, {}))


def applicable(*results: Any) -> Iterator[FigureEntry]:
    """List the figures that apply to these results, all of one type."""
    return (entry for entry in figures_of(type(results[0])).values() if entry.applies(*results))


def drawn_figure(name: str, *results: Any) -> Figure:
    """Draw a figure by its name.

    Raises
    ------
    InputError
        If there is no figure of that name, or the results lack its data.
    """
    known = figures_of(type(results[0]))
    if name not in known:
        raise InputError(f"there is no figure {name!r} of this result; there are {', '.join(known) or 'none'}")
    return known[name].draw(*results)
