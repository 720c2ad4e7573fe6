"""Expected results of tests that have not been made: their noise, and their derivatives by the parameters of the frame.

The noise is declared, or computed from the length of the record. Modes identified from a record have standard
deviations with closed forms if the modes are separate, the damping is small and the record is long (Au 2014,
"Uncertainty law in ambient modal identification"). N_c = T f is the record's length in periods, zeta the damping ratio
and B the fraction of the data in the band around the mode (`band_factors`). The coefficient of variation of a frequency
from an ambient record is

    sqrt(zeta / (2 pi N_c B_f)).

A shape of unit length scatters in every direction normal to itself by sqrt(nu zeta / (N_c B_phi)). Here nu is the
noise in this direction relative to the mode's own force, both as spectral densities. The noise of an ambient record
consists of the sensors' noise and, mostly, of the response of the other modes. If the force is recorded, the response
of the other modes is known, and only the noise of the force's sensor remains unknown. The law of the frequency then
holds with this noise as a factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg

from cvxshear.fit import misfit
from cvxshear.fit.misfit import ExpectedTest
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD, Configuration
from cvxshear.model import Modes
from cvxshear.planning.choice import Candidates, candidates, free_changes
from cvxshear.planning.design import Design
from cvxshear.records.result import SENSOR_STD
from cvxshear.util import checks, ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats, Ints

UNKNOWN_STDS = 10.0
"""Prior standard deviation of an unknown parameter, relative to its size. A finite value gives every choice, even of a
single sensor, finite standard deviations to compare."""

EXCITATIONS = ("ambient", "shaker", "hammer")
"""Kinds of records with known noise, see `Recorded`."""

HAMMER = 0.35
"""Factor on the unrecorded part of a shaker's force. Between blows a hammer's force is known to be zero. In the study
`python -m tests.studies records`, frequencies of hammer records scatter 0.22 to 0.34 times the value of the law with
the whole noise."""

BAND_WIDTH = 10.0
"""kappa: identification uses the band f (1 +- kappa zeta) around a mode."""

SAMPLES_A_PERIOD = 6.0
"""Samples per period of the highest identified mode. The sensors' noise spreads over the band of this sampling rate."""


@dataclass(frozen=True)
class Declared:
    """Noise that is the same for every mode.

    Parameters
    ----------
    frequency_std, mode_shape_std : float
        Relative deviation of a frequency; deviation of a shape entry if the mode's largest entry is 1.
    """

    frequency_std: float = DEFAULT_FREQUENCY_STD
    mode_shape_std: float = DEFAULT_MODE_SHAPE_STD

    def __post_init__(self) -> None:
        checks.number(self.frequency_std, "frequency_std", above=0.0)
        checks.number(self.mode_shape_std, "mode_shape_std", above=0.0)

    @staticmethod
    def of_tests(tests: Sequence[Configuration]) -> Declared:
        """Return the median of the tests' declared deviations; the default if the tests declare none."""
        if not tests:
            return Declared()
        frequency = np.concatenate([each.log_frequency_std for each in tests])
        # A shape without measured entries has no deviations.
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
        """Return standard deviations of the modes of a frame.

        Parameters
        ----------
        found : Modes
            All modes of the tested frame.
        mass : ndarray, shape (N,)
            Its floor masses with added mass, kg.
        which : ndarray of int, shape (m,)
            The measured modes, zero-based.

        Returns
        -------
        frequency_std : ndarray, shape (m,)
            Relative.
        mode_shape_std : ndarray, shape (m,)
            Standard deviation of an entry; the mode's largest entry over all floors is 1.
        """
        return np.full(len(which), self.frequency_std), np.full(len(which), self.mode_shape_std)

    @property
    def words(self) -> str:
        """Description of the noise, as a part of a sentence."""
        return f"frequencies to {100 * self.frequency_std:.3g} %, shapes to {100 * self.mode_shape_std:.3g} %"


@dataclass(frozen=True)
class Recorded:
    """Noise computed from the length of the record.

    Parameters
    ----------
    excitation : str
        "ambient": unrecorded forces of equal strength on all floors; "shaker": a recorded motion of the base;
        "hammer": recorded blows, equally distributed over the floors.
    duration : float
        Length of all records of a test together, s.
    damping : float, optional
        Damping ratio of every mode.
    sensor_noise : float, optional
        Standard deviation of the noise of a channel, relative to its signal's.
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
        """Return standard deviations of the modes of a frame, see `Declared.of`."""
        periods = self.duration * found.frequencies[which]
        checks.number(float(periods.min()), "periods of the lowest mode in the record", least=self.least_periods)
        frequency_std = self._unrecorded * np.sqrt(self.damping / (2 * np.pi * periods * band_factors(BAND_WIDTH)[0]))
        force = self._modal_force(found, mass)
        band = SAMPLES_A_PERIOD * float(found.frequencies[which].max()) / 2
        shape_std = [self._entry_std(found, force, int(mode), band) for mode in which]
        # Sensors are no better than `modes` says, however long the record is.
        return frequency_std, np.hypot(shape_std, SENSOR_STD)

    @property
    def _unrecorded(self) -> float:
        """Unrecorded part of the force, relative to the whole force."""
        return {"ambient": 1.0, "shaker": self.sensor_noise, "hammer": HAMMER * self.sensor_noise}[self.excitation]

    def _modal_force(self, found: Modes, mass: Floats) -> Floats:
        """Return the spectral densities and cross-densities of the modal forces, shape (N, N), up to a factor."""
        if self.excitation == "shaker":
            participation = found.shapes @ mass
            return np.outer(participation, participation)
        return found.shapes @ found.shapes.T

    def _entry_std(self, found: Modes, force: Floats, mode: int, band: float) -> float:
        """Return the rms over the floors of the entries' standard deviations; the largest entry is 1.

        The sensors' noise is spread over the band (Hz).
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
        spread = spread / own[mode] * self.damping / (self.duration * f[mode] * band_factors(BAND_WIDTH)[1])
        shape = phi[:, mode]
        largest = ranking.first_largest(np.abs(shape))
        # Derivative of phi_i / phi_p: the largest entry phi_p scales the shape.
        turn = np.eye(len(shape))
        turn[:, largest] -= shape / shape[largest]
        turn /= shape[largest]
        return float(np.sqrt(np.trace(turn @ spread @ turn.T) / len(shape)))

    @property
    def words(self) -> str:
        """Description of the noise, as a part of a sentence."""
        return (
            f"{self.excitation} records of {self.duration:g} s, damping {100 * self.damping:g} %, sensor noise "
            f"{100 * self.sensor_noise:g} %"
        )


def band_factors(kappa: float) -> tuple[float, float]:
    """Return Au's data length factors B_f and B_phi of a band f (1 +- kappa zeta); 1 and pi/2 for a wide band.

    With k = kappa, they are 2/pi (atan k - k / (k^2 + 1)) and atan k.
    """
    angle = float(np.arctan(kappa))
    return 2 / np.pi * (angle - kappa / (kappa**2 + 1)), angle


TestNoise = Declared | Recorded
"""Noise of the modes of a test."""


@dataclass(frozen=True, eq=False)
class TestModel:
    """The frame as designed, the goal of the plan, and the noise of its tests.

    Parameters
    ----------
    design : Design
    quantities : tuple of str
        "floor_mass", "story_stiffness", or both: the goal of the plan.
    which : ndarray of int, shape (m,)
        Modes that are measured, zero-based.
    noise : TestNoise
    """

    design: Design
    quantities: tuple[str, ...]
    which: Ints
    noise: TestNoise

    @property
    def numbers(self) -> Ints:
        """Numbers of the modes that are measured, 1 the lowest; shape (m,)."""
        return self.which + 1

    @cached_property
    def question(self) -> Floats:
        """Rows that select the parameters of the plan's goal, shape (s, 2N)."""
        n = self.design.stories
        at = {"floor_mass": slice(0, n), "story_stiffness": slice(n, 2 * n)}
        picked = np.concatenate([np.eye(2 * n)[at[each]] for each in self.quantities])
        # A parameter that is known exactly is not part of the goal.
        return np.asarray(picked[np.linalg.norm(picked @ free_changes(self.fixed), axis=1) > 1e-9])

    @cached_property
    def fixed(self) -> Floats:
        """Rows whose product with every allowed relative change is zero, shape (e, 2N)."""
        return self.design.fixed()

    @cached_property
    def known(self) -> Floats:
        """Prior information as rows in standard deviations, with a weak prior of every parameter, shape (k, 2N)."""
        return np.concatenate([self.design.known(), np.eye(2 * self.design.stories) / UNKNOWN_STDS])

    def expected(self, added_mass: Floats) -> ExpectedTest:
        """Predict a test with these added masses; derivatives are relative to the parameters' sizes."""
        blank = self.design.blank(added_mass, self.numbers)
        model = misfit.tested_model(self.design.shell(), blank, (), self.design.sizes)
        stds = self.noise.of(model.modes, np.diag(model.state.system.M), model.paired)
        frequencies, shapes = misfit.predicted_modes(blank, model)
        shape_std = np.repeat(stds[1][:, None], shapes.shape[1], axis=1)
        test = misfit.expected_configuration(blank, frequencies, shapes, stds[0], shape_std)
        rows = misfit.data_rows(test, model).J * self.design.sizes
        return ExpectedTest(test, rows, test.measured)

    def sensors(self, tests: Sequence[ExpectedTest], number: int) -> Candidates:
        """Return the floors as candidates; each floor is measured in all of these tests."""
        m, n, scales = len(self.which), self.design.stories, len(self.which) * len(tests)
        rows = np.zeros((n, scales, 2 * n + scales))
        for t, test in enumerate(tests):
            own = np.arange(t * m, (t + 1) * m)
            rows[:, own, : 2 * n] = test.shape_rows.swapaxes(0, 1)
            rows[:, own, 2 * n + own] = test.entries.T
        known = linalg.block_diag(
            np.concatenate([self.known, *(test.frequency_rows for test in tests)]), np.eye(scales) / UNKNOWN_STDS
        )
        wide = [np.hstack([part, np.zeros((len(part), scales))]) for part in (self.fixed, self.question)]
        return candidates(known, wide[0], rows, wide[1], number / n)

    def choices(self, tests: Sequence[ExpectedTest], floors: Ints, number: int) -> Candidates:
        """Return the tests as candidates; each test is measured at these floors."""
        rows = np.array([test.at(floors) for test in tests])
        return candidates(self.known, self.fixed, rows, self.question, number / len(tests))

    def covariance(self, tests: Sequence[ExpectedTest], floors: Ints) -> Floats:
        """Relative covariance of masses and stiffnesses after these tests at these floors, shape (2N, 2N)."""
        rows = np.concatenate([self.known, *(test.at(floors) for test in tests)])
        free = free_changes(self.fixed)
        half = free @ np.linalg.inv(np.linalg.qr(rows @ free, mode="r"))
        return np.asarray(half @ half.T)
