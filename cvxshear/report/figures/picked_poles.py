"""Show the stabilization diagram in a window: a click on a pole chooses a mode, a second click removes it."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cvxshear.io.record_file import write_pick
from cvxshear.records import ModalResult
from cvxshear.report.figures import style
from cvxshear.report.figures.frequency_figures import stabilization
from cvxshear.util.errors import InputError

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
