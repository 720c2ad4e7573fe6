"""Draw modal assurance criteria of measured and modelled modes, and shapes of modes identified from records."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from cvxshear.data.pairing import mac as mac_of
from cvxshear.fit.results import Identification
from cvxshear.loop import LoopResult
from cvxshear.records import ModalResult
from cvxshear.records.mode_shapes import scaled_to_one
from cvxshear.report.figures import style
from cvxshear.report.figures.drawn_shapes import mac_tables
from cvxshear.report.figures.figure_table import figure
from cvxshear.util.quantities import percents
from cvxshear.util.typing import Floats

MOST_NUMBERED = 8
"""Largest number of modes for a matrix with numbers in its cells."""

MAC_ROUNDING = 1e-12
"""Largest difference of a MAC from 1 by rounding, for two equal shapes."""


@figure(
    "mac",
    LoopResult,
    Identification,
    title="Measured and modelled modes",
    alternative="Modal assurance criterion of every measured mode with every mode of the final model.",
    section="shapes",
    applies=lambda result: any(each.measured.any() for each in result.experiment.configurations),
    needs="measured mode shapes",
    narrow=True,
)
def mac(result: LoopResult | Identification) -> Figure:
    """Draw the MAC matrix of each configuration.

    The modal assurance criterion (1 for the same shape, 0 for unrelated ones) of every measured mode with every
    mode of the model: where the diagonal is light and the rest is dark, every mode was recognised.

    Each configuration has one panel; dark is 0, light is 1, also in black and white.
    """
    modes = {each.name: each.modes.tolist() for each in result.experiment.configurations}
    every = list(range(1, result.experiment.stories + 1))
    matrices = [(name, table, modes[name], every) for name, table in mac_tables(result)]
    most = 1 if style.narrow_page() else 3 if len(every) <= 4 else 2
    return _matrices(matrices, most, "measured mode", "mode of the model")


def _matrices(matrices: Sequence[tuple[str, Floats, list[int], list[int]]], most: int, row: str, column: str) -> Figure:
    """Draw MAC matrices with their titles and the mode numbers of rows and columns, at most `most` in a row."""
    rows, columns = style.grid_of(len(matrices), most)
    side = 2.6 if style.narrow_page() else style.PAGE_WIDTH / most
    figure = style.new_figure(side * columns + 0.9, rows * (side + 0.3))
    drawn = style.panels(figure, len(matrices), columns)
    for axes, (name, table, measured, modelled) in zip(drawn, matrices, strict=True):
        image = draw_matrix(axes, table, measured, modelled)
        axes.set(title=style.letters(name), xlabel=column, ylabel=row)
    figure.colorbar(image, ax=drawn, label="MAC (1: the same shape)", shrink=0.8)
    return figure


def draw_matrix(axes: Axes, table: Floats, rows: list[int], columns: list[int]) -> AxesImage:
    """Draw a MAC matrix with its mode numbers, and with its values if the cells are large enough."""
    image = axes.imshow(table, vmin=0, vmax=1, cmap="cividis", aspect="auto")
    step = 1 if len(columns) <= 10 else 2
    axes.set_xticks(range(0, len(columns), step), [str(mode) for mode in columns[::step]])
    axes.set_yticks(range(0, len(rows), step), [str(mode) for mode in rows[::step]])
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    if len(columns) <= MOST_NUMBERED:
        _numbers(axes, table)
    return image


def _numbers(axes: Axes, table: Floats) -> None:
    digits = 4 if table.shape[1] <= 4 else 2
    for (row, column), value in np.ndenumerate(table):
        if not np.isnan(value):
            # A dark page exchanges pure black and white, but not the colours of the cells. These colours stay as they
            # are.
            colour = "#010101" if value > 0.5 else "#FEFEFE"
            axes.text(column, row, written(value, digits), ha="center", va="center", color=colour, fontsize=6.5)


def written(value: float, digits: int) -> str:
    """Round a MAC to `digits` decimals; only equal shapes are written as 1.

    Parameters
    ----------
    value : float
    digits : int
    """
    shown = f"{value:.{digits}f}"
    if float(shown) < 1 or value > 1 - MAC_ROUNDING:
        return shown
    return f"> {1 - 10.0**-digits:.{digits}f}"


@figure(
    "shapes",
    ModalResult,
    title="Mode shapes",
    alternative="Mode shapes; the numbers are in the table above.",
    narrow=True,
)
def modal_shapes(*results: ModalResult) -> Figure:
    """Draw the shapes of identified modes, one panel a record and mode, with one standard deviation on either side.

    Real normal modes, the largest entry 1; bars are one standard deviation.

    The largest entry is 1; a mode has the same sign in all records.
    """
    counts = [len(result.frequencies) for result in results]
    stories = max(result.stories for result in results)
    columns, rows, tall, width = style.shape_grid(counts, stories, 4.0)
    figure = style.new_figure(width, rows * (tall + 0.65) + 0.4)
    groups = style.panels_by_group(figure, counts, columns, sharex=True, sharey=True)
    facing: dict[int, tuple[ModalResult, Floats]] = {}
    for result, drawn in zip(results, groups, strict=True):
        for row, (axes, mode) in enumerate(zip(drawn, result.modes, strict=True)):
            shape = _facing(result, scaled_to_one(result.mode_shapes[row]), facing, int(mode))
            _panel(axes, result, row, shape, stories)
            if row % columns == 0:
                axes.set_ylabel("floor")
    figure.supxlabel("sway (largest entry = 1)", fontsize=8.5)
    return figure


@figure(
    "mac",
    ModalResult,
    title="Modal assurance criterion",
    alternative="Matrix of the modal assurance criterion of every mode with every other.",
    narrow=True,
)
def modal_mac(*results: ModalResult) -> Figure:
    """Draw the modal assurance criterion of the modes of each record with one another.

    The modes against one another: values beside the diagonal that are not small mean that the sensors hardly
    distinguish two modes.

    Each record has one panel; off-diagonal values near 0 mean that the sensors distinguish the modes.
    """
    matrices = []
    for result in results:
        table = np.array([[mac_of(one, other) for other in result.mode_shapes] for one in result.mode_shapes])
        matrices.append((result.name, table, result.modes.tolist(), result.modes.tolist()))
    return _matrices(matrices, 1 if style.narrow_page() else 3, "mode", "mode")


def _facing(result: ModalResult, shape: Floats, facing: dict[int, tuple[ModalResult, Floats]], mode: int) -> Floats:
    """Give the shape the sign of this mode in the first record, by the floors that both records measured."""
    first, before = facing.setdefault(mode, (result, shape))
    _, mine, theirs = np.intersect1d(result.floors, first.floors, return_indices=True)
    return -shape if shape[mine] @ before[theirs] < 0 else shape


def _panel(axes: Axes, result: ModalResult, row: int, shape: Floats, stories: int) -> None:
    heights = np.concatenate([[0], result.floors])
    axes.axvline(0, color="#C8C8C8", lw=0.5)
    axes.plot(np.concatenate([[0.0], shape]), heights, color=style.AFTER, lw=1.2)
    stds, frequency_std = result.written_entry_std[row], float(result.written_frequency_std[row])
    style.error_bars(axes, shape, result.floors, stds if np.all(np.isfinite(stds)) else None)
    axes.axhline(0, color=style.GREY, lw=0.8)
    axes.set(xlim=(-1.3, 1.3), xticks=[-1, 0, 1], ylim=(0, 1.07 * stories))
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    std = f" ± {percents([frequency_std])[0]}" if np.isfinite(frequency_std) else ""
    title = f"{style.letters(result.name, 18)}\nmode {result.modes[row]}\n{result.frequencies[row]:#.4g} Hz{std}"
    axes.set_title(title, fontsize=7)
