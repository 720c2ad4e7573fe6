"""The excitation of a frame, base motion or a force, and the recorded motion of its floors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from cvxshear.records.examination import one_a_floor
from cvxshear.records.record import RECORDED_QUANTITIES, TimeRecord
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Complexes, Floats, Ints

#: Kinds of input that are measured, so that a response to them can be predicted.
DRIVEN = ("base", "force")


@dataclass(frozen=True, eq=False)
class DrivenRun(checks.ReadOnlyArrays):
    """One uninterrupted stretch of excitation, from rest.

    Parameters
    ----------
    excitation : array_like, shape (samples,)
        m/s2 for a base acceleration, N for a force.
    floor : int, optional
        Where the force acts; 0 for a base acceleration.
    responses : array_like, shape (samples, floors), optional
        Total accelerations of the floors that `DrivenRecord.floors` names, m/s2; nan or masked where missing.
    name : str, optional
    between : ndarray, shape (samples,), optional
        Samples whose straight lines act between the samples (`band_limited`); by default the samples of the excitation.
    """

    excitation: Floats
    floor: int = 0
    responses: Floats | None = None
    name: str = "run 1"
    between: Floats | None = None

    def __post_init__(self) -> None:
        excitation = checks.vector(self.excitation, f"{self.name}: excitation")
        if len(excitation) < 2:
            raise InputError(f"{self.name}: the excitation has one sample; at least two make a line")
        object.__setattr__(self, "excitation", excitation)
        if self.responses is not None:
            responses = np.ma.array(self.responses, dtype=np.float64, copy=True).filled(np.nan)
            if responses.ndim != 2 or len(responses) != len(excitation) or np.isinf(responses).any():
                raise InputError(
                    f"{self.name}: responses must be a table of {len(excitation)} samples by floors, one row a "
                    f"sample of the excitation, not of shape {responses.shape}"
                )
            object.__setattr__(self, "responses", checks.frozen(responses))

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.excitation)

    @property
    def measured(self) -> Floats:
        """The responses, shape (samples, floors); without columns if none was recorded."""
        return np.zeros((self.samples, 0)) if self.responses is None else self.responses

    @property
    def drive(self) -> Floats:
        """Excitation between the samples and at the samples, shape (samples, 2)."""
        return np.column_stack([self.excitation if self.between is None else self.between, self.excitation])

    @property
    def columns(self) -> Floats:
        """The excitation and each channel, shape (samples, 1 + floors)."""
        return np.column_stack([self.excitation, self.measured])


@dataclass(frozen=True, eq=False)
class DrivenRecord(checks.ReadOnlyArrays):
    """A recorded base motion or force, in one stretch or several.

    Parameters
    ----------
    runs : sequence of DrivenRun
    sampling_rate : float
        Hz.
    input : str, optional
        "base" (base acceleration) or "force".
    floors : array_like of int, shape (n,), optional
        Whose accelerations were recorded, ascending; none where empty.
    added_mass : array_like, shape (N,), optional
        Added kg on each floor during the record; None if not declared.
    name : str, optional
    state : str, optional
        The state of the frame during the record; None if not declared.
    remarks : tuple of str, optional
        Sensor faults, and their corrections.

    Raises
    ------
    InputError
        Naming the stretch, and what would be right.
    """

    runs: tuple[DrivenRun, ...]
    sampling_rate: float
    input: str = "base"
    floors: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    added_mass: Floats | None = None
    name: str = "record"
    state: str | None = None
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "runs", tuple(self.runs))
        put(self, "sampling_rate", checks.number(self.sampling_rate, "record: sampling_rate", above=0.0))
        if self.input not in DRIVEN:
            raise InputError(
                f'{self.name} has input = "{self.input}"; what drove the frame in time is needed: input = "base" with '
                'a channel on floor 0, or input = "force" with a channel of the force'
            )
        put(self, "floors", np.asarray(self.floors, dtype=np.int64))
        checks.put(self, "added_mass", checks.vector, "record: added_mass")
        if not self.runs:
            raise InputError("record: at least one run is needed")
        for run in self.runs:
            if self.input == "force":
                checks.whole(run.floor, f"{run.name}: input_floor", least=1, most=checks.MOST_STORIES)
            if run.responses is not None and run.responses.shape[1] != len(self.floors):
                raise InputError(
                    f"{run.name}: the responses have {run.responses.shape[1]} columns, {len(self.floors)} floors "
                    "are named; give one a floor"
                )

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return 1.0 / self.sampling_rate

    @property
    def seconds(self) -> float:
        """Length of all runs together."""
        return sum(run.samples for run in self.runs) / self.sampling_rate

    def rms(self) -> Floats:
        """Compute the rms of the excitation and of each channel, shape (1 + floors,); 0 without samples."""
        values = np.concatenate([run.columns for run in self.runs])
        square: Floats = np.nansum(values**2, axis=0) / np.maximum(np.isfinite(values).sum(axis=0), 1)
        return np.sqrt(square)

    def replaced(self, floors: Ints | None = None, **arrays: Iterable[Floats]) -> DrivenRecord:
        """Return the record with other arrays in its runs, one per run for each field, and other floors if given."""
        every = [dict(zip(arrays, values, strict=True)) for values in zip(*arrays.values(), strict=True)]
        runs = (replace(run, **each) for run, each in zip(self.runs, every, strict=True))
        return replace(self, runs=tuple(runs), floors=self.floors if floors is None else floors)

    def band_limited(self) -> DrivenRecord:
        """Take the excitation as band-limited between its samples, not as straight lines."""
        return self.replaced(between=(band_limited(run.excitation) for run in self.runs))

    @staticmethod
    def of(record: TimeRecord, added_mass: Sequence[float] | None = None, state: str | None = None) -> DrivenRecord:
        """Read the motion that a record holds.

        Parameters
        ----------
        record : TimeRecord
            Driven by base motion or a force. Responses other than accelerations are left out; of several sensors on
            one floor the mean is taken.
        added_mass : sequence of float, shape (N,), optional
        state : str, optional

        Raises
        ------
        InputError
            Where the record does not say what drove the frame.
        """
        added = None if added_mass is None else np.asanyarray(added_mass, dtype=np.float64)
        return replace(of_channels(one_a_floor(record)[0]), added_mass=added, state=state)


def of_channels(record: TimeRecord) -> DrivenRecord:
    """Read the motion that a record holds, with one column for each channel and its floor."""
    measured = record.quantity == "acceleration"
    runs = tuple(
        DrivenRun(
            run.excitation, run.floor if record.input == "force" else 0, run.responses if measured else None, run.name
        )
        for run in record.runs
        if run.excitation is not None
    )
    floors = record.floors if measured else np.zeros(0, dtype=np.int64)
    return DrivenRecord(runs, record.sampling_rate, record.input, floors, name=record.name)


#: Fraction of half the sampling rate above which a record has only noise: anti-aliasing filters begin at 0.8 or
#: below.
NOISE_FROM = 0.8

#: Largest ratio of a spectrum to the noise that chance explains: averages of a dozen pieces scatter by a third.
NOISE_SCATTER = 2.0

#: Samples of a piece whose spectra are averaged: a minute at 100 Hz has some twenty, which scatter by a fifth.
SPECTRUM_SAMPLES = 512

#: Number of mirrored samples at the ends of a record: weights at this distance are below 1e-4.
MARGIN_SAMPLES = 64


def band_limited(samples: Floats) -> Floats:
    """Return samples whose straight lines have, below half the sampling rate, the spectrum of a band-limited motion.

    Between samples h apart, a straight line has sinc(f h)^2 = (sin(pi f h) / (pi f h))^2 of the part at frequency f:
    3.3 % too little at a tenth of the sampling rate. The part above the noise is divided by this factor. The noise is
    the spectrum near half the sampling rate, above the anti-aliasing filter. Samples of white noise are not a
    band-limited motion and are not changed.

    Parameters
    ----------
    samples : ndarray, shape (samples,)
    """
    return _filtered(samples, lambda f, above: 1.0 + above * (np.sinc(f) ** -2 - 1.0))


def differentiated(samples: Floats, rate: float, quantity: str) -> tuple[Floats, float]:
    """Differentiate a recorded motion where it is above its noise, which derivatives would raise beyond all else.

    Parameters
    ----------
    samples : ndarray, shape (samples,)
    rate : float
        Sampling rate, Hz.
    quantity : str
        "velocity" or "displacement".

    Returns
    -------
    acceleration : ndarray, shape (samples,)
    noise_from : float
        Frequency, Hz, above which the record has more noise than motion.
    """
    lines, above = _above_noise(samples)
    times = RECORDED_QUANTITIES.index(quantity)
    noise_from = rate * float(lines[above > 0.5].max(initial=0.0))
    return _filtered(samples - trend(samples), lambda f, share: share * (2j * np.pi * rate * f) ** times), noise_from


def _above_noise(samples: Floats) -> tuple[Floats, Floats]:
    """Frequencies, in cycles a sample, and the share of the power there that is not noise."""
    lines, power = scipy.signal.welch(samples - trend(samples), nperseg=min(SPECTRUM_SAMPLES, len(samples)))
    # The lines of a few samples may end before that; the last one has to do then.
    noise = np.median(power[lines >= min(0.5 * NOISE_FROM, lines[-1])])
    return lines, np.clip(1.0 - NOISE_SCATTER * noise / np.maximum(power, np.finfo(float).tiny), 0.0, 1.0)


def _filtered(samples: Floats, gain: Callable[[Floats, Floats], Complexes | Floats]) -> Floats:
    """Multiply the spectrum by a gain, a function of the frequency in cycles a sample and the share above the noise."""
    margin = min(MARGIN_SAMPLES, len(samples) - 1)
    mirrored = np.pad(samples, margin, mode="reflect", reflect_type="odd")
    f = np.fft.rfftfreq(len(mirrored))
    lines, above = _above_noise(samples)
    factor = gain(np.asarray(f), np.interp(f, lines, above))
    result: Floats = np.fft.irfft(np.fft.rfft(mirrored) * factor, len(mirrored))
    return result[margin : margin + len(samples)]


def trend(values: Floats) -> Floats:
    """Straight line through each column by least squares, of the same shape.

    Parameters
    ----------
    values : ndarray, shape (samples,) or (samples, columns)
        Samples that are nan do not count.
    """
    columns = values.reshape(len(values), -1)
    time = np.linspace(-1.0, 1.0, len(values))
    lines = np.zeros_like(columns)
    for j, column in enumerate(columns.T):
        own = np.isfinite(column)
        if own.sum() > 1:
            lines[:, j] = np.polyval(np.polyfit(time[own], column[own], 1), time)
    return lines.reshape(values.shape)
