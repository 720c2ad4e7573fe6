"""What the modes of a shear frame on the ground look like, and the one slip that would spoil it.

Its stiffness matrix is a Jacobi matrix, so mode r changes sign r - 1 times from the ground up (Gantmacher
and Krein 1950), and the first mode grows with height.
"""

from __future__ import annotations

import itertools

import numpy as np

from cvxshear.modal.shapes import sign_changes
from cvxshear.util.typing import Floats

SLACK = 0.02
"""Of the largest entry: by so much noise may bend the first mode."""


def fits(shapes: Floats) -> bool:
    """Whether shapes, shape (m, n), could be modes of a shear frame, the first its lowest."""
    lowest = np.abs(shapes[0])
    return _signs_fit(shapes) and bool(np.all(np.diff(lowest) > -SLACK * lowest.max()))


def flipped(shapes: Floats) -> int | None:
    """The one channel that moves against all others in the lowest mode, and whose sign mends every mode."""
    if len(shapes) < 2:
        return None
    first = shapes[0] * (1.0 if np.sum(np.sign(shapes[0])) >= 0 else -1.0)
    against = np.flatnonzero(first < -SLACK * np.abs(first).max())
    if len(against) != 1:
        return None
    signs = np.where(np.arange(shapes.shape[1]) == against[0], -1.0, 1.0)
    return int(against[0]) if fits(shapes * signs) else None


def exchanged(shapes: Floats) -> tuple[int, int] | None:
    """The two channels whose exchange mends every mode; the nearest where several pairs do, None where none is needed.

    A shear frame may have a mode that a pair of exchanged channels has as well; so the exchange must mend the
    lowest mode's growth, and at least one mode besides it must be there to agree.
    """
    if len(shapes) < 2 or fits(shapes):
        return None
    pairs = []
    for i, j in itertools.combinations(range(shapes.shape[1]), 2):
        order = np.arange(shapes.shape[1])
        order[[i, j]] = j, i
        if fits(shapes[:, order]):
            pairs.append((i, j))
    return min(pairs, key=lambda pair: pair[1] - pair[0]) if pairs else None


def _signs_fit(shapes: Floats) -> bool:
    changes = [sign_changes(shape) for shape in shapes]
    return changes[0] == 0 and all(b > a for a, b in itertools.pairwise(changes))
