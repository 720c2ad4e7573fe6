"""What records show over frequency: measured functions beside those of the identified modes, and their coherence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cvxshear.modal import ModalResult
from cvxshear.modal.functions import Functions, band_of, synthesized
from cvxshear.report.figures.style import (
    BEFORE,
    COLOURS,
    LINES,
    PAGE_WIDTH,
    QUIET,
    assorted,
    even_columns,
    letters,
    logarithmic,
    new_figure,
    panels_by_group,
    styled,
)
from cvxshear.util.errors import InputError

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
    figure, groups = _panels_of(results, 1.75)
    for result, drawn in zip(results, groups, strict=True):
        seen, made = _functions_of(result), synthesized(result)
        shown = band_of(seen.frequencies, result.frequencies)
        strongest = np.argmax(np.sum(np.abs(seen.values[shown]) ** 2, axis=0), axis=1)
        lines = seen.frequencies[shown]
        for output, (axes, column) in enumerate(zip(drawn, strongest, strict=True)):
            axes.plot(lines, np.abs(seen.values[shown, output, column]), color="black", lw=0.8, label="measured")
            axes.plot(lines, np.abs(made[shown, output, column]), color=BEFORE, ls="--", lw=1.1, label="of the modes")
            axes.set_yscale("log")
            logarithmic(axes.yaxis, most=5)
            _dress(axes, result, f"floor {seen.floors[output]}{_against(seen, int(column))}", several=len(results) > 1)
    _label_units(figure, groups, [_named(_functions_of(result)) for result in results])
    figure.legend(*groups[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
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
    figure, groups = _panels_of(results, 1.35, reference=False)
    looks = _looks([_functions_of(result) for result in results])
    for result, drawn in zip(results, groups, strict=True):
        seen = _functions_of(result)
        if seen.coherence is None:
            raise InputError(f"{result.name}: coherence takes two hits or more at each floor, or a continuous record")
        shown = band_of(seen.frequencies, result.frequencies)
        for axes, output in zip(drawn, _outputs(seen, reference=False), strict=True):
            for column in range(len(seen.inputs)):
                values = seen.coherence[shown, output, column]
                axes.plot(seen.frequencies[shown], values, **looks[_driver(seen, column)])
            axes.set_ylim(0, 1.04)
            axes.set_yticks([0, 0.5, 1])
            _dress(axes, result, f"floor {seen.floors[output]}", several=len(results) > 1)
    figure.supylabel("coherence", fontsize=8.5)
    handles = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _label_units(figure: Figure, groups: Sequence[Sequence[Axes]], names: Sequence[str]) -> None:
    """What the functions are: once where they all are the same, else at each record."""
    if len(set(names)) == 1:
        figure.supylabel(names[0], fontsize=8.5)
        return
    for drawn, name in zip(groups, names, strict=True):
        drawn[0].set_ylabel(name, fontsize=7)


def _looks(seen: Sequence[Functions]) -> dict[str, dict[str, Any]]:
    """One look for each that drives, the lowest floor first, whichever records it is in."""
    drivers = {_driver(each, column): int(floor) for each in seen for column, floor in enumerate(each.inputs)}
    labels = sorted(drivers, key=drivers.__getitem__)
    marks = zip(labels, assorted(COLOURS, len(labels)), assorted(LINES, len(labels)), strict=True)
    return {label: {"color": colour, "ls": line, "lw": 0.9} for label, colour, line in marks}


def _driver(seen: Functions, column: int) -> str:
    return _against(seen, column).removeprefix(", ") or "base motion"


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


def _panels_of(
    results: Sequence[ModalResult], height: float, *, reference: bool = True
) -> tuple[Figure, list[list[Axes]]]:
    """The panels of each record, on rows of its own."""
    counts = [len(_outputs(_functions_of(result), reference=reference)) for result in results]
    most = max(counts)
    columns = even_columns(most, 4 if most > 9 else 3)
    figure = new_figure(PAGE_WIDTH, height * sum(-(-count // columns) for count in counts) + 0.7)
    figure.supxlabel("frequency, Hz", fontsize=8.5)
    return figure, panels_by_group(figure, counts, columns)


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
