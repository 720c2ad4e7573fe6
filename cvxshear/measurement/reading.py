"""The data of a configuration for the screening: rows that can be turned and renumbered, signs, copies.

The signs of a mode of a shear frame: mode r changes sign r - 1 times from the ground up. Its stiffness matrix is a
Jacobi matrix, its mass matrix positive and diagonal (Gantmacher and Krein 1950). At some of the floors mode r changes
sign r - 1 times at most. Entries that noise could have turned round count in favour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cvxshear.measurement.configuration import ENTRIES_OF_A_COPY
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.typing import Bools, Floats, Ints

#: Typical difference between the shapes of a real frame and a shear frame, relative to a mode's largest entry.
SHAPE_TOLERANCE = 0.03

#: Typical relative difference between the frequencies of a real frame and a shear frame.
FREQUENCY_TOLERANCE = 0.02

#: Factor on both tolerances that suffices for a frame which is nearly a shear frame.
CLOSER = 0.3

#: Factor on both tolerances for a frame which is far from a shear frame (walls, coupled floors).
FARTHER = 3.0

#: The sign of an entry is certain if its distance from zero exceeds this number of standard deviations.
CERTAIN = 5.0


@dataclass(frozen=True, eq=False)
class MeasuredModes:
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
    def of(configuration: Configuration) -> MeasuredModes:
        """Read a configuration that is part of an experiment."""
        return MeasuredModes(
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
        """Size of the largest entry of each row, shape (m, 1); 1 for a row without measured entries."""
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
    def closer(self) -> MeasuredModes:
        """The same reading with the smaller tolerances."""
        return replace(self, part=CLOSER)

    def certainty_lost(self) -> float:
        """Twice the sum of log standard deviations; those of shapes are relative to the smaller tolerances."""
        shapes = np.log(self.closer.weights[self.known] / self.weights[self.known])
        return 2 * float(np.sum(shapes) + np.sum(np.log(self.frequency_std)))


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


def violations(reading: MeasuredModes) -> list[str]:
    """Name the modes whose signs no shear frame's mode of that number has, a part of a sentence for each."""
    scaled = reading.scaled
    signs = np.where(np.abs(scaled) * reading.weights > CERTAIN, np.sign(scaled), 0.0)
    whole = len(reading.floors) == reading.stories
    return [
        said
        for number, row, known in zip(reading.modes + 1, signs, reading.known, strict=True)
        if known.any() and (said := _violation(int(number), row, whole=whole))
    ]


def _violation(number: int, signs: Floats, *, whole: bool) -> str:
    """Return the mistake in one mode as a text, or an empty text. Entries that were not measured may have any sign."""
    right = number - 1
    found = max(fewest_changes(signs), min(right, most_changes(signs)) if whole else right)
    if found == right:
        return ""
    return f"mode {number} changes sign {_times(found)} from the ground up, and a shear frame's {_times(right)}"


def _times(count: int) -> str:
    return {0: "not at all", 1: "once", 2: "twice"}.get(count, f"{count} times")


def repeated_configurations(experiment: Experiment) -> tuple[tuple[str, ...], ...]:
    """Group configurations that repeat each other to the last digit: one test, however often it is listed.

    Parameters
    ----------
    experiment : Experiment

    Returns
    -------
    tuple of tuple of str
        Names of the configurations of each group of two or more, in the order of the file. The tests of a group have
        the same added mass, modes, floors, frequencies and mode shapes, with at least `ENTRIES_OF_A_COPY` measured
        numbers.
    """
    groups: dict[tuple[bytes, ...], list[str]] = {}
    for each in experiment.configurations:
        if len(each.frequencies) + int(np.isfinite(each.mode_shapes).sum()) < ENTRIES_OF_A_COPY:
            continue
        parts = (each.added_mass, each.modes, each.measured_floors, each.frequencies, each.mode_shapes)
        groups.setdefault(tuple(np.asarray(part).tobytes() for part in parts), []).append(each.name)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def without_repeated(experiment: Experiment) -> tuple[Experiment, tuple[tuple[str, str], ...]]:
    """Return the experiment without copies of tests, and a map from each copy's name to the original's name.

    Measured values that agree to the last digit are one measurement: counted twice they would seem twice as sure.
    """
    groups = repeated_configurations(experiment)
    kept = {each.name for each in experiment.configurations if each.state == experiment.frame.reference}
    repeated = tuple((name, first) for first, *others in groups for name in others if name not in kept)
    copies = {name for name, _ in repeated}
    if not copies:
        return experiment, ()
    once = tuple(each for each in experiment.configurations if each.name not in copies)
    states = {each.state for each in once} | {each.state for each in experiment.static}
    expected = tuple(each for each in experiment.expected if each.state is None or each.state in states)
    return replace(experiment, configurations=once, expected=expected), repeated
