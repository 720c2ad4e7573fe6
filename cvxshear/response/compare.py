"""Comparison of a predicted and a measured response: errors in time, and errors of the transfer functions per mode.

H1 = S_yf / S_ff by averaged periodograms. Measured and predicted responses go through the same estimate, so that
leakage and resolution are the same in both and cancel in the comparison.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cvxshear.records.motion import DrivenRecord, DrivenRun, trend
from cvxshear.response.damping import DampedModel
from cvxshear.response.recording import Recording, earlier, rms
from cvxshear.response.state_space import Response, response
from cvxshear.util.quantities import CHANNEL_UNITS, ranged
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Complexes, Floats, Ints

SEGMENTS = 4
"""Minimum number of pieces of the shortest run, half overlapping; fewer show no coherence."""

BANDWIDTH_LINES = 8
"""Number of lines in the half-power bandwidth of a mode if the record is long enough."""

AROUND = 0.1
"""Half width of a mode's neighborhood, relative to its natural frequency, unless the next mode is nearer."""

SHIFTED = 0.25
"""Half width of the search for a resonance, relative to the natural frequency, unless the next mode is nearer. A frame
that lost two fifths of its stiffness has this shift."""

COHERENT = 0.6
"""Minimum mean coherence of a floor that responds to the excitation."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer functions.

    Parameters
    ----------
    frequencies : ndarray, shape (lines,)
        Hz.
    functions : ndarray of complex, shape (lines, n)
        (m/s2)/(m/s2) or (m/s2)/N, one column per floor.
    coherence : ndarray, shape (lines, n)
    """

    frequencies: Floats
    functions: Complexes
    coherence: Floats


def segment(samples: int, rate: float, frequency: float, ratio: float) -> int:
    """Return the number of samples of a piece, for a mode of this frequency (Hz) and ratio; allow several pieces."""
    wanted = BANDWIDTH_LINES * rate / max(2 * ratio * frequency, 1e-12)
    return int(max(16, min(wanted, 2 * samples // (SEGMENTS + 1))))


def transfer(excitations: Sequence[Floats], responses: Sequence[Floats], rate: float, length: int) -> Transfer:
    """Estimate the transfer functions over all runs together, from pieces of `length` samples."""
    cross: Complexes | float = 0.0
    force: Floats | float = 0.0
    power: Floats | float = 0.0
    frequencies = np.zeros(0)
    for f, y in zip(excitations, responses, strict=True):
        frequencies, own = scipy.signal.welch(f, rate, nperseg=length)
        weight = len(f)
        force = force + weight * own
        power = power + weight * scipy.signal.welch(y, rate, nperseg=length, axis=0)[1]
        cross = cross + weight * scipy.signal.csd(f[:, None], y, rate, nperseg=length, axis=0)[1]
    # Lines without excitation have no transfer function: 0 / 0 gives nan.
    with np.errstate(divide="ignore", invalid="ignore"):
        functions = np.asarray(cross) / np.asarray(force)[:, None]
        coherence = np.abs(cross) ** 2 / (np.asarray(force)[:, None] * np.asarray(power))
    return Transfer(frequencies, functions, np.nan_to_num(coherence))


def around(frequencies: Floats, natural: Floats, mode: int, half: float = AROUND) -> Bools:
    """Return a mask of the lines near one natural frequency and nearer to it than to any other, shape (lines,)."""
    own = natural[mode]
    near: Bools = np.abs(frequencies - own) <= half * own
    others = np.delete(natural, mode)
    if others.size:
        near &= np.abs(frequencies - own) < np.min(np.abs(frequencies[:, None] - others), axis=1)
    return near


def errors(measured: Transfer, predicted: Transfer, natural: Floats) -> Floats:
    """Compute the rms error of the predicted magnitude around each mode, relative to the measured rms, shape (n, N).

    One row per floor; nan around modes that the excitation does not reach. Both functions have the same lines.
    """
    result = np.full((measured.functions.shape[1], len(natural)), np.nan)
    for mode in range(len(natural)):
        near = around(measured.frequencies, natural, mode)
        if not near.any():
            continue
        seen, made = np.abs(measured.functions[near]), np.abs(predicted.functions[near])
        reached = measured.coherence[near].mean(axis=0) >= COHERENT
        error = np.sqrt(np.sum((made - seen) ** 2, axis=0) / np.sum(seen**2, axis=0))
        result[reached, mode] = error[reached]
    return result


def power_at(estimated: Transfer, natural: Floats, mode: int, frequency: float) -> float:
    """Compute the squared magnitude over all floors at a frequency, relative to its maximum near a mode."""
    power = np.sum(np.abs(estimated.functions) ** 2, axis=1)
    largest = power[around(estimated.frequencies, natural, mode, SHIFTED)].max()
    return float(np.interp(frequency, estimated.frequencies, power) / largest)


def peak(estimated: Transfer, natural: Floats, mode: int) -> float | None:
    """Find the peak of the transfer functions of all floors together near a mode, Hz; None without a peak.

    The peak is the top of the parabola through the logarithms of the largest line and its neighbors.
    """
    near = np.flatnonzero(around(estimated.frequencies, natural, mode, SHIFTED))
    if len(near) < 3 or estimated.coherence[near].mean() < COHERENT:
        return None
    size = np.log(np.maximum(np.sum(np.abs(estimated.functions) ** 2, axis=1), 1e-300))
    top = int(near[np.argmax(size[near])])
    if top in (near[0], near[-1]):
        return None
    left, here, right = size[top - 1 : top + 2]
    shift = 0.5 * (left - right) / (left - 2 * here + right)
    return float(estimated.frequencies[top] + shift * (estimated.frequencies[1] - estimated.frequencies[0]))


FALLEN = 0.8
"""Largest power of a transfer function at the other function's peak, relative to its own peak, for a clear shift. The
top of a damped resonance is flat. Noise and leakage move its largest line by up to ten lines, where 0.8 of the power
remains."""


@dataclass(frozen=True, eq=False)
class Shift:
    """A mode whose resonance in the record differs from the model's.

    Parameters
    ----------
    measured, modelled : float
        Frequencies of the peaks of the transfer functions, Hz.
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
class RecordComparison(InJson):
    """Errors of the predicted accelerations.

    Parameters
    ----------
    floors : ndarray of int, shape (n,)
        The measured floors.
    nrmse : ndarray, shape (n,)
        Root mean square of the error in time, relative to the measured root mean square.
    rms_ratio, peak_ratio : ndarray, shape (n,)
        Ratios of predicted to measured values.
    frf_error : ndarray, shape (n, N)
        Error of the transfer function's magnitude around each mode; nan if the excitation does not reach the mode.
    shifts : tuple of Shift
    measured, predicted : Transfer
    contradiction : str
        Contradictions that one factor or a sign would explain; empty without contradiction.
    """

    floors: Ints
    nrmse: Floats
    rms_ratio: Floats
    peak_ratio: Floats
    frf_error: Floats
    shifts: tuple[Shift, ...]
    measured: Transfer
    predicted: Transfer
    contradiction: str = ""

    json_keys = "floors nrmse rms_ratio peak_ratio frf_error"


def seen(model: DampedModel, response: Response, floors: Ints) -> Floats:
    """Return the predicted accelerations at the sensors, with the sensors' gains, shape (samples, n)."""
    return response.acceleration[:, floors - 1] * model.gain[floors - 1]


def compared(
    model: DampedModel, responses: Sequence[Response], motion: DrivenRecord, measured_modes: Ints | None = None
) -> RecordComparison | None:
    """Compare the prediction with the record; return None if the record has no accelerations of floors.

    Parameters
    ----------
    responses : sequence of Response
        One response per run of the record.
    motion : DrivenRecord
        Floors with missing samples are left out.
    measured_modes : ndarray of int, optional
        Numbers (from 1) of the measured modes, the only ones with reported shifts; by default, all modes.
    """
    recorded = [run.responses for run in motion.runs if run.responses is not None]
    if len(recorded) < len(motion.runs):
        return None
    whole = np.all([np.isfinite(each).all(axis=0) for each in recorded], axis=0)
    columns = np.flatnonzero((motion.floors <= len(model.M)) & whole)
    floors = motion.floors[columns]
    if not floors.size:
        return None
    measured = [each[:, columns] for each in recorded]
    predicted = [seen(model, response, floors) for response in responses]
    y, shown = np.concatenate(measured), np.concatenate(predicted)
    rms_measured, rms_predicted, rms_error = (np.sqrt(np.mean(each**2, axis=0)) for each in (y, shown, shown - y))
    natural = model.modes.frequencies
    length = segment(
        min(run.samples for run in motion.runs), motion.sampling_rate, float(natural[0]), float(model.ratios[0])
    )
    excitations = [run.excitation for run in motion.runs]
    of_record = transfer(excitations, measured, motion.sampling_rate, length)
    of_model = transfer(excitations, predicted, motion.sampling_rate, length)
    with np.errstate(divide="ignore", invalid="ignore"):
        return RecordComparison(
            floors=floors,
            nrmse=rms_error / rms_measured,
            rms_ratio=rms_predicted / rms_measured,
            peak_ratio=np.max(np.abs(shown), axis=0) / np.max(np.abs(y), axis=0),
            frf_error=errors(of_record, of_model, natural),
            shifts=_shifts(of_record, of_model, natural, measured_modes),
            contradiction=contradiction(y, shown, floors),
            measured=of_record,
            predicted=of_model,
        )


def _shifts(measured: Transfer, predicted: Transfer, natural: Floats, measured_modes: Ints | None) -> tuple[Shift, ...]:
    """Find the modes whose resonance differs from the model's.

    The shift must exceed a line of the spectrum, and both transfer functions must be below `FALLEN` at the other's
    peak.
    """
    line = measured.frequencies[1] - measured.frequencies[0]
    found = []
    for mode in range(len(natural)):
        if measured_modes is not None and mode + 1 not in measured_modes:
            continue
        seen, made = peak(measured, natural, mode), peak(predicted, natural, mode)
        if seen is None or made is None or abs(seen - made) <= line:
            continue
        if max(power_at(measured, natural, mode, made), power_at(predicted, natural, mode, seen)) < FALLEN:
            found.append(Shift(mode + 1, seen, made))
    return tuple(found)


def moved_alike(measured: Floats, predicted: Floats) -> Floats:
    """Compute the correlation of each channel with its prediction over time, shape (n,)."""
    power: Floats = np.sum(measured**2, axis=0) * np.sum(predicted**2, axis=0)
    return np.asarray(np.sum(measured * predicted, axis=0) / np.maximum(np.sqrt(power), 1e-300))


def moved_against(measured: Floats, predicted: Floats) -> Bools:
    """Find channels that moved opposite to their prediction while all others moved with theirs, shape (n,)."""
    alike = moved_alike(measured, predicted)
    against = alike < -LIKE
    sure = np.all(against | (alike > LIKE)) and 2 * np.sum(against) < len(against)
    return np.asarray(against & sure, dtype=bool)


def contradiction(measured: Floats, predicted: Floats, floors: Ints) -> str:
    """Report contradictions that one factor or a sign explains; empty without any."""
    size_y, size_p = (np.sqrt(np.mean(each**2, axis=0)) for each in (measured, predicted))
    if not np.all(size_y > 0) or not np.all(size_p > 0):
        return ""
    own = moved_alike(measured, predicted)
    said = []
    ratios = size_y / size_p
    factor = float(np.exp(np.mean(np.log(ratios))))
    spread = float(np.max(np.abs(np.log(ratios / factor))))
    for unit in CONFUSED_UNITS:
        size = CHANNEL_UNITS[unit][1]
        for known, wrong in ((1 / size, "are the floors"), (size, "is the base motion")):
            if abs(np.log(factor / known)) < SAME_FACTOR and spread < SAME_FACTOR:
                said.append(
                    f"every floor was measured {factor:.3g} times as large as predicted, which is near {known:.4g}: "
                    f"{wrong} in {unit}?"
                )
    against = floors[own < -LIKE]
    if against.size and against.size < len(floors):
        said.append(
            f"floor {ranged(against.tolist())} moved against the prediction (correlation {own[own < -LIKE].min():.2f}) "
            "where the others moved with it: is the sensor reversed?"
        )
    elif against.size:
        said.append("every floor moved against the prediction: is the excitation's sign reversed?")
    return "; ".join(said)


CONFUSED_UNITS = ("g", "mm/s2", "cm/s2", "in/s2")
"""Units of acceleration that are confused with m/s2."""

SAME_FACTOR = 0.25
"""Largest difference of logarithms between a ratio and the size of a unit. The rms of a prediction rarely has a
larger error, and all factors differ by more."""

LIKE = 0.5
"""Least correlation in time of two motions that belong together; floors of one frame in step have 0.8."""


MOVED_ALIKE = 1e-3
"""Largest difference of two equal motions, relative to their rms; the errors of sensors are larger."""


def predicted_responses(model: DampedModel, recording: Recording) -> list[Response]:
    """Compute the motion of a frame from the excitation alone."""
    runs = [DrivenRun(run.excitation, recording.force_floor, None, run.name, run.between) for run in recording.runs]
    return [response(model, drive, recording.step) for drive in runs]


def readings_of(model: DampedModel, recording: Recording) -> list[Recording]:
    """List versions of a measured excitation between its samples: linear and band-limited.

    Return only one version if both give the same motion.
    """
    other = recording.band_limited()
    motion, moved = (
        np.concatenate([each.acceleration for each in predicted_responses(model, own)]) for own in (recording, other)
    )
    return [recording, other] if rms(moved - motion) > MOVED_ALIKE * rms(motion) else [recording]


def as_predicted(model: DampedModel, recording: Recording) -> Recording:
    """Return a recording corrected by the prediction of the identified model.

    A channel is inverted if it alone moves opposite to its prediction. A removed delay is restored if the sensor was
    nearer to its prediction with the delay: dampers shift phases as clocks do, and the model includes dampers. Other
    contradictions are added to the remarks.
    """
    shown = [seen(model, each, recording.floors) for each in predicted_responses(model, recording)]
    recording = _with_delays(recording, shown)
    measured = np.concatenate([run.measured - trend(run.measured) for run in recording.runs])
    predicted = np.where(np.isfinite(measured), np.concatenate([own - trend(own) for own in shown]), 0.0)
    measured = np.nan_to_num(measured)
    against = moved_against(measured, predicted)
    signs = np.where(against, -1.0, 1.0)
    said = [
        f"the sensor of floor {floor} is reversed: it moves against the prediction, where all others move with it; "
        "turned round, check its sign in the record file"
        for floor in recording.floors[against]
    ]
    contradicted = contradiction(signs * measured, predicted, recording.floors)
    remarks = (*recording.remarks, *said, *([contradicted] if contradicted else []))
    turned = recording.replaced(measured=(signs * run.measured for run in recording.runs))
    return dataclasses.replace(turned, remarks=remarks)


def _with_delays(recording: Recording, predicted: Sequence[Floats]) -> Recording:
    """Restore the delays of sensors that are nearer to their prediction with the delay."""
    late = np.zeros((len(recording.floors), 2)) if recording.late is None else recording.late
    measured, remarks = [run.measured.copy() for run in recording.runs], list(recording.remarks)
    for column in np.flatnonzero(late.any(axis=1)):
        started, delayed = 0, []
        for values in measured:
            delayed.append(earlier(values[:, column], -late[column], recording.sampling_rate, started))
            started += len(values)
        own = [values[:, column] for values in predicted]
        if _misfit(delayed, own) < _misfit([values[:, column] for values in measured], own):
            for values, with_delay in zip(measured, delayed, strict=True):
                values[:, column] = with_delay
            message = recording.late_remarks[column]
            remarks = [each for each in remarks if each != message]
            if recording.late_remarks.count(message) > 1:
                # A delay of the input belongs to all sensors; the other sensors may stay corrected.
                remarks.append(f"{message}; left in for floor {recording.floors[column]}")
    return dataclasses.replace(recording.replaced(measured=measured), remarks=tuple(remarks))


def _misfit(measured: Sequence[Floats], predicted: Sequence[Floats]) -> float:
    return sum(rms(seen - trend(seen) - own + trend(own)) for seen, own in zip(measured, predicted, strict=True))
