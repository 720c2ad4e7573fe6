"""The signs of a mode of a shear frame: mode r changes sign r - 1 times from the ground up.

Its stiffness matrix is a Jacobi matrix, its mass matrix positive and diagonal (Gantmacher and Krein 1950). At some of
the floors mode r changes sign r - 1 times at most. Entries that noise could have turned round count in favour.
"""

from __future__ import annotations

import numpy as np

from cvxshear.measurement.reading import Reading
from cvxshear.util.typing import Floats

CERTAIN = 5.0
"""Standard deviations from zero, `SHAPE_TOLERANCE` included, from which on an entry's sign is taken as it is."""


def certain_signs(reading: Reading) -> Floats:
    """Find the sign of each entry, shape (m, n): 1, -1, or 0 where it cannot be told or was not measured."""
    scaled = reading.scaled
    return np.where(np.abs(scaled) * reading.weights > CERTAIN, np.sign(scaled), 0.0)


def fewest_changes(signs: Floats) -> int:
    """Count changes of sign among the entries whose sign is certain."""
    sure = signs[signs != 0]
    return int(np.sum(sure[1:] != sure[:-1]))


def most_changes(signs: Floats) -> int:
    """Count changes of sign where the uncertain entries (0) have the signs that make the most of them.

    Over a distance of d floors there are d changes at most, and an odd number of them just where the signs differ.
    """
    places = np.flatnonzero(signs)
    if not len(places):
        return len(signs) - 1
    distance, differ = np.diff(places), np.diff(signs[places]) != 0
    within = np.sum(distance - (distance % 2 != differ))
    return int(within + places[0] + len(signs) - 1 - places[-1])


def violations(reading: Reading) -> list[str]:
    """Name the modes whose signs no shear frame's mode of that number has, a part of a sentence for each."""
    signs = certain_signs(reading)
    whole = len(reading.floors) == reading.stories
    return [
        said
        for number, row, known in zip(reading.modes + 1, signs, reading.known, strict=True)
        if known.any() and (said := _violation(int(number), row, whole=whole))
    ]


def _violation(number: int, signs: Floats, *, whole: bool) -> str:
    """Say what is wrong with one mode; empty where nothing is. Entries not measured can have had any sign."""
    right = number - 1
    least = fewest_changes(signs)
    if least > right:
        return f"mode {number} changes sign {_times(least)} from the ground up, and a shear frame's {_times(right)}"
    most = most_changes(signs)
    if whole and most < right:
        return f"mode {number} changes sign {_times(most)} from the ground up, and a shear frame's {_times(right)}"
    return ""


def _times(count: int) -> str:
    return {0: "not at all", 1: "once", 2: "twice"}.get(count, f"{count} times")
