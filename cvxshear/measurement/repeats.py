"""Measurements that repeat each other: rows of mode shapes that are one mode, configurations that are one test."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cvxshear.util.typing import Floats

if TYPE_CHECKING:
    from cvxshear.measurement.experiment import Experiment

ALIKE = 1e-12
"""Two shapes are taken to be the same where the squared sine of the angle between them is less."""

ENTRIES_OF_A_COPY = 3
"""Where floors are missing two modes may look alike in one or two entries; the same three are a copied row."""

NUMBERS_OF_A_COPY = 3
"""Two tests may round to the same frequency or two; no two agree in the same three numbers to the last digit."""


def copied_rows(shapes: Floats) -> tuple[int, int] | None:
    """The first two rows with the same numbers in the same places, of which there are several.

    Parameters
    ----------
    shapes : ndarray, shape (m, n)
        nan where not measured.

    Returns
    -------
    tuple of (int, int) or None
    """
    seen: dict[bytes, int] = {}
    for row, shape in enumerate(shapes):
        if np.isfinite(shape).sum() >= ENTRIES_OF_A_COPY and (before := seen.setdefault(shape.tobytes(), row)) != row:
            return before, row
    return None


def proportional_rows(shapes: Floats) -> tuple[int, int] | None:
    """The first two rows that were measured everywhere and are proportional to each other.

    Parameters
    ----------
    shapes : ndarray, shape (m, n)
        nan where not measured.

    Returns
    -------
    tuple of (int, int) or None
    """
    places = np.flatnonzero(np.isfinite(shapes).all(axis=1))
    if len(places) < 2:
        return None
    whole = shapes[places]
    # Scaled by the largest entry first, so that no square overflows or vanishes.
    whole = whole / np.max(np.abs(whole), axis=1, keepdims=True)
    whole = whole / np.linalg.norm(whole, axis=1, keepdims=True)
    later, earlier = np.nonzero(np.tril((whole @ whole.T) ** 2 >= 1 - ALIKE, -1))
    return (int(places[earlier[0]]), int(places[later[0]])) if later.size else None


def repeated_configurations(experiment: Experiment) -> tuple[tuple[str, ...], ...]:
    """Configurations that repeat each other to the last digit: one test, however often it is listed.

    Parameters
    ----------
    experiment : Experiment

    Returns
    -------
    tuple of tuple of str
        Names of the configurations of each group of two or more, in the order of the file. Those of a group have the
        same added mass, modes, floors, frequencies and mode shapes, of which `NUMBERS_OF_A_COPY` at least are measured.
    """
    groups: dict[tuple[bytes, ...], list[str]] = {}
    for each in experiment.configurations:
        if len(each.frequencies) + int(np.isfinite(each.mode_shapes).sum()) < NUMBERS_OF_A_COPY:
            continue
        parts = (each.added_mass, each.modes, each.measured_floors, each.frequencies, each.mode_shapes)
        groups.setdefault(tuple(np.asarray(part).tobytes() for part in parts), []).append(each.name)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)
