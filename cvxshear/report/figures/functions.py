"""What records show over frequency: measured functions beside those of the identified modes, and their coherence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cvxshear.errors import InputError
from cvxshear.modal import ModalResult
from cvxshear.modal.functions import Functions
from cvxshear.modal.synthesis import band_of, synthesized
from cvxshear.report.figures.style import (
    BEFORE,
    COLOURS,
    LINES,
    PAGE_WIDTH,
    QUIET,
    assorted,
    grid_of,
    letters,
    logarithmic,
    new_figure,
    panels,
    styled,
)

FUNCTIONS = {
    "acceleration": "accelerance, (m/s²)/N",
    "velocity": "mobility, (m/s)/N",
    "displacement": "receptance, m/N",
}
"""What a response over a force is called."""


@styled
def functions(*results: ModalResult) -> Figure:
    """Measured functions beside those that the identified modes make, floor by floor.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    Figure
        One panel a record and floor; of several driving points the one that the floor answers most.

    Raises
    ------
    InputError
        Where a result holds no functions.
    """
    figure, drawn = _panels_of(results, 1.75)
    place = 0
    for result in results:
        seen, made = _functions_of(result), synthesized(result)
        shown = band_of(seen.frequencies, result.frequencies)
        strongest = np.argmax(np.sum(np.abs(seen.values[shown]) ** 2, axis=0), axis=1)
        for output, column in enumerate(strongest):
            axes = drawn[place]
            place += 1
            lines = seen.frequencies[shown]
            axes.plot(lines, np.abs(seen.values[shown, output, column]), color="black", lw=0.8, label="measured")
            axes.plot(lines, np.abs(made[shown, output, column]), color=BEFORE, ls="--", lw=1.1, label="of the modes")
            axes.set_yscale("log")
            logarithmic(axes.yaxis, most=5)
            _dress(axes, result, f"floor {seen.floors[output]}{_against(seen, int(column))}", several=len(results) > 1)
    figure.supylabel(_named(_functions_of(results[0])), fontsize=8.5)
    figure.legend(*drawn[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@styled
def coherence(*results: ModalResult) -> Figure:
    """The coherence of each floor's response with what drove it.

    Parameters
    ----------
    *results : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    Figure
        One panel a record and floor, one line a driving point. Where no input was measured, the coherence with the
        highest floor, which has no panel of its own.

    Raises
    ------
    InputError
        Where a result holds no functions, or they are no averages.
    """
    figure, drawn = _panels_of(results, 1.35, reference=False)
    place = 0
    for result in results:
        seen = _functions_of(result)
        if seen.coherence is None:
            raise InputError(f"{result.name}: coherence takes two hits or more at each floor, or a continuous record")
        shown = band_of(seen.frequencies, result.frequencies)
        inputs = len(seen.inputs)
        for output in _outputs(seen, reference=False):
            axes = drawn[place]
            place += 1
            marks = zip(assorted(COLOURS, inputs), assorted(LINES, inputs), strict=True)
            for column, (colour, line) in enumerate(marks):
                values = seen.coherence[shown, output, column]
                label = _against(seen, column).removeprefix(", ") or "input"
                axes.plot(seen.frequencies[shown], values, color=colour, ls=line, lw=0.9, label=label)
            axes.set_ylim(0, 1.04)
            axes.set_yticks([0, 0.5, 1])
            _dress(axes, result, f"floor {seen.floors[output]}", several=len(results) > 1)
    figure.supylabel("coherence", fontsize=8.5)
    labelled = {label: handle for handle, label in zip(*_all_labels(drawn), strict=True)}
    figure.legend(list(labelled.values()), list(labelled), loc="outside upper center", ncols=4)
    return figure


def _functions_of(result: ModalResult) -> Functions:
    if result.functions is None:
        raise InputError(f"{result.name}: the functions of the record were not kept (identify_modes: functions=True)")
    return result.functions


def _outputs(seen: Functions, *, reference: bool) -> list[int]:
    """The floors that have a panel; the coherence of a reference with itself is no news."""
    return [
        place
        for place, floor in enumerate(seen.floors)
        if reference or seen.driven or len(seen.floors) == 1 or floor not in seen.inputs
    ]


def _panels_of(results: Sequence[ModalResult], height: float, *, reference: bool = True) -> tuple[Figure, list[Axes]]:
    counts = [len(_outputs(_functions_of(result), reference=reference)) for result in results]
    most = max(counts)
    columns = min(most, 4 if most > 9 else 3)
    rows, columns = grid_of(sum(counts), columns)
    figure = new_figure(PAGE_WIDTH, height * rows + 0.7)
    figure.supxlabel("frequency, Hz", fontsize=8.5)
    return figure, panels(figure, sum(counts), columns)


def _dress(axes: Axes, result: ModalResult, title: str, *, several: bool) -> None:
    for frequency in result.frequencies:
        axes.axvline(float(frequency), color=QUIET, lw=0.5, alpha=0.6, zorder=0)
    axes.set_title(f"{letters(result.name, 20)}\n{title}" if several else title, fontsize=7.5)
    axes.grid(axis="y")
    axes.tick_params(labelsize=7)


def _against(seen: Functions, column: int) -> str:
    """What a function is taken against, in words; nothing for the ground."""
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


def _all_labels(drawn: Sequence[Axes]) -> tuple[list[Artist], list[str]]:
    pairs = [axes.get_legend_handles_labels() for axes in drawn]
    return [handle for handles, _ in pairs for handle in handles], [label for _, labels in pairs for label in labels]
