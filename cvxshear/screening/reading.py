"""What one configuration reads, as the screening takes it: rows that can be turned, exchanged and renumbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.experiment import Configuration
from cvxshear.typing import Bools, Floats, Ints

SHAPE_TOLERANCE = 0.03
"""Of a mode's largest entry: so far a real frame's shapes stray from a shear frame's besides the noise."""

FREQUENCY_TOLERANCE = 0.02
"""Relative: so far its frequencies do."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Frequencies and shapes of one configuration, the shapes as they were written.

    Parameters
    ----------
    stories : int
    modes : ndarray of int, shape (m,)
        Zero-based.
    floors : ndarray of int, shape (n,)
        Zero-based.
    log_frequencies, frequency_std : ndarray, shape (m,)
        Standard deviations of the logarithms, `FREQUENCY_TOLERANCE` included.
    shapes, std : ndarray, shape (m, n)
        nan where not measured; standard deviations in the unit of the entry, without `SHAPE_TOLERANCE`.
    """

    stories: int
    modes: Ints
    floors: Ints
    log_frequencies: Floats
    frequency_std: Floats
    shapes: Floats
    std: Floats

    @staticmethod
    def of(configuration: Configuration) -> Reading:
        """The reading of a configuration that is part of an experiment."""
        return Reading(
            stories=len(configuration.added_mass),
            modes=configuration.modes - 1,
            floors=configuration.measured_floors - 1,
            log_frequencies=np.log(configuration.frequencies),
            frequency_std=np.hypot(configuration.log_frequency_std, FREQUENCY_TOLERANCE),
            shapes=configuration.mode_shapes,
            std=configuration.entry_std,
        )

    @property
    def known(self) -> Bools:
        """Which entries were measured, shape (m, n)."""
        return np.isfinite(self.shapes)

    @property
    def largest(self) -> Floats:
        """The size of each row's largest entry, shape (m, 1); 1 where nothing was measured."""
        size = np.max(np.abs(np.where(self.known, self.shapes, 0.0)), axis=1, keepdims=True)
        return np.where(size > 0, size, 1.0)

    @property
    def scaled(self) -> Floats:
        """The shapes with a largest entry of size 1, zero where not measured."""
        return np.where(self.known, self.shapes, 0.0) / self.largest

    @property
    def weights(self) -> Floats:
        """1 / standard deviation of the scaled entries, `SHAPE_TOLERANCE` included; zero where not measured."""
        std = np.hypot(np.where(self.known, self.std, 1.0) / self.largest, SHAPE_TOLERANCE)
        return np.where(self.known, 1.0 / std, 0.0)
