"""Comparison of a predicted and a measured response: errors in time, and errors of the transfer functions per mode.

H1 = S_yf / S_ff by averaged periodograms. Measured and predicted responses go through the same estimate, so that
leakage and resolution are the same in both and cancel in the comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal, special

from cvxshear.records.motion import DrivenRecord, trend
from cvxshear.response.damping import DampedModel
from cvxshear.response.recording import rms, without_base_line, without_lines
from cvxshear.response.state_space import Response, response
from cvxshear.util.quantities import CHANNEL_UNITS, SURE, numbered
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Complexes, Floats, Ints

#: Minimum number of pieces of the shortest run, half overlapping; fewer show no coherence.
SEGMENTS = 4

#: Number of lines in the half-power bandwidth of a mode if the record is long enough.
BANDWIDTH_LINES = 8

#: Half width of a mode's neighborhood, relative to its natural frequency, unless the next mode is nearer.
AROUND = 0.1

#: Half width of the search for a resonance, relative to the natural frequency, unless the next mode is nearer. A frame
#: that lost two fifths of its stiffness has this shift.
SHIFTED = 0.25

#: Minimum mean coherence of a floor that responds to the excitation.
COHERENT = 0.6


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
    return min(samples, int(max(16, min(wanted, 2 * samples // (SEGMENTS + 1)))))


@dataclass(frozen=True, eq=False)
class PieceSpectra:
    """PieceSpectra of half overlapping pieces of an excitation and of responses to it, one per piece.

    Parameters
    ----------
    frequencies : ndarray, shape (lines,)
        Hz.
    force : ndarray, shape (pieces, lines)
        Spectrum of the excitation.
    cross : ndarray of complex, shape (pieces, lines, n)
    power : ndarray, shape (pieces, lines, n)
        PieceSpectra of the responses.
    """

    frequencies: Floats
    force: Floats
    cross: Complexes
    power: Floats

    @staticmethod
    def of(excitations: Sequence[Floats], responses: Sequence[Floats], rate: float, length: int) -> PieceSpectra:
        """Transform pieces of `length` samples of all runs, without their means, under a Hann window."""
        window = signal.windows.hann(length, sym=False)

        def transformed(values: Floats) -> Complexes:
            pieces = np.lib.stride_tricks.sliding_window_view(values, length, axis=0)[:: length // 2]
            lines: Complexes = np.fft.rfft(window * (pieces - pieces.mean(axis=-1, keepdims=True)))
            return lines.swapaxes(1, 2)

        force = np.concatenate([transformed(each[:, None]) for each in excitations])
        seen = np.concatenate([transformed(each) for each in responses])
        frequencies = np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64)
        return PieceSpectra(frequencies, np.abs(force[..., 0]) ** 2, np.conj(force) * seen, np.abs(seen) ** 2)

    def transfer(self, columns: slice, pieces: Ints | slice = slice(None)) -> Transfer:
        """Return the transfer functions of some responses, from all pieces or from some of them."""
        force, cross, power = (
            each[pieces].sum(axis=0)
            for each in (self.force[..., None], self.cross[..., columns], self.power[..., columns])
        )
        # Lines without excitation have no transfer function: 0 / 0 gives nan.
        with np.errstate(divide="ignore", invalid="ignore"):
            functions, coherence = cross / force, np.abs(cross) ** 2 / (force * power)
        return Transfer(self.frequencies, functions, np.nan_to_num(coherence))


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


def peak(estimated: Transfer, natural: Floats, mode: int) -> float | None:
    """Find the peak of the transfer functions of all floors together near a mode, Hz; None without a peak.

    The peak is the top of the parabola through the logarithms of the largest line and its neighbors.
    """
    near = np.flatnonzero(around(estimated.frequencies, natural, mode, SHIFTED))
    if len(near) < 3:
        return None
    size = np.log(np.maximum(np.sum(np.abs(estimated.functions) ** 2, axis=1), 1e-300))
    top = int(near[np.argmax(size[near])])
    if top in (near[0], near[-1]):
        return None
    left, here, right = size[top - 1 : top + 2]
    shift = 0.5 * (left - right) / (left - 2 * here + right)
    return float(estimated.frequencies[top] + shift * (estimated.frequencies[1] - estimated.frequencies[0]))


@dataclass(frozen=True, eq=False)
class Shift:
    """A mode whose resonance in the record differs from the model's.

    Parameters
    ----------
    measured, modelled : float
        Frequencies of the peaks of the transfer functions, Hz.
    std : float
        Standard deviation of the difference, relative.
    """

    mode: int
    measured: float
    modelled: float
    std: float

    def __str__(self) -> str:
        change = 100 * (self.measured / self.modelled - 1)
        return (
            f"mode {self.mode} resonates at {self.measured:.3f} Hz in this record, the model at {self.modelled:.3f} Hz "
            f"({change:+.1f} %, standard deviation {100 * self.std:.2g} %)"
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
    """

    floors: Ints
    nrmse: Floats
    rms_ratio: Floats
    peak_ratio: Floats
    frf_error: Floats
    shifts: tuple[Shift, ...]
    measured: Transfer
    predicted: Transfer

    json_keys = "floors nrmse rms_ratio peak_ratio frf_error"


def seen(model: DampedModel, response: Response, floors: Ints) -> Floats:
    """Return the predicted accelerations at the sensors, with the sensors' gains, shape (samples, n)."""
    return response.acceleration[:, floors - 1] * model.gain[floors - 1]


def compared(
    model: DampedModel,
    responses: Sequence[Response],
    motion: DrivenRecord,
    measured_modes: Ints | None = None,
    frequency_std: Floats | None = None,
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
    frequency_std : ndarray, shape (N,), optional
        Relative standard deviations of the model's frequencies; by default, none.
    """
    columns = np.flatnonzero(np.all([np.isfinite(run.measured).all(axis=0) for run in motion.runs], axis=0))
    floors = motion.floors[columns]
    if not floors.size:
        return None
    measured = [run.measured[:, columns] for run in motion.runs]
    predicted = [seen(model, response, floors) for response in responses]
    y, shown = np.concatenate(measured), np.concatenate(predicted)
    rms_measured, rms_predicted, rms_error = (np.sqrt(np.mean(each**2, axis=0)) for each in (y, shown, shown - y))
    natural = model.modes.frequencies
    length = segment(
        min(run.samples for run in motion.runs), motion.sampling_rate, float(natural[0]), float(model.ratios[0])
    )
    excitations = [run.excitation for run in motion.runs]
    both = [np.hstack(pair) for pair in zip(measured, predicted, strict=True)]
    spectra = PieceSpectra.of(excitations, both, motion.sampling_rate, length)
    of_record, of_model = (spectra.transfer(side) for side in _sides(len(floors)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return RecordComparison(
            floors=floors,
            nrmse=rms_error / rms_measured,
            rms_ratio=rms_predicted / rms_measured,
            peak_ratio=np.max(np.abs(shown), axis=0) / np.max(np.abs(y), axis=0),
            frf_error=errors(of_record, of_model, natural),
            shifts=_shifts(spectra, model, measured_modes, frequency_std),
            measured=of_record,
            predicted=of_model,
        )


def _sides(floors: int) -> tuple[slice, slice]:
    """Return the columns of the measured and of the predicted floors."""
    return slice(0, floors), slice(floors, 2 * floors)


def _shifts(
    spectra: PieceSpectra, model: DampedModel, measured_modes: Ints | None, frequency_std: Floats | None
) -> tuple[Shift, ...]:
    """Find the modes whose resonance surely differs from the model's.

    The difference of the two resonances has a deviation: its scatter over halves of the pieces, drawn at random
    (delete-d jackknife, which also holds for the largest line of a flat peak: Shao and Wu 1989). Leakage moves both
    resonances alike. The model's frequency has its own deviation. A shift is sure beside chance in any of the modes.
    """
    natural, pieces = model.modes.frequencies, len(spectra.force)
    own = np.zeros(len(natural)) if frequency_std is None else np.nan_to_num(frequency_std)
    sides = _sides(spectra.cross.shape[2] // 2)
    modes = range(len(natural)) if measured_modes is None else [each - 1 for each in measured_modes.tolist()]

    def tops(chosen: Ints | slice = slice(None)) -> Floats:
        """Return the logarithms of both resonances of each mode, nan without a peak, shape (2, modes)."""
        transfers = [spectra.transfer(side, chosen) for side in sides]
        return np.log(np.array([[peak(each, natural, mode) for mode in modes] for each in transfers], dtype=np.float64))

    whole, rng = tops(), np.random.default_rng(0)
    halves = np.array([np.subtract(*tops(rng.permutation(pieces)[pieces // 2 :])) for _ in range(HALVES)])
    scatter, level = np.sqrt(np.mean((halves - np.subtract(*whole)) ** 2, axis=0)), 1 - (1 - SURE) / (2 * len(modes))
    # The scatter of few pieces has the distribution of Student, the model's deviation the normal one.
    least = np.hypot(special.stdtrit(max(pieces - 1, 1), level) * scatter, special.ndtri(level) * own[modes])
    std = np.hypot(scatter, own[modes])
    return tuple(
        Shift(mode + 1, float(np.exp(seen)), float(np.exp(made)), float(deviation))
        for mode, seen, made, deviation, chance in zip(modes, *whole, std, least, strict=True)
        if abs(seen - made) > chance
    )


#: Number of random halves of the pieces: the deviation of a resonance is known to a seventh.
HALVES = 24


def alike(measured: Floats, predicted: Floats) -> Floats:
    """Compute the correlation of each channel with its prediction over time, shape (n,); 0 for a still one."""
    power: Floats = np.sum(measured**2, axis=0) * np.sum(predicted**2, axis=0)
    return np.asarray(np.sum(measured * predicted, axis=0) / np.maximum(np.sqrt(power), 1e-300))


def confused_units(measured: Floats, predicted: Floats) -> list[str]:
    """Report a factor between all channels and their predictions, (samples, n) each, that is a unit's."""
    sizes = np.sqrt(np.mean(np.stack([measured, predicted]) ** 2, axis=1))
    if not sizes.size or not np.all(sizes > 0):
        return []
    ratios = np.log(sizes[0] / sizes[1])
    factor, said = float(np.mean(ratios)), []
    for unit in CONFUSED_UNITS:
        size = CHANNEL_UNITS[unit][1]
        for known, wrong in ((1 / size, "are the floors"), (size, "is the base motion")):
            if np.max(np.abs(ratios - factor)) < SAME_FACTOR and abs(factor - np.log(known)) < SAME_FACTOR:
                said.append(
                    f"every floor was measured {np.exp(factor):.3g} times as large as predicted, which is near "
                    f"{known:.4g}: {wrong} in {unit}?"
                )
    return said


#: Units of acceleration that are confused with m/s2.
CONFUSED_UNITS = ("g", "mm/s2", "cm/s2", "in/s2")

#: Largest difference of logarithms between a ratio and the size of a unit. The rms of a prediction rarely has a
#: larger error, and all factors differ by more.
SAME_FACTOR = 0.25

#: Least correlation in time of two motions that belong together; floors of one frame in step have 0.8.
LIKE = 0.5


#: Largest difference of two equal motions, relative to their rms; the errors of sensors are larger.
MOVED_ALIKE = 1e-3


def predicted_responses(model: DampedModel, record: DrivenRecord) -> list[Response]:
    """Compute the motion of a frame from the excitation alone."""
    return [response(model, run, record.step) for run in record.runs]


def readings_of(model: DampedModel, record: DrivenRecord) -> list[DrivenRecord]:
    """List versions of a measured excitation between its samples: linear and band-limited.

    Return only one version if both give the same motion.
    """
    other = record.band_limited()
    motion, moved = (
        np.concatenate([each.acceleration for each in predicted_responses(model, own)]) for own in (record, other)
    )
    return [record, other] if rms(moved - motion) > MOVED_ALIKE * rms(motion) else [record]


def lasts(model: DampedModel, record: DrivenRecord) -> bool:
    """Whether a run lasts two periods of the frame.

    A shorter one holds no scatter by which a fit could be judged. A straight line through it is motion.
    """
    longest = max(run.samples for run in record.runs) * record.step
    return bool(longest * model.modes.frequencies[0] >= 2.0)


def as_predicted(model: DampedModel, record: DrivenRecord) -> DrivenRecord:
    """Return a record corrected by the prediction of the identified model; as it is if it is short (`lasts`).

    Channels are inverted if they move opposite to their prediction, and all others, which are the majority, move with
    theirs. Other contradictions are added to the remarks.
    """
    if not lasts(model, record):
        return record
    shown = [seen(model, each, record.floors) for each in predicted_responses(model, record)]
    measured = np.concatenate([run.measured - trend(run.measured) for run in record.runs])
    predicted = np.where(np.isfinite(measured), np.concatenate([own - trend(own) for own in shown]), 0.0)
    measured = np.nan_to_num(measured)
    moved = alike(measured, predicted)
    against = moved < -LIKE
    sure = 2 * np.sum(against) < len(against) and bool(np.all(against | (moved > LIKE)))
    said = [
        f"the sensor of floor {floor} is reversed: it moves against the prediction, where all others move with it; "
        "turned round, check its sign in the record file"
        for floor in record.floors[against & sure]
    ]
    if not sure and against.any():
        floors = numbered("floor", record.floors[against].tolist())
        said.append(f"{floors} moved against the prediction: is the sensor reversed, or the excitation's sign?")
    said += confused_units(measured, predicted)
    turned = record.replaced(responses=(np.where(against & sure, -1.0, 1.0) * run.measured for run in record.runs))
    return replace(turned, remarks=(*record.remarks, *said))


def without_drift(model: DampedModel, record: DrivenRecord) -> DrivenRecord:
    """Subtract the straight lines through the base acceleration, and through each channel minus its prediction.

    A short record (`lasts`) stays as it is.
    """
    if not lasts(model, record):
        return record
    record = without_base_line(record)
    return without_lines(record, [seen(model, each, record.floors) for each in predicted_responses(model, record)])
