"""The house style of the figures, and figures as files and as parts of a page.

Colours are of the set of Okabe and Ito, which the colour-blind can distinguish; whatever a colour says, a marker, a
line style or a hatch says as well.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font
from matplotlib.ticker import FuncFormatter, LogLocator

from cvxshear.util.typing import Floats, Ints
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

PAGE_WIDTH = 7.2
"""Width of a figure on an A4 page between its margins, inch."""

NARROW_WIDTH = 3.6
"""Width of a figure on a telephone of 390 pixels, inch: letters are as large as on a wide page."""

SHAPES_A_ROW = 5
"""Panels of mode shapes side by side on a page."""

LONGEST_NAME = 26
"""Letters of a name that a figure shows."""

OTHER_SCRIPTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Micro Hei", "Microsoft YaHei", "PingFang SC", "SimHei",
)  # fmt: skip
"""Fonts for names that DejaVu Sans has no letters for; used where one is installed."""

SETTINGS: dict[Any, Any] = dict(
    mpl.rc_params_from_file(Path(__file__).with_name("house.mplstyle"), use_default_template=False)
)
"""What the house style sets in matplotlib."""

_SETTINGS_LOCK = RLock()
"""Held while a figure is drawn or written: matplotlib has one set of settings for all threads."""

_narrow: list[bool] = []
"""Not empty while a figure is drawn for a telephone; only changed by the thread that holds the lock."""


def settings() -> dict[Any, Any]:
    """Collect what to set for as long as a figure is made or written."""
    return {**SETTINGS, "font.family": list(families())}


@cache
def families() -> tuple[str, ...]:
    """Find the fonts that are used here, in order of preference."""
    installed = set(font_manager.get_font_names())
    return ("DejaVu Sans", *(name for name in OTHER_SCRIPTS if name in installed))


@cache
def _fonts() -> tuple[FT2Font, ...]:
    return tuple(font_manager.get_font(font_manager.findfont(name, fallback_to_default=True)) for name in families())


@contextmanager
def house_settings() -> Iterator[None]:
    """Set matplotlib as the house has it, for one thread at a time; the user's settings are restored at the end."""
    with _SETTINGS_LOCK, mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings())
        yield


@contextmanager
def for_narrow_page() -> Iterator[None]:
    """Draw figures for a telephone: panels below one another rather than side by side."""
    with _SETTINGS_LOCK:
        _narrow.append(True)
        try:
            yield
        finally:
            _narrow.pop()


def narrow_page() -> bool:
    """Whether the figure that is drawn now is for a telephone."""
    return bool(_narrow)


def page_width() -> float:
    """Width of the page that the figure is drawn for, inch."""
    return NARROW_WIDTH if narrow_page() else PAGE_WIDTH


def styled(draw: Callable[PlotArguments, Figure]) -> Callable[PlotArguments, Figure]:
    """Make a figure in the house style, and leave the user's settings as they were."""

    @wraps(draw)
    def drawn(*args: PlotArguments.args, **kwargs: PlotArguments.kwargs) -> Figure:
        with house_settings():
            figure = draw(*args, **kwargs)
            # The layout is found once; what is drawn later, under whichever settings, stays where it is.
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

    def _repr_svg_(self) -> str:
        return encoded(self, "svg").decode("utf-8")


def new_figure(width: float, height: float, *, fixed: bool = False) -> Figure:
    """Make an empty figure, inch, whose parts make room for each other unless their places are fixed."""
    return ShownFigure(figsize=(width, height), layout=None if fixed else "constrained")


def grid_of(panels: int, columns: int) -> tuple[int, int]:
    """Rows and columns for a number of panels."""
    columns = max(1, min(columns, panels))
    return -(-panels // columns), columns


def panels(figure: Figure, count: int, columns: int, *, sharex: bool = False, sharey: bool = False) -> list[Axes]:
    """So many panels in a grid; the places left over stay empty."""
    return panels_by_group(figure, [count], columns, sharex=sharex, sharey=sharey)[0]


def panels_by_group(
    figure: Figure, counts: Sequence[int], columns: int, *, sharex: bool = False, sharey: bool = False
) -> list[list[Axes]]:
    """So many panels for each group, and each group on rows of its own."""
    columns = max(1, min(columns, max(counts)))
    rows = [-(-count // columns) for count in counts]
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
        # The lowest panel of a column tells the numbers, also where the grid's last row does not reach it.
        for axes in lowest.values():
            axes.tick_params(labelbottom=True)
    return groups


def legend(figure: Figure, axes: Axes, columns: int | None = None, *, left: bool = False) -> None:
    """Put the legend of one panel's lines on the whole figure, in one row where the columns are not said."""
    handles, labels = axes.get_legend_handles_labels()
    place: Any = "outside upper left" if left else "outside upper center"
    figure.legend(handles, labels, loc=place, ncols=columns or (2 if narrow_page() else max(len(labels), 1)))


def looks(count: int) -> list[dict[str, Any]]:
    """Colours with a line and a marker each, for so many lines in one panel."""
    marks = zip(range(count), cycle(COLOURS), cycle(DASHES), cycle(MARKERS), strict=False)
    return [{"color": colour, "ls": line, "marker": marker} for _, colour, line, marker in marks]


def error_bars(axes: Axes, values: Floats, heights: Floats | Ints, std: Floats | None, **look: Any) -> None:
    """Measured values over the height with one standard deviation on either side."""
    axes.errorbar(values, heights, xerr=std, fmt="o", color=MEASURED, ms=3.0, capsize=2.0, lw=0.9, **look)


def even_columns(most: int, fitting: int) -> int:
    """Columns for so many panels a group where so many fit: those that fill its rows best."""
    return -(-most // -(-most // fitting))


def shape_grid(counts: Sequence[int], stories: int, narrowest: float) -> tuple[int, int, float, float]:
    """Lay out panels of mode shapes, so many a group: columns, rows, and height of a panel and width of all, inch."""
    fitting = 2 if narrow_page() else SHAPES_A_ROW
    columns = even_columns(max(counts), fitting)
    width = page_width() if narrow_page() else max(PAGE_WIDTH * columns / fitting, narrowest)
    return columns, sum(-(-count // columns) for count in counts), float(np.clip(0.16 * stories, 1.6, 3.0)), width


def letters(text: str, longest: int = LONGEST_NAME) -> str:
    """Write a text from a file as a figure can show it: on one line, not too long, of letters that the fonts have."""
    line = " ".join(text.split())
    if len(line) > longest:
        line = line[: longest - 1].rstrip() + "…"
    return "".join(each if any(font.get_char_index(ord(each)) for font in _fonts()) else "□" for each in line)


def power_of_ten(value: float, _: object = None) -> str:
    """Tick label of a logarithmic axis, such as 10⁻³."""
    if value == 0 or not np.isfinite(value):
        return "0"
    exponent = np.log10(abs(value))
    if abs(exponent - round(exponent)) > 1e-6:
        return ""
    sign = "−" if value < 0 else ""
    number = round(exponent)
    if 0 <= number <= 3:
        return f"{sign}{10**number}"
    return f"{sign}10{str(number).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


NARROW = 1.3
"""Decades of an axis up to which two and five are labelled between the powers of ten."""


def logarithmic(axis: Axis, most: int = 7) -> None:
    """Ticks at powers of ten, labelled so; at twice and five times them too where there is one at most."""

    def between(value: float, _: object = None) -> str:
        low, high = axis.get_view_interval()
        first = value / 10.0 ** np.floor(np.log10(value) + 1e-9)
        few = low > 0 and high / low < 10.0**NARROW and min(abs(first - 2), abs(first - 5)) < 1e-6
        return f"{value:g}" if few and 1e-3 <= value < 1e5 else ""

    axis.set_major_locator(LogLocator(numticks=most))
    axis.set_major_formatter(FuncFormatter(power_of_ten))
    axis.set_minor_formatter(FuncFormatter(between))


def spread(positions: Floats, gap: float, low: float, high: float) -> Floats:
    """Positions of labels, ascending, at least a gap apart and between two ends, each near where it belongs."""
    placed = np.asarray(positions, dtype=float).copy()
    gap = min(gap, (high - low) / max(len(placed) - 1, 1))
    for i in range(len(placed)):
        placed[i] = max(placed[i], low if i == 0 else placed[i - 1] + gap)
    for i in reversed(range(len(placed))):
        placed[i] = min(placed[i], high if i == len(placed) - 1 else placed[i + 1] - gap)
    return placed


FIGURE_KINDS = ("svg", "png", "pdf")
ENLARGED = 1.4
"""Pixels of a page a point of a figure: letters of the size of the text around them."""

RESOLUTION = 200
"""Dots an inch of a PNG."""


_COLOUR = re.compile(r"(?<=[: ])#([0-9A-Fa-f]{6})(?=[;\"])")
"""A colour in a style of an SVG drawing; a page that is dark gives its own for it."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure into a file, in one piece.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        Ending in .svg, .png or .pdf; a device is written SVG to.

    Raises
    ------
    InputError
        Where the ending is another, or the file cannot be written.
    """
    write_file(path, encoded(figure, ending_of(path, FIGURE_KINDS, "a figure is written as")))


def encoded(figure: Figure, kind: str, *, transparent: bool = False) -> bytes:
    """Write a figure as the content of a file; the same figure gives the same bytes."""
    no_date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    out = BytesIO()
    with house_settings():
        FigureCanvasAgg(figure)
        figure.savefig(out, format=kind, dpi=RESOLUTION, metadata=no_date, transparent=transparent)
    # matplotlib puts every text into a comment beside its outlines, where a name would stand as it is.
    return re.sub(rb"<!--.*?-->", b"", out.getvalue(), flags=re.DOTALL) if kind == "svg" else out.getvalue()


def inline_svg(figure: Figure, name: str) -> str:
    """Write a figure as an SVG element to stand in a page.

    Parameters
    ----------
    figure : Figure
    name : str
        Sets its ids apart from those of the other figures of the page; a plain word.
    """
    # The page shows through, and with it the shade at an edge beyond which a drawing goes on.
    text = encoded(figure, "svg", transparent=True).decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Two pictures that are the same would have the same id, to which nothing refers.
    text = re.sub(r'(<image\b[^>]*?) id="[^"]*"', r"\1", text)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = text.replace("url(#", f"url(#{name}-")
    # The page says what a figure shows; the drawing itself is nothing to be read out.
    width = ENLARGED * 72 * figure.get_figwidth()
    head = re.sub(r' (width|height)="[\d.]+pt"', "", text[: text.index(">")])
    size = f'width="{width:.0f}" style="--width: {width:.0f}px"'
    body = _COLOUR.sub(lambda found: f"var(--c{found[1].lower()}, #{found[1]})", text[text.index(">") :])
    head = head.replace("<svg ", f'<svg aria-hidden="true" focusable="false" {size} ', 1)
    return head + body
