"""Define the table of figures and their house style, and write figures to files and pages.

Reports, notebooks, the command line and the gallery of the documentation use the same table. The decorator `figure`
adds a drawing function to it, in this package or in a user's module.

The colours are from the set of Okabe and Ito, which colour-blind readers can distinguish. A marker, a line style or
a hatch repeats the meaning of each colour.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, wraps
from io import BytesIO
from itertools import cycle
from pathlib import Path
from threading import RLock
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font
from matplotlib.ticker import AutoLocator, LogFormatter, LogLocator

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats
from cvxshear.util.writing import ending_of, write_file

PlotArguments = ParamSpec("PlotArguments")

MEASURED = "#000000"
BEFORE = "#D55E00"
AFTER = "#0072B2"
GREY = "#767676"
PALE = "#DCE9F2"
COLOURS = (AFTER, BEFORE, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "oo")
DASHES = ("-", "--", "-.", ":")

#: Largest number of steps between the ticks of an axis: matplotlib's own number depends on the user's settings.
MOST_TICKS = 5

#: Width of a figure on an A4 page between its margins, inch.
PAGE_WIDTH = 7.2

#: Height of a line of text, inch.
LINE = 0.18

#: Largest number of panels in a row, and of states, floors or stories with their own panel; the tables list all.
MOST_PANELS = 4

#: Largest number of letters of a name in a figure.
LONGEST_NAME = 26

#: Fonts for names with letters that DejaVu Sans lacks; used if installed.
OTHER_SCRIPTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Micro Hei", "Microsoft YaHei", "PingFang SC", "SimHei",
)  # fmt: skip

#: Settings of the house style for matplotlib.
SETTINGS: dict[Any, Any] = dict(
    mpl.rc_params_from_file(Path(__file__).with_name("house.mplstyle"), use_default_template=False)
)

#: Lock for drawing and writing figures: matplotlib has one set of settings for all threads.
_SETTINGS_LOCK = RLock()


@cache
def families() -> tuple[str, ...]:
    """Find the installed fonts for figures, in order of preference."""
    installed = set(font_manager.get_font_names())
    return ("DejaVu Sans", *(name for name in OTHER_SCRIPTS if name in installed))


@cache
def _fonts() -> tuple[FT2Font, ...]:
    return tuple(font_manager.get_font(font_manager.findfont(name, fallback_to_default=True)) for name in families())


@contextmanager
def house_settings() -> Iterator[None]:
    """Apply the house style to matplotlib, for one thread at a time; restore the user's settings at the end."""
    with _SETTINGS_LOCK, mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(SETTINGS | {"font.family": list(families())})
        yield


def styled(draw: Callable[PlotArguments, Figure]) -> Callable[PlotArguments, Figure]:
    """Draw a figure in the house style without a change of the user's settings."""

    @wraps(draw)
    def drawn(*args: PlotArguments.args, **kwargs: PlotArguments.kwargs) -> Figure:
        with house_settings():
            figure = draw(*args, **kwargs)
            # The layout is computed once: later drawing under other settings does not move the parts.
            for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
                locator = axis.get_major_locator()
                if isinstance(locator, AutoLocator):
                    locator.set_params(nbins=MOST_TICKS)
                elif isinstance(locator, LogLocator):
                    locator.set_params(numticks=MOST_TICKS)
                    # Names may contain dollars, so that no text is parsed as a formula.
                    axis.set_major_formatter(LogFormatter())
                    axis.set_minor_formatter(LogFormatter())
            engine = figure.get_layout_engine()
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine(None)
        return figure

    return drawn


class ShownFigure(Figure):
    """A matplotlib figure that a notebook shows as the last expression of a cell, without pyplot or a magic."""

    def _repr_png_(self) -> bytes:
        return encoded(self, "png")


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure, inch, with a layout that prevents overlaps of the parts."""
    return ShownFigure(figsize=(width, height), layout="constrained")


def panels(count: int, columns: int, row: float, more: float = 0.0, **options: Any) -> tuple[Figure, list[Axes]]:
    """Make a figure of `count` panels in a grid, as `panels_by_group` does; unused places stay empty."""
    figure, groups = panels_by_group([count], columns, row, more, **options)
    return figure, groups[0]


def panels_by_group(
    counts: Sequence[int], columns: int, row: float, more: float = 0.0, *, width: float = PAGE_WIDTH,
    sharex: bool = False, sharey: bool = False,
) -> tuple[Figure, list[list[Axes]]]:  # fmt: skip
    """Make a figure with panels for each group; each group begins a new row.

    Parameters
    ----------
    counts : sequence of int
        Number of panels of each group.
    columns : int
        Largest number of panels in a row.
    row, more, width : float
        Height of a row, height beside all rows, and width, inch.
    sharex, sharey : bool, optional
        Whether all panels have the same axis.
    """
    columns = min(columns, max(counts))
    rows = [-(-count // columns) for count in counts]
    figure = new_figure(width, sum(rows) * row + more)
    grid = figure.subplots(sum(rows), columns, squeeze=False, sharex=sharex, sharey=sharey)
    groups: list[list[Axes]] = []
    lowest: dict[int, Axes] = {}
    for count, taken, first in zip(counts, rows, np.cumsum([0, *rows[:-1]]), strict=True):
        there: list[Axes] = list(grid[first : first + taken].ravel())
        groups.append(there[:count])
        lowest |= {place % columns: axes for place, axes in enumerate(there[:count])}
        for unused in there[count:]:
            unused.remove()
    if sharex:
        # The lowest panel of each column shows the tick labels, also above empty places of the grid.
        for axes in lowest.values():
            axes.tick_params(labelbottom=True)
    return figure, groups


def legend(figure: Figure, columns: int | None = None, *, left: bool = False) -> None:
    """Put a legend with one entry for each label of all panels on the figure, by default in one row."""
    entries = [axes.get_legend_handles_labels() for axes in figure.axes]
    kept = {label: handle for handles, labels in entries for handle, label in zip(handles, labels, strict=True)}
    place: Any = "outside upper left" if left else "outside upper center"
    figure.legend(kept.values(), kept.keys(), loc=place, ncols=columns or max(len(kept), 1))


def looks(count: int) -> list[dict[str, Any]]:
    """Choose a colour, line style and marker for each of `count` lines in one panel."""
    marks = zip(range(count), cycle(COLOURS), cycle(DASHES), cycle(MARKERS), strict=False)
    return [{"color": colour, "ls": line, "marker": marker} for _, colour, line, marker in marks]


def even_columns(most: int, fitting: int) -> int:
    """Compute the number of columns that fills the rows of the largest group best, at most `fitting`."""
    return -(-most // -(-most // fitting))


def letters(text: str, longest: int = LONGEST_NAME) -> str:
    """Write a text from a file for a figure: one line, limited length, only letters that the fonts contain."""
    line = " ".join(text.split())
    if len(line) > longest:
        line = line[: longest - 1].rstrip() + "…"
    return "".join(each if any(font.get_char_index(ord(each)) for font in _fonts()) else "□" for each in line)


def spread(positions: Floats, gap: float, low: float, high: float) -> Floats:
    """Move ascending positions of labels apart by at least a gap, between two ends, each near its own place."""
    placed = np.asarray(positions, dtype=float).copy()
    gap = min(gap, (high - low) / max(len(placed) - 1, 1))
    for i in range(len(placed)):
        placed[i] = max(placed[i], low if i == 0 else placed[i - 1] + gap)
    for i in reversed(range(len(placed))):
        placed[i] = min(placed[i], high if i == len(placed) - 1 else placed[i + 1] - gap)
    return placed


FIGURE_KINDS = ("svg", "png", "pdf")

#: Pixels of a page for one point of a figure; the letters get the size of the page's text.
ENLARGED = 1.4

#: Pattern of a colour in an SVG style; a dark page replaces the colour.
_COLOUR = re.compile(r"(?<=[: ])#([0-9A-Fa-f]{6})(?=[;\"])")


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure into a file, in one piece.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        Ending in .svg, .png or .pdf; a device receives SVG.

    Raises
    ------
    InputError
        If the ending is unknown, or the file cannot be written.
    """
    write_file(path, encoded(figure, ending_of(path, FIGURE_KINDS, "a figure is written as")))


def encoded(figure: Figure, kind: str, *, transparent: bool = False) -> bytes:
    """Write a figure as the content of a file; the same figure gives the same bytes."""
    no_date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    out = BytesIO()
    with house_settings():
        FigureCanvasAgg(figure)
        figure.savefig(out, format=kind, metadata=no_date, transparent=transparent)
    # matplotlib copies every text into an unescaped comment; names from files must not reach the page this way.
    return re.sub(rb"<!--.*?-->", b"", out.getvalue(), flags=re.DOTALL) if kind == "svg" else out.getvalue()


def inline_svg(figure: Figure, name: str) -> str:
    """Write a figure as an SVG element for a page.

    Parameters
    ----------
    figure : Figure
    name : str
        Prefix of its ids, which keeps the ids of several figures on a page different; a plain word.
    """
    # The background is transparent: the page's shade then marks an edge where a wide drawing continues.
    text = encoded(figure, "svg", transparent=True).decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Equal images would have equal ids; no element refers to these ids.
    text = re.sub(r'(<image\b[^>]*?) id="[^"]*"', r"\1", text)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    # The page contains the alternative text; screen readers skip the drawing itself.
    width = ENLARGED * 72 * figure.get_figwidth()
    head = re.sub(r' (width|height)="[\d.]+pt"', "", text[: text.index(">")])
    size = f'width="{width:.0f}" style="--width: {width:.0f}px"'
    body = _COLOUR.sub(lambda found: f"var(--c{found[1].lower()}, #{found[1]})", text[text.index(">") :])
    head = head.replace("<svg ", f'<svg aria-hidden="true" focusable="false" {size} ', 1)
    return head + body


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
    caption_of : callable
        Takes the results and returns the text below the figure.
    alternative : str
        Description for readers who cannot see the figure.
    section : str
        Key of the report section that ends with the figure; if empty, the figure has its own section.
    applies : callable
        Takes the results and returns whether they contain the data of the figure.
    needs : str
        Required data of the results, in words.
    """

    name: str
    draw: Callable[..., Figure]
    title: str
    caption_of: Callable[..., str]
    alternative: str
    section: str
    applies: Callable[..., bool]
    needs: str


#: Condition of the figures of frames with one motion per floor, and what they need.
OF_ONE_MOTION: dict[str, Any] = {
    "applies": lambda result: not result.experiment.frame.turns,
    "needs": "one motion per floor",
}

#: Figures by the type of their result, in the order of a report.
FIGURE_TABLE: dict[type, dict[str, FigureEntry]] = {}


def figure(
    name: str,
    *results: type,
    title: str,
    caption: Callable[..., str] | None = None,
    section: str = "",
    applies: Callable[..., bool] = lambda *results: True,
    needs: str = "",
) -> Callable[[Callable[..., Figure]], Callable[..., Figure]]:
    """Add a drawing function to the table of figures, for each type of result that the function draws.

    The first line of the function's docstring describes the figure for readers who cannot see it.

    Parameters
    ----------
    name : str
    *results : type
        Types such as `LoopResult`. If the user names a file and no figure, the first figure of a type is drawn.
    title, section, applies, needs
        As in `FigureEntry`.
    caption : callable, optional
        Takes the results and returns the text below the figure. Default: the second paragraph of the docstring.

    Returns
    -------
    callable
        A decorator. The decorated function draws in the house style, and raises `InputError` if the figure does not
        apply.
    """

    def entered(draw: Callable[..., Figure]) -> Callable[..., Figure]:
        in_style = styled(draw)
        said = [" ".join(part.split()) for part in (inspect.getdoc(draw) or "").split("\n\n")]
        own = "".join(part for part in said[1:2] if "---" not in part)

        @wraps(draw)
        def drawn(*given: Any, **options: Any) -> Figure:
            if not applies(*given):
                raise InputError(f"the figure {name!r} needs {needs}")
            return in_style(*given, **options)

        entry = FigureEntry(name, drawn, title, caption or (lambda *_: own), said[0], section, applies, needs)
        for result in results:
            FIGURE_TABLE.setdefault(result, {})[name] = entry
        return drawn

    return entered


def figures_of(result: type) -> dict[str, FigureEntry]:
    """List the figures of a type of result by name, in the order of the report."""
    return dict(FIGURE_TABLE.get(result, {}))


def applicable(*results: Any) -> Iterator[FigureEntry]:
    """List the figures that apply to these results, all of one type."""
    return (entry for entry in figures_of(type(results[0])).values() if entry.applies(*results))


def figure_named(name: str, result: type) -> FigureEntry:
    """Find a figure of a type of result by its name; the first figure without a name.

    Raises
    ------
    InputError
        If there is no figure of that name.
    """
    known = figures_of(result)
    name = name or next(iter(known), "")
    if name not in known:
        there = ", ".join(known) or "none"
        raise InputError(f"there is no figure {name!r} here; there are {there}{checks.near(name, known)}")
    return known[name]


def drawn_figure(name: str, *results: Any) -> Figure:
    """Draw a figure by its name.

    Raises
    ------
    InputError
        If there is no figure of that name, or the results lack its data.
    """
    return figure_named(name, type(results[0])).draw(*results)
