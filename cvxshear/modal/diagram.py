"""The stabilization diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cvxshear.errors import InputError
from cvxshear.modal.result import ModalResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def stabilization_diagram(result: ModalResult) -> Figure:
    """Poles over model order: all of them, the stable ones, and those the reported modes rest on.

    Parameters
    ----------
    result : ModalResult
        Of `identify_modes`.

    Returns
    -------
    matplotlib.figure.Figure
        Not bound to any window; `savefig` writes it.

    Raises
    ------
    InputError
        Where the result holds no order sweep, or matplotlib is not installed.
    """
    if result.sweep is None:
        raise InputError("these modes were not identified from a record here: there is no order sweep to draw")
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, loaded to draw
    except ImportError:
        raise InputError("the diagram needs matplotlib: install cvxshear[figures]") from None
    sweep = result.sweep
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    chosen = {place for item in sweep.chosen for place in item.members}
    looks = {"pole": (".", "0.75"), "stable": ("+", "tab:blue"), "of a mode": ("o", "tab:red")}
    points: dict[str, list[tuple[float, int]]] = {label: [] for label in looks}
    for i, poles in enumerate(sweep.poles):
        stable = set(sweep.stable[i])
        for j, frequency in enumerate(poles.frequencies):
            kind = "of a mode" if (i, j) in chosen else "stable" if j in stable else "pole"
            points[kind].append((float(frequency), poles.order))
    for label, (marker, color) in looks.items():
        frequencies, orders = [x for x, _ in points[label]], [y for _, y in points[label]]
        axes.plot(frequencies, orders, marker, color=color, label=label, linestyle="none")
    for mode, frequency in zip(result.modes, result.frequencies, strict=True):
        axes.axvline(float(frequency), color="tab:red", linewidth=0.7, alpha=0.5)
        place = (float(frequency), 1.0)
        axes.annotate(f"mode {mode}", place, xycoords=("data", "axes fraction"), rotation=90, va="top")
    axes.set_xlim(0.0, 1.5 * float(np.max(result.frequencies)))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("model order (states)")
    axes.set_title(f"{result.name}: {result.method}")
    axes.legend(loc="lower right")
    return figure
