"""A predicted response beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.fit.results import plain
from cvxshear.records.motion import Motion
from cvxshear.response.model import DampedModel, Response
from cvxshear.response.transfer import Transfer, errors, peak, power_at, segment, transfer
from cvxshear.util.typing import Floats, Ints, Json

FALLEN = 0.8
"""Of a peak's power, below which a transfer function has fallen at another's peak. The top of a damped resonance is
flat, so that noise and leakage move its largest line by up to ten lines; they leave 0.8 of the power there."""


@dataclass(frozen=True, eq=False)
class Shift:
    """A mode whose resonance the record has elsewhere than the model.

    Parameters
    ----------
    mode : int
    measured, modelled : float
        Where the transfer functions peak, Hz.
    """

    mode: int
    measured: float
    modelled: float

    def __str__(self) -> str:
        change = 100 * (self.measured / self.modelled - 1)
        return (
            f"mode {self.mode} resonates at {self.measured:.3f} Hz in this record, the model at {self.modelled:.3f} Hz "
            f"({change:+.1f} %)"
        )


@dataclass(frozen=True, eq=False)
class RecordComparison:
    """Errors of the predicted accelerations.

    Parameters
    ----------
    floors : ndarray of int, shape (n,)
        Those that were measured.
    nrmse : ndarray, shape (n,)
        Root mean square of the error in time over that of the measurement.
    rms_ratio, peak_ratio : ndarray, shape (n,)
        Predicted over measured.
    frf_error : ndarray, shape (n, N)
        Of the size of the transfer function around each mode; nan where the excitation does not reach one.
    shifts : tuple of Shift
    measured, predicted : Transfer
    """

    floors: Ints
    nrmse: Floats
    rms_ratio: Floats
    peak_ratio: Floats
    frf_error: Floats
    shifts: tuple[Shift, ...]
    measured: Transfer
    predicted: Transfer

    def to_dict(self) -> Json:
        """The documented JSON."""
        return {
            "floors": self.floors.tolist(),
            "nrmse": plain(self.nrmse),
            "rms_ratio": plain(self.rms_ratio),
            "peak_ratio": plain(self.peak_ratio),
            "frf_error": plain(self.frf_error),
        }


def seen(model: DampedModel, response: Response, floors: Ints) -> Floats:
    """The predicted accelerations as the sensors would show them, shape (samples, n)."""
    return response.acceleration[:, floors - 1] * model.gain[floors - 1]


def compared(model: DampedModel, responses: Sequence[Response], motion: Motion) -> RecordComparison | None:
    """The prediction beside the record; None where the record has no accelerations of floors.

    Parameters
    ----------
    model : DampedModel
    responses : sequence of Response
        One a run of the record.
    motion : Motion
    """
    floors = motion.floors[motion.floors <= len(model.M)]
    if not floors.size or any(drive.responses is None for drive in motion.drives):
        return None
    columns = np.flatnonzero(motion.floors <= len(model.M))
    measured = [drive.responses[:, columns] for drive in motion.drives if drive.responses is not None]
    predicted = [seen(model, response, floors) for response in responses]
    error = np.concatenate(predicted) - np.concatenate(measured)
    rms_measured, rms_predicted, rms_error = (
        np.sqrt(np.mean(values**2, axis=0)) for values in (np.concatenate(measured), np.concatenate(predicted), error)
    )
    top_measured, top_predicted = (np.max(np.abs(np.concatenate(each)), axis=0) for each in (measured, predicted))
    natural = model.modes.frequencies
    length = segment(
        min(drive.samples for drive in motion.drives), motion.sampling_rate, float(natural[0]), float(model.ratios[0])
    )
    excitations = [drive.excitation for drive in motion.drives]
    of_record = transfer(excitations, measured, motion.sampling_rate, length)
    of_model = transfer(excitations, predicted, motion.sampling_rate, length)
    with np.errstate(divide="ignore", invalid="ignore"):
        return RecordComparison(
            floors=floors,
            nrmse=rms_error / rms_measured,
            rms_ratio=rms_predicted / rms_measured,
            peak_ratio=top_predicted / top_measured,
            frf_error=errors(of_record, of_model, natural),
            shifts=_shifts(of_record, of_model, natural),
            measured=of_record,
            predicted=of_model,
        )


def _shifts(measured: Transfer, predicted: Transfer, natural: Floats) -> tuple[Shift, ...]:
    """The modes whose resonance is elsewhere than the model's.

    By more than a line of the spectrum, and so far that either transfer function has fallen where the other peaks.
    """
    line = measured.frequencies[1] - measured.frequencies[0]
    found = []
    for mode in range(len(natural)):
        seen, made = peak(measured, natural, mode), peak(predicted, natural, mode)
        if seen is None or made is None or abs(seen - made) <= line:
            continue
        left = power_at(measured, natural, mode, made), power_at(predicted, natural, mode, seen)
        if max(left) < FALLEN:
            found.append(Shift(mode + 1, seen, made))
    return tuple(found)
