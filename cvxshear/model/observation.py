"""The observation matrix: from the motions of a frame to sensor readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cvxshear.util.typing import Floats, Ints

ALL = slice(None)
"""Index of every floor."""


@dataclass(frozen=True, eq=False)
class Observation:
    """y = C q: the reading y of a sensor on each of N floors, from the n motions q of the frame.

    A shear frame has one motion a floor, and C is the identity. An attached mass is one motion more, which no sensor
    shows; the gain of a sensor scales its row of C.

    Parameters
    ----------
    matrix : ndarray, shape (N, n)
        C.
    slopes : mapping of int to ndarray, shape (N, n)
        dC by each parameter that C depends on; parameters that are not there leave it as it is.
    """

    matrix: Floats
    slopes: Mapping[int, Floats] = field(default_factory=dict)

    def shown(self, motion: Floats, floors: slice | Ints = ALL) -> Floats:
        """Return readings on some of the floors, shape (..., f), of motions of shape (..., n)."""
        if self._plain:
            return motion[..., floors]
        return np.asarray(motion @ self.matrix[floors].T)

    def shown_slopes(self, motion: Floats, slopes: Floats, which: slice, floors: slice | Ints = ALL) -> Floats:
        """Return derivatives of the readings by some of the parameters, shape (p, m, f).

        Parameters
        ----------
        motion : ndarray, shape (m, n)
        slopes : ndarray, shape (p, m, n)
            Derivatives of the motion.
        which : slice
            Place of the p parameters among the parameters of the fit.
        floors : index, optional
        """
        found = self.shown(slopes, floors)
        rows = {parameter: row for row, parameter in enumerate(range(max(self.slopes, default=-1) + 1)[which])}
        moved = [(rows[parameter], slope) for parameter, slope in self.slopes.items() if parameter in rows]
        if moved:
            found = found.copy()
        for row, slope in moved:
            found[row] += motion @ slope[floors].T
        return found

    @property
    def gain(self) -> Floats:
        """Gain of the sensor on each floor for the motion of this floor, shape (N,)."""
        return np.ones(len(self.matrix)) if self._plain else np.diagonal(self.matrix).copy()

    @property
    def _plain(self) -> bool:
        return False

    def scaled(self, floor: int, factor: float, own: int) -> Observation:
        """Multiply the readings of one floor, counted from 0, by a factor that grows by one with parameter `own`."""
        matrix = self.matrix.copy()
        slopes = {parameter: slope.copy() for parameter, slope in self.slopes.items()}
        slopes.setdefault(own, np.zeros_like(matrix))
        for slope in slopes.values():
            slope[floor] *= factor
        slopes[own][floor] += matrix[floor]
        matrix[floor] *= factor
        return Observation(matrix, slopes)

    def extended(self) -> Observation:
        """Put the same sensors on a frame of one motion more, which none of them shows."""
        none = np.zeros((len(self.matrix), 1))
        return Observation(
            np.hstack([self.matrix, none]),
            {parameter: np.hstack([slope, none]) for parameter, slope in self.slopes.items()},
        )


class FloorObservation(Observation):
    """The identity, which is never multiplied by: a frame of 2,000 stories would pay for it.

    Parameters
    ----------
    floors : int
        N.
    """

    def __init__(self, floors: int) -> None:
        object.__setattr__(self, "_floors", floors)
        object.__setattr__(self, "slopes", {})

    _floors: int

    @property
    def matrix(self) -> Floats:
        """As of `Observation`."""
        return np.eye(self._floors)

    @property
    def _plain(self) -> bool:
        return True

    @property
    def gain(self) -> Floats:
        return np.ones(self._floors)
