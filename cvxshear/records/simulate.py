"""Records of a known shear frame, integrated exactly, for studies of the identification."""

from dataclasses import dataclass

import numpy as np
import scipy

from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.records.record import Channel, Run, TimeRecord
from cvxshear.util.typing import Floats

#: The load is a straight line between samples this many times denser than the record's.
OVERSAMPLING = 8


@dataclass(frozen=True, eq=False)
class KnownFrame:
    """A shear frame with modal damping.

    Parameters
    ----------
    masses : array_like, shape (N,)
        kg.
    stiffnesses : array_like, shape (N,)
        N/m, story 1 the lowest.
    damping : float
        Fraction of critical, every mode.
    """

    masses: Floats
    stiffnesses: Floats
    damping: float

    def modes(self) -> tuple[Floats, Floats]:
        """Natural frequencies, Hz, shape (N,), and mass-normalized shapes, one a row, shape (N, N)."""
        found = modes(mass_matrix(np.asarray(self.masses)), self.stiffness)
        return found.frequencies, found.shapes

    @property
    def stiffness(self) -> Floats:
        """Stiffness matrix, N/m, shape (N, N)."""
        return stiffness_matrix(np.asarray(self.stiffnesses))

    def accelerations(self, forces: Floats, step: float) -> Floats:
        """Accelerations under forces that are straight lines between samples, m/s2, shape (samples, N).

        Each mode is one recursive filter by the first-order hold, which is exact for such forces.

        Parameters
        ----------
        forces : array, shape (samples, N)
            N.
        step : float
            s.
        """
        moved = np.zeros(forces.shape)
        for frequency, shape in zip(*self.modes(), strict=True):
            omega = 2 * np.pi * frequency
            # From the modal force to the acceleration of the modal coordinate: s^2 / (s^2 + 2 z w s + w^2).
            mode = (np.array([1.0, 0.0, 0.0]), np.array([1.0, 2 * self.damping * omega, omega**2]))
            above, below, _ = scipy.signal.cont2discrete(mode, step, method="foh")
            moved += np.outer(scipy.signal.lfilter(above.ravel(), below, forces @ shape), shape)
        return moved


#: The three-story frame of the paper's section 5, with 1 % damping.
PAPER_FRAME = KnownFrame(np.array([10.0, 7.5, 5.0]), np.array([1800.0, 1200.0, 600.0]), 0.01)


def hammer_record(
    frame: KnownFrame,
    seed: int,
    *,
    noise: float,
    floors: tuple[int, ...] = (1, 2, 3),
    hits: int = 5,
    duration: float = 60.0,
    sampling_rate: float = 20.0,
) -> TimeRecord:
    """Blows of a soft hammer at each of the floors, a half sine of 0.1 s and 50 to 150 N.

    Noise is white, of standard deviation `noise` times each channel's own, on every sensor and the hammer.
    """
    random = np.random.default_rng(seed)
    step = 1 / (sampling_rate * OVERSAMPLING)
    count = int(duration * sampling_rate) * OVERSAMPLING
    runs = []
    for floor in floors:
        for hit in range(hits):
            time = np.arange(count) * step - 1.0 - random.uniform(0, 1 / sampling_rate)
            blow = np.where((time > 0) & (time < 0.1), np.sin(np.pi * time / 0.1), 0.0) * random.uniform(50, 150)
            both = _answered(frame, blow, floor, step)
            runs.append(_sensed(both, noise, random, floor, f"hit {hit + 1} at floor {floor}"))
    return _record(frame, runs, sampling_rate, "force")


def base_record(
    frame: KnownFrame, seed: int, *, noise: float, duration: float = 1200.0, sampling_rate: float = 20.0
) -> TimeRecord:
    """White base acceleration of 1 m/s2, absolute accelerations of the floors; noise on every sensor."""
    random = np.random.default_rng(seed)
    step = 1 / (sampling_rate * OVERSAMPLING)
    ground = _white(int(duration * sampling_rate) * OVERSAMPLING, random)
    relative = frame.accelerations(-ground[:, None] * np.asarray(frame.masses), step)
    run = _sensed(np.column_stack([ground, relative + ground[:, None]]), noise, random, 0, "shaking")
    return _record(frame, [run], sampling_rate, "base")


def shaker_record(
    frame: KnownFrame,
    seed: int,
    *,
    noise: float,
    floor: int,
    duration: float = 240.0,
    sampling_rate: float = 20.0,
    name: str = "shaker",
) -> TimeRecord:
    """Simulate a shaker's white force of 10 N at one floor and the accelerations of all; noise on every sensor."""
    random = np.random.default_rng(seed)
    step = 1 / (sampling_rate * OVERSAMPLING)
    force = 10.0 * _white(int(duration * sampling_rate) * OVERSAMPLING, random)
    run = _sensed(_answered(frame, force, floor, step), noise, random, floor, name)
    return _record(frame, [run], sampling_rate, "force")


def ambient_record(
    frame: KnownFrame, seed: int, *, noise: float, duration: float = 1200.0, sampling_rate: float = 20.0
) -> TimeRecord:
    """Independent white forces of 1 N on all floors; only the floors' accelerations are recorded."""
    random = np.random.default_rng(seed)
    step = 1 / (sampling_rate * OVERSAMPLING)
    count = int(duration * sampling_rate) * OVERSAMPLING
    forces = np.column_stack([_white(count, random) for _ in frame.masses])
    sensed = _sensed(frame.accelerations(forces, step), noise, random, 0, "wind", driven=False)
    return _record(frame, [sensed], sampling_rate, "none")


def _white(count: int, random: np.random.Generator) -> Floats:
    """Noise that is white up to 0.8 of half the record's sampling rate, of unit standard deviation."""
    lowpass = scipy.signal.butter(6, 0.8 / OVERSAMPLING, output="sos")
    values = scipy.signal.sosfiltfilt(lowpass, random.standard_normal(count))
    return np.asarray(values / values.std())


def _answered(frame: KnownFrame, force: Floats, floor: int, step: float) -> Floats:
    """Put a force at one floor, smoothed to its part in the samples' band, beside the accelerations of all floors.

    A straight line between samples has their spectrum times sinc squared, 1 - w^2 / 12 for w radians a sample; so have
    the weights 1/12, 10/12 and 1/12.
    """
    forces = np.zeros((len(force), len(frame.masses)))
    forces[:, floor - 1] = force
    acting = np.convolve(force, np.array([1.0, 10.0, 1.0]) / 12.0, mode="same")
    return np.column_stack([acting, frame.accelerations(forces, step)])


def _sensed(
    values: Floats, noise: float, random: np.random.Generator, floor: int, name: str, *, driven: bool = True
) -> Run:
    """Filter against aliasing, sample and disturb; the first column is the input where there is one."""
    sampled = scipy.signal.decimate(values, OVERSAMPLING, ftype="fir", axis=0)
    disturbed = sampled + noise * sampled.std(axis=0) * random.standard_normal(sampled.shape)
    if not driven:
        return Run(disturbed, name=name)
    return Run(disturbed[:, 1:], disturbed[:, 0], floor, name)


def _record(frame: KnownFrame, runs: list[Run], sampling_rate: float, kind: str) -> TimeRecord:
    channels = tuple(Channel(f"floor{floor}", floor) for floor in range(1, len(frame.masses) + 1))
    return TimeRecord(channels, runs=tuple(runs), sampling_rate=sampling_rate, input=kind, name=f"simulated {kind}")
