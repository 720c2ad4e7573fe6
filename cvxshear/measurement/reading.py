"""What configurations read, as the screening takes it: rows that can be turned, exchanged and renumbered; copies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.typing import Bools, Floats, Ints

SHAPE_TOLERANCE = 0.03
"""Of a mode's largest entry: so far a real frame's shapes stray from a shear frame's besides the noise."""

FREQUENCY_TOLERANCE = 0.02
"""Relative: so far its frequencies do."""

CLOSER = 0.3
"""The part of both tolerances that suffices for a frame which is nearly a shear frame."""

FARTHER = 3.0
"""The multiple of both that a frame asks for which is far from a shear frame (walls, coupled floors)."""

NUMBERS_OF_A_COPY = 3
"""Two tests may round to the same frequency or two; no two agree in the same three numbers to the last digit."""


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
    log_frequencies, frequency_noise : ndarray, shape (m,)
        Standard deviations of the logarithms.
    shapes, noise : ndarray, shape (m, n)
        nan where not measured; standard deviations in the unit of the entry.
    part : float, optional
        Of the tolerances, which comes on top of the noise.
    """

    stories: int
    modes: Ints
    floors: Ints
    log_frequencies: Floats
    frequency_noise: Floats
    shapes: Floats
    noise: Floats
    part: float = 1.0

    @staticmethod
    def of(configuration: Configuration) -> Reading:
        """Read a configuration that is part of an experiment."""
        return Reading(
            stories=len(configuration.added_mass),
            modes=configuration.modes - 1,
            floors=configuration.measured_floors - 1,
            log_frequencies=np.log(configuration.frequencies),
            frequency_noise=configuration.log_frequency_std,
            shapes=configuration.mode_shapes,
            noise=configuration.entry_std,
        )

    @property
    def known(self) -> Bools:
        """Which entries were measured, shape (m, n)."""
        return np.isfinite(self.shapes)

    @property
    def count(self) -> int:
        """Number of frequencies and entries."""
        return len(self.modes) + int(self.known.sum())

    @property
    def largest(self) -> Floats:
        """The size of each row's largest entry, shape (m, 1); 1 where nothing was measured."""
        size = np.max(np.abs(np.where(self.known, self.shapes, 0.0)), axis=1, keepdims=True, initial=0.0)
        return np.where(size > 0, size, 1.0)

    @property
    def scaled(self) -> Floats:
        """The shapes with a largest entry of size 1, zero where not measured."""
        return np.where(self.known, self.shapes, 0.0) / self.largest

    @property
    def frequency_std(self) -> Floats:
        """Noise and tolerance of the logarithms of the frequencies, shape (m,)."""
        return np.hypot(self.frequency_noise, self.part * FREQUENCY_TOLERANCE)

    @property
    def weights(self) -> Floats:
        """1 / (noise and tolerance) of the scaled entries, shape (m, n); zero where not measured."""
        std = np.hypot(np.where(self.known, self.noise, 1.0) / self.largest, self.part * SHAPE_TOLERANCE)
        return np.where(self.known, 1.0 / std, 0.0)

    @property
    def closer(self) -> Reading:
        """The same reading with the smaller tolerances."""
        return replace(self, part=CLOSER)

    def certainty_lost(self) -> float:
        """Twice the logarithm of all standard deviations together, over that with the smaller tolerances."""
        near, known = self.closer, self.known
        shapes = np.log(near.weights[known] / self.weights[known])
        return 2 * float(np.sum(shapes) + np.sum(np.log(self.frequency_std / near.frequency_std)))


def repeated_configurations(experiment: Experiment) -> tuple[tuple[str, ...], ...]:
    """Group configurations that repeat each other to the last digit: one test, however often it is listed.

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
