"""The noise that a test is expected to have: as declared, or as it follows from how long is recorded.

From a record the modes come with standard deviations that have closed forms where modes are apart, damping is small and
the record long (Au 2014, "Uncertainty law in ambient modal identification"). With N_c = T f the record's length in
periods, zeta the damping and B the part of the data that the band around the mode holds (`band_factors`), the
coefficients of variation of a frequency and of a damping ratio from an ambient record are

    sqrt(zeta / (2 pi N_c B_f)),   1 / sqrt(2 pi zeta N_c B_zeta),

and a shape of unit length scatters in every direction across itself by sqrt(nu zeta / (N_c B_phi)), nu the noise there
over the mode's own force, both as spectral densities. Noise of an ambient record is that of the sensors and, far more
of it, the response of the other modes. Where the force is recorded the other modes are known, and of the force only
the part that its own sensor adds stays unknown: the frequency's law holds with that part as a factor.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD, Configuration
from cvxshear.model.shear import Modes
from cvxshear.util import checks, ranking
from cvxshear.util.typing import Floats, Ints

EXCITATIONS = ("ambient", "shaker", "hammer")
"""Kinds of records whose noise is known, see `Recorded`."""

HAMMER = 0.35
"""Of the shaker's factor: between blows a hammer's force is known to be zero. From the study
`python -m tests.benchmarks.records`, whose hammer records have frequencies that scatter 0.22 to 0.34 times as much as
the law with the whole noise says."""

BAND_WIDTH = 10.0
"""kappa: the band of data around a mode that identification uses is f (1 +- kappa zeta)."""

SAMPLES_A_PERIOD = 6.0
"""Of the highest mode that is identified: the sensors' noise spreads over the band that this makes."""


class TestNoise(ABC):
    """What the modes of a test will be uncertain by."""

    @abstractmethod
    def of(self, found: Modes, mass: Floats, which: Ints) -> tuple[Floats, Floats]:
        """Return standard deviations of the modes of a frame.

        Parameters
        ----------
        found : Modes
            All modes of the tested frame.
        mass : ndarray, shape (N,)
            Its floor masses with added mass, kg.
        which : ndarray of int, shape (m,)
            The modes that are measured, zero-based.

        Returns
        -------
        frequency_std : ndarray, shape (m,)
            Relative.
        mode_shape_std : ndarray, shape (m,)
            Of an entry, the mode's largest entry over all floors being 1.
        """

    def damping_std(self, frequencies: Floats) -> Floats | None:
        """Coefficients of variation of the damping ratios of modes at these frequencies (Hz), where the noise tells."""
        return None

    @property
    @abstractmethod
    def words(self) -> str:
        """What it is, as a sentence has it."""


@dataclass(frozen=True)
class Declared(TestNoise):
    """Noise that is the same for every mode.

    Parameters
    ----------
    frequency_std, mode_shape_std : float
        Relative; of an entry, the mode's largest being 1.
    """

    frequency_std: float = DEFAULT_FREQUENCY_STD
    mode_shape_std: float = DEFAULT_MODE_SHAPE_STD

    def __post_init__(self) -> None:
        checks.number(self.frequency_std, "frequency_std", above=0.0)
        checks.number(self.mode_shape_std, "mode_shape_std", above=0.0)

    @staticmethod
    def of_tests(tests: Sequence[Configuration]) -> Declared:
        """Expect the median of what tests state; the default where they state nothing."""
        if not tests:
            return Declared()
        frequency = np.concatenate([each.log_frequency_std for each in tests])
        # Where nothing was measured no entry has a deviation.
        shapes = [
            (each.entry_std / np.max(np.abs(each.known_shapes), axis=1, keepdims=True))[each.measured]
            for each in tests
            if np.all(np.any(each.measured, axis=1))
        ]
        entries = np.concatenate([*shapes, np.zeros(0)])
        return Declared(
            float(np.median(frequency)), float(np.median(entries)) if len(entries) else DEFAULT_MODE_SHAPE_STD
        )

    def of(self, found: Modes, mass: Floats, which: Ints) -> tuple[Floats, Floats]:
        return np.full(len(which), self.frequency_std), np.full(len(which), self.mode_shape_std)

    @property
    def words(self) -> str:
        return f"frequencies to {100 * self.frequency_std:.3g} %, shapes to {100 * self.mode_shape_std:.3g} %"


@dataclass(frozen=True)
class Recorded(TestNoise):
    """What follows from a record.

    Parameters
    ----------
    excitation : str
        "ambient": forces of equal strength on all floors that nobody records; "shaker": a recorded motion of the base;
        "hammer": recorded blows, as many on every floor.
    duration : float
        s, of all records of a test together.
    damping : float, optional
        Fraction of critical, every mode.
    sensor_noise : float, optional
        Standard deviation of the noise of a channel, relative to that of its signal.
    """

    excitation: str
    duration: float
    damping: float = 0.01
    sensor_noise: float = 0.05

    least_periods: ClassVar[float] = 10.0

    def __post_init__(self) -> None:
        checks.choice(self.excitation, EXCITATIONS, "excitation")
        checks.number(self.duration, "duration", above=0.0)
        checks.number(self.damping, "damping", above=0.0)
        checks.number(self.sensor_noise, "sensor noise", above=0.0)

    def of(self, found: Modes, mass: Floats, which: Ints) -> tuple[Floats, Floats]:
        periods = self.duration * found.frequencies[which]
        checks.number(float(periods.min()), "periods of the lowest mode in the record", least=self.least_periods)
        frequency_std = self._unrecorded * np.sqrt(self.damping / (2 * np.pi * periods * band_factors(BAND_WIDTH)[0]))
        force = self._modal_force(found, mass)
        band = SAMPLES_A_PERIOD * float(found.frequencies[which].max()) / 2
        shape_std = [self._entry_std(found, force, int(mode), band) for mode in which]
        return frequency_std, np.array(shape_std)

    @property
    def _unrecorded(self) -> float:
        """The part of the force that nothing recorded, over the whole."""
        return {"ambient": 1.0, "shaker": self.sensor_noise, "hammer": HAMMER * self.sensor_noise}[self.excitation]

    def _modal_force(self, found: Modes, mass: Floats) -> Floats:
        """Spectral densities of the modal forces and between them, shape (N, N), up to a factor."""
        if self.excitation == "shaker":
            participation = found.shapes @ mass
            return np.outer(participation, participation)
        return found.shapes @ found.shapes.T

    def _entry_std(self, found: Modes, force: Floats, mode: int, band: float) -> float:
        """Root mean square over the floors of the entries' standard deviations, the largest entry being 1.

        The sensors' noise is spread over the band, Hz.
        """
        phi, f = found.shapes.T, found.frequencies
        own = np.diag(force)
        variance = phi**2 @ (own * np.pi * f / (4 * self.damping))
        spread = np.diag(self.sensor_noise**2 * variance / band)
        if self.excitation == "ambient":
            ratio = f[mode] / np.delete(f, mode)
            gain = ratio**4 / ((1 - ratio**2) ** 2 + (2 * self.damping * ratio) ** 2)
            unexplained = np.delete(own - force[mode] ** 2 / own[mode], mode)
            others = np.delete(phi, mode, axis=1)
            spread = spread + (others * (gain * unexplained)) @ others.T
        spread = spread / own[mode] * self.damping / (self.duration * f[mode] * band_factors(BAND_WIDTH)[2])
        shape = phi[:, mode]
        largest = ranking.first_largest(np.abs(shape))
        # Of phi_i / phi_p, by which the entries are scaled.
        turn = np.eye(len(shape))
        turn[:, largest] -= shape / shape[largest]
        turn /= shape[largest]
        return float(np.sqrt(np.trace(turn @ spread @ turn.T) / len(shape)))

    @property
    def words(self) -> str:
        return (
            f"{self.excitation} records of {self.duration:g} s, damping {100 * self.damping:g} %, sensor noise "
            f"{100 * self.sensor_noise:g} %"
        )

    def damping_std(self, frequencies: Floats) -> Floats:
        periods = self.duration * frequencies
        return self._unrecorded / np.sqrt(2 * np.pi * self.damping * periods * band_factors(BAND_WIDTH)[1])


def band_factors(kappa: float) -> tuple[float, float, float]:
    """Au's data length factors of a band f (1 +- kappa zeta): B_f, B_zeta, B_phi; 1, 1, pi/2 for a wide one.

    The first is 2/pi (atan k - k / (k^2 + 1)), the second 2/pi (atan k + k / (k^2 + 1) - 2 (atan k)^2 / k), the third
    atan k.
    """
    angle, part = np.arctan(kappa), kappa / (kappa**2 + 1)
    return (float(2 / np.pi * (angle - part)), float(2 / np.pi * (angle + part - 2 * angle**2 / kappa)), float(angle))
