"""Draw figures of records: poles over model order, functions and coherence; a click on a pole chooses it."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cvxshear.io.record_file import write_pick
from cvxshear.records import ModalResult
from cvxshear.records.adapters import band_of, synthesized
from cvxshear.records.picking import Sweep
from cvxshear.records.prepare import Functions
from cvxshear.report.describe.from_records import method_in_words
from cvxshear.report.figures import style
from cvxshear.report.figures.style import figure
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

LABEL_WIDTH = 0.14
"""Width of a vertical label, inch."""
BAND = 0.42
"""Height of the labels above the orders, as a fraction of the orders' height."""
HIGHEST = 1.3
"""End of the axis of frequencies, as a multiple of the highest natural frequency."""
POLES: dict[str, dict[str, Any]] = {
    "pole": {"marker": ".", "color": "#B5B5B5", "ms": 3.0},
    "stable": {"marker": "+", "color": style.BEFORE, "ms": 4.5, "mew": 0.8},
    "of a mode": {"marker": "o", "color": style.AFTER, "ms": 3.4},
}


@figure(
    "stabilization",
    ModalResult,
    title="Stabilization diagram",
    applies=lambda *results: all(result.sweep is not None for result in results),
    needs="an order sweep: modes that were identified from a record here",
    narrow=True,
)
def stabilization(*results: ModalResult) -> Figure:
    """Poles over model order: all of them, the stable ones, and those the modes rest on.

    Poles of models of growing order. A pole that comes back from order to order is stable; the values of a mode are
    medians over its poles. The grey curve is the mode indicator function, logarithmic.

    Parameters
    ----------
    *results : ModalResult
        Results of `identify_modes`, one panel each. Results with `functions` show the mode indicator function too.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If a result has no order sweep.
    """
    most = max(len(result.frequencies) for result in results)
    figure = style.new_figure(max(style.page_width(), LABEL_WIDTH * most + 1.4), 3.4 * len(results) + 0.5)
    for axes, result in zip(style.panels(figure, len(results), 1), results, strict=True):
        assert result.sweep is not None
        if result.functions is not None:
            _indicator(axes, result)
        _poles(axes, result.sweep)
        top = max(poles.order for poles in result.sweep.poles)
        axes.set_xlim(0.0, HIGHEST * float(result.frequencies[-1]))
        axes.set_ylim(0, (1 + BAND) * top)
        axes.set_yticks(range(0, top + 1, max(2, top // 6 // 2 * 2)))
        _labels(axes, result, top, figure.get_figwidth() - 1.0)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel("model order (states)", y=0.5 / (1 + BAND))
        title = f"{style.letters(result.name)}: {method_in_words(result)}"
        axes.set_title("\n".join(textwrap.wrap(title, 40)) if style.narrow_page() else title)
    style.legend(figure, figure.axes[0])
    return figure


def _poles(axes: Axes, sweep: Sweep) -> None:
    chosen = {place for item in sweep.chosen for place in item.members}
    points: dict[str, list[tuple[float, int]]] = {label: [] for label in POLES}
    for i, poles in enumerate(sweep.poles):
        stable = set(sweep.stable[i])
        for j, frequency in enumerate(poles.frequencies):
            kind = "of a mode" if (i, j) in chosen else "stable" if j in stable else "pole"
            points[kind].append((float(frequency), poles.order))
    for label, look in POLES.items():
        frequencies, orders = [x for x, _ in points[label]], [y for _, y in points[label]]
        axes.plot(frequencies, orders, ls="none", label=label, **look)


def _indicator(axes: Axes, result: ModalResult) -> None:
    """Draw the singular values of the functions on a logarithmic axis without scale; only their form matters."""
    assert result.functions is not None
    behind = axes.twinx()
    lines = result.functions.frequencies
    values = result.functions.indicator[:, :2]
    shown = (lines > 0.2 * result.frequencies[0]) & (lines < HIGHEST * result.frequencies[-1])
    for place, column in enumerate(values.T):
        behind.plot(lines[shown], column[shown], color=style.GREY, lw=0.9, ls=":" if place else "-", alpha=0.8)
    behind.set_yscale("log")
    low, high = float(values[shown, 0].min()), float(values[shown, 0].max())
    behind.set_ylim(low, low * (high / low) ** (1 + BAND))
    behind.yaxis.set_visible(False)
    behind.spines["right"].set_visible(False)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.plot([], [], color=style.GREY, lw=0.9, alpha=0.8, label="mode indicator function")


def _labels(axes: Axes, result: ModalResult, top: int, inches: float) -> None:
    """Write vertical labels of modes above the poles, without overlaps, each with a line to its pole."""
    frequencies: Floats = result.frequencies
    end = axes.get_xlim()[1]
    gap = end * LABEL_WIDTH / inches
    for mode, frequency, x in zip(
        result.modes, frequencies, style.spread(frequencies, gap, gap / 2, end - gap / 2), strict=True
    ):
        axes.plot([frequency, frequency, x], [0, 1.03 * top, 1.1 * top], color=style.AFTER, lw=0.6, alpha=0.6)
        axes.text(x, 1.12 * top, f"{mode}: {frequency:#.4g} Hz", rotation=90, ha="center", va="bottom", fontsize=7)


FUNCTIONS = {
    "acceleration": "accelerance, (m/s²)/N",
    "velocity": "mobility, (m/s)/N",
    "displacement": "receptance, m/N",
}
"""Axis labels of the ratio of each response to a force."""


@figure(
    "functions",
    ModalResult,
    title="Measured and synthesized functions",
    applies=lambda *results: all(result.functions is not None for result in results),
    needs="the functions of the record (identify_modes: functions=True)",
    narrow=True,
)
def functions(*results: ModalResult) -> Figure:
    """Measured functions beside those that the identified modes make, floor by floor.

    What was measured, and what the identified poles and shapes make of it, residual terms included. Where the
    curves differ, a mode is missing or its shape is wrong. Grey lines: the natural frequencies.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    Figure
        One panel for each record and floor. With several driving points, the panel shows the strongest response.

    Raises
    ------
    InputError
        If a result has no functions.
    """
    figure, groups = _panels_of(results, 1.75)
    for result, drawn in zip(results, groups, strict=True):
        seen, made = _functions_of(result), synthesized(result)
        drawn[0].set_ylabel(_named(seen), fontsize=7)
        shown = band_of(seen.frequencies, result.frequencies)
        strongest = np.argmax(np.sum(np.abs(seen.values[shown]) ** 2, axis=0), axis=1)
        lines = seen.frequencies[shown]
        for output, (axes, column) in enumerate(zip(drawn, strongest, strict=True)):
            axes.plot(lines, np.abs(seen.values[shown, output, column]), color="black", lw=0.8, label="measured")
            axes.plot(
                lines, np.abs(made[shown, output, column]), color=style.BEFORE, ls="--", lw=1.1, label="of the modes"
            )
            axes.set_yscale("log")
            style.logarithmic(axes.yaxis, most=5)
            _dress(axes, result, f"floor {seen.floors[output]}{_against(seen, int(column))}", several=len(results) > 1)
    style.legend(figure, groups[0][0], 2)
    return figure


@figure(
    "coherence",
    ModalResult,
    title="Coherence",
    applies=lambda *results: all(
        result.functions is not None and result.functions.coherence is not None for result in results
    ),
    needs="two hits or more at each floor, or a continuous record",
    narrow=True,
)
def coherence(*results: ModalResult) -> Figure:
    """Coherence of each floor's response with what drove it, over frequency.

    The share of each response that is due to the input; where no input was measured, what it has in common with the
    highest floor. Low values beside a resonance are usual, low values at one are not.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    Figure
        One panel for each record and floor, one line for each driving point. Without a measured input, the figure shows
        the coherence with the highest floor.

    Raises
    ------
    InputError
        If a result has no functions, or its functions are not averages.
    """
    figure, groups = _panels_of(results, 1.35)
    drivers = {_driver(seen, at): floor for seen in map(_functions_of, results) for at, floor in enumerate(seen.inputs)}
    labels = sorted(drivers, key=drivers.__getitem__)
    looks = {label: {**look, "marker": ""} for label, look in zip(labels, style.looks(len(labels)), strict=True)}
    for result, drawn in zip(results, groups, strict=True):
        seen = _functions_of(result)
        assert seen.coherence is not None
        shown = band_of(seen.frequencies, result.frequencies)
        for output, axes in enumerate(drawn):
            for column in range(len(seen.inputs)):
                values = seen.coherence[shown, output, column]
                axes.plot(seen.frequencies[shown], values, lw=0.9, **looks[_driver(seen, column)])
            axes.set(ylim=(0, 1.04), yticks=[0, 0.5, 1])
            _dress(axes, result, f"floor {seen.floors[output]}", several=len(results) > 1)
    figure.supylabel("coherence", fontsize=8.5)
    handles = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _driver(seen: Functions, column: int) -> str:
    return _against(seen, column).removeprefix(", ") or "base motion"


def _functions_of(result: ModalResult) -> Functions:
    assert result.functions is not None
    return result.functions


def _panels_of(results: Sequence[ModalResult], height: float) -> tuple[Figure, list[list[Axes]]]:
    """Arrange the panels, one for each floor; each record begins a new row."""
    counts = [len(_functions_of(result).floors) for result in results]
    most = max(counts)
    columns = style.even_columns(most, 1 if style.narrow_page() else 4 if most > 9 else 3)
    figure = style.new_figure(style.page_width(), height * sum(-(-count // columns) for count in counts) + 0.7)
    figure.supxlabel("frequency, Hz", fontsize=8.5)
    return figure, style.panels_by_group(figure, counts, columns)


def _dress(axes: Axes, result: ModalResult, title: str, *, several: bool) -> None:
    for frequency in result.frequencies:
        axes.axvline(float(frequency), color=style.GREY, lw=0.5, alpha=0.6, zorder=0)
    axes.set_title(f"{style.letters(result.name, 20)}\n{title}" if several else title, fontsize=7.5)
    axes.grid(axis="y")
    axes.tick_params(labelsize=7)


def _against(seen: Functions, column: int) -> str:
    """Name the reference of a function; empty for the ground."""
    floor = int(seen.inputs[column])
    if not seen.driven:
        return f", with floor {floor}"
    return f", force at floor {floor}" if floor else ""


def _named(seen: Functions) -> str:
    if not seen.driven:
        return "half-spectrum"
    if not seen.inputs[0]:
        return f"{seen.quantity} / base acceleration"
    return FUNCTIONS[seen.quantity]


CLICK_DISTANCE = 12.0
"""Largest distance of a click from its pole's frequency in pixels: a fingertip's width on a usual screen."""
WITHOUT_WINDOW = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template", "inline")
"""Backends of matplotlib that draw files or images and receive no clicks."""


class PolePicker:
    """Chooses modes among the stable poles of a record.

    Parameters
    ----------
    result : ModalResult
        Result of `identify_modes`; its modes are the first choice.
    record_file : str or Path, optional
        Record file; each click writes the choice to its key `pick`.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        The diagram.
    """

    def __init__(self, result: ModalResult, record_file: str | Path | None = None) -> None:
        self.figure: Figure = stabilization(result)
        assert result.sweep is not None  # the diagram has been drawn from it
        self._file = record_file
        self._stories = result.stories
        self._poles = np.array([item.frequency for item in result.sweep.candidates])
        self._chosen = {int(np.argmin(np.abs(self._poles - item.frequency))) for item in result.sweep.chosen}
        self._axes = self.figure.axes[0]
        self._lines: list[Any] = []
        self.figure.canvas.mpl_connect("button_press_event", self._clicked)
        self._mark()

    @property
    def frequencies(self) -> list[float]:
        """Chosen frequencies, Hz, ascending."""
        return [float(self._poles[place]) for place in sorted(self._chosen)]

    def _clicked(self, event: Any) -> None:
        if event.inaxes is not self._axes or not len(self._poles):
            return
        across = self._axes.transData.transform(np.column_stack([self._poles, np.zeros(len(self._poles))]))[:, 0]
        place = int(np.argmin(np.abs(across - event.x)))
        if abs(across[place] - event.x) > CLICK_DISTANCE:
            return
        if place in self._chosen:
            self._chosen.discard(place)
        elif len(self._chosen) < self._stories:
            self._chosen.add(place)
        if self._file is not None and self._chosen:
            write_pick(self._file, self.frequencies)
        self._mark()

    def _mark(self) -> None:
        while self._lines:
            self._lines.pop().remove()
        self._lines += [self._axes.axvline(frequency, color=style.AFTER, lw=1.2) for frequency in self.frequencies]
        said = ", ".join(f"{frequency:.4g}" for frequency in self.frequencies) or "none"
        # The title is on the left: in the middle it would overlap the diagram's own title.
        self._axes.set_title(f"click poles to choose; chosen: {said} Hz (at most {self._stories})", loc="left")
        self.figure.canvas.draw_idle()


def opened(result: ModalResult, record_file: str | Path | None) -> PolePicker:
    """Open the picker in a window or in a notebook cell; a script waits until the window is closed.

    Raises
    ------
    InputError
        If the backend of matplotlib shows no windows.
    """
    from matplotlib import pyplot  # noqa: PLC0415 - it settles the backend, which importing the figures must not

    backend = pyplot.get_backend().lower()
    if backend in WITHOUT_WINDOW or backend.endswith("backend_inline"):
        raise InputError(
            f'matplotlib\'s backend "{backend}" knows of no clicks: in a notebook run %matplotlib widget (needs '
            'ipympl), elsewhere set MPLBACKEND to "qtagg", "tkagg" or "webagg" (a browser page); in a terminal: '
            "cvxshear modes RECORD --pick list"
        )
    picker: list[PolePicker] = []

    def drawn(*_: Any, **__: Any) -> Figure:
        picker.append(PolePicker(result, record_file))
        return picker[0].figure

    pyplot.figure(FigureClass=drawn)  # type: ignore[arg-type]  # called as a class is: returns the figure to be shown
    pyplot.show()
    return picker[0]
