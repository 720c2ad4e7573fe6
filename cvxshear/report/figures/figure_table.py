"""The table of figures: each with its drawing, its words, and the results that it can be drawn of.

Reports, notebooks, the command line and the gallery of the documentation read this table and nothing else. A figure is
added by `figure`, which stands above the function that draws it, in this package or in anybody's own module.
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
"""A text, or a function of the results that makes it."""


@dataclass(frozen=True)
class FigureEntry:
    """A figure of one kind of result.

    Parameters
    ----------
    name : str
        By which it is asked for, such as in `--figure name:OUT.svg`.
    draw : callable
        Takes the results and returns the figure.
    title : str
        What it shows, as a heading.
    caption : str or callable
        What stands below it; a callable takes the results.
    alternative : str or callable
        What it shows, for those who cannot see it.
    section : str
        Key of the section of the report that it closes; a section of its own below its title where empty.
    applies : callable
        Takes the results and says whether they hold what the figure shows.
    needs : str
        What the results must hold, in words.
    narrow : bool
        Whether the drawing asks `narrow_page` and has a form that fits a telephone.
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
        """Write what stands below the figure of these results."""
        return self.caption if isinstance(self.caption, str) else self.caption(*results)

    def alternative_of(self, *results: Any) -> str:
        """Say what the figure of these results shows, for those who cannot see it."""
        return self.alternative if isinstance(self.alternative, str) else self.alternative(*results)


_TABLE: dict[type, dict[str, FigureEntry]] = {}
"""Figures by the type of their result, in the order in which a report shows them."""


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
    """Enter a function that draws into the table of figures, for each type of result that it draws.

    Parameters
    ----------
    name : str
    *results : type
        Such as `Closure`; the first figure of a type is drawn where a file is named and no kind.
    title, caption, alternative, section, applies, needs, narrow
        As in `FigureEntry`; where empty, the alternative text is the first line of the function's docstring and the
        caption its second paragraph.

    Returns
    -------
    callable
        A decorator; what it returns draws in the house style, and raises `InputError` where the figure does not apply.
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
    """Write the docstring of a function that draws, with what all of them take and return."""
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
    """List the figures that can be drawn of these results, all of one type."""
    return (entry for entry in figures_of(type(results[0])).values() if entry.applies(*results))


def drawn_figure(name: str, *results: Any) -> Figure:
    """Draw a figure by its name.

    Raises
    ------
    InputError
        Where there is no figure of that name, or the results do not hold what it shows.
    """
    known = figures_of(type(results[0]))
    if name not in known:
        raise InputError(f"there is no figure {name!r} of this result; there are {', '.join(known) or 'none'}")
    return known[name].draw(*results)
