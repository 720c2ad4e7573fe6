"""Rows of mode shapes that are one and the same mode."""

from __future__ import annotations

import numpy as np

from cvxshear.util.typing import Floats

ALIKE = 1e-12
"""Two shapes are taken to be the same where the squared sine of the angle between them is less."""

ENTRIES_OF_A_COPY = 3
"""Where floors are missing two modes may look alike in one or two entries; the same three are a copied row."""


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
