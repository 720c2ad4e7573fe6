"""Reconstruction: the motion of every floor, with standard deviations, from the floors with sensors.

`frame_fit` fits the frame to the innovations of the filter. `state_space` computes the motion, and `frame_motion` the
standard deviations, which a prediction of each sensor from all others checks. A record that is not of a linear frame
falls back to the motion of the identified frame.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.measurement.experiment import Configuration, Limits
from cvxshear.records.motion import DrivenRecord
from cvxshear.response import frame_motion, sources
from cvxshear.response.compare import lasts, predicted_responses, readings_of, without_drift
from cvxshear.response.damping import HIGH, DampedModel
from cvxshear.response.frame_fit import FittedFrame
from cvxshear.response.frame_prior import GAIN_STDS
from cvxshear.response.predicted import Peaks, limits_in_json, limits_passed, peaks_of, set_up
from cvxshear.response.recording import RecordSource
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.util import ranking
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.errors import InputError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.quantities import NORMAL_95, SURE, listed, percent
from cvxshear.util.results import Shown, as_json
from cvxshear.util.typing import Bools, Floats, Ints, Json

#: Minimum size of a reported change, in standard deviations: its sign is certain.
SIGN_KNOWN = float(special.ndtri(SURE))

#: Largest inflation of the scores for a record of a linear frame with sound sensors. Linear frames have 1 to 2, a clock
#: 5 ms late gives 5, and a yielding story 4 to 50.
NONLINEAR = 4.0

#: Largest factor between the fitted and the identified stiffness of a story that is not changed by itself.
FURTHEST_FACTOR = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Shown):
    """The result of `reconstruct`.

    Parameters
    ----------
    recording : DrivenRecord
        The recording after the corrections of its sensors.
    configuration : Configuration
    backend : str
    fitted : Fitted
        The identified model.
    kind : str
        Kind of damping.
    frame : FittedFrame
        The frame in this record.
    frame_fitted : bool
        Whether the frame is the one fitted to the record: not if `fit` was False, or in a fallback.
    fallback : str
        Reason why the motion is the identified frame's although a fit was asked for; empty if the fitted frame stands.
    runs : tuple of ReconstructedRun
    peaks : Peaks
    predicted_peaks : Peaks
        Peaks that the identified model predicts from the excitation alone.
    checks : tuple of SensorCheck
    spikes, missing : ndarray of int, shape (m,)
        Numbers of samples of each sensor with a weight reduced by Huber's loss, and of missing samples.
    remarks : tuple of str
    """

    recording: DrivenRecord
    configuration: Configuration
    backend: str
    fitted: sources.Fitted
    kind: str
    frame: FittedFrame
    frame_fitted: bool
    fallback: str
    runs: tuple[frame_motion.ReconstructedRun, ...]
    peaks: Peaks
    predicted_peaks: Peaks
    checks: tuple[frame_motion.SensorCheck, ...]
    spikes: Ints
    missing: Ints
    remarks: tuple[str, ...]

    json_keys = (
        "experiment=fitted.experiment.name record=recording.name input=recording.input "
        "configuration=configuration.name backend effects=fitted.effects measured_floors=recording.floors checks "
        "widening spikes missing"
    )

    @property
    def model(self) -> DampedModel:
        """Matrices of the frame in this record."""
        return self.frame.model

    @property
    def limits(self) -> Limits | None:
        """The declared limits of drift ratios."""
        return self.fitted.experiment.limits

    @property
    def passed(self) -> Floats | None:
        """Probability that the drift ratio of each story passed each limit, shape (L, N).

        It is nan in a fallback, because the drift of a story that yields is unknown; None without story heights or
        limits.
        """
        passed = limits_passed(self.limits, self.peaks)
        return np.full_like(passed, np.nan) if self.fallback and passed is not None else passed

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sensor faults, and reasons for larger errors than the stated deviations; read them before the numbers."""
        return *self.recording.remarks, *_warnings(self)

    @property
    def widening(self) -> float:
        """Factor on all bands: ratio of the left-out sensors' errors to their stated deviations, at least 1."""
        return frame_motion.widening(self.checks)

    @property
    def changed(self) -> tuple[int, ...]:
        """Stories (from 1) that changed by themselves with a probability of at least `SURE`."""
        return self._sure(self.frame.story_probability >= SURE)

    @property
    def names_changes(self) -> bool:
        """Whether changes since the tests are reported: the fitted frame stands, and the tests determine the frame."""
        return self.frame_fitted and not self.undetermined

    @property
    def undetermined(self) -> bool:
        """Whether many frames have the modes of the tests; changes since the tests are then not reported."""
        return bool(self.fitted.undetermined)

    @property
    def provisional(self) -> bool:
        """Whether the record needs changes of three kinds at once."""
        kinds = (self.changed, self.dampers, self.gains_off, self.masses_changed)
        return sum(map(bool, kinds)) >= len(kinds) - 1

    @property
    def sensor_drifts(self) -> list[tuple[int, int, float]]:
        """Peak drift between neighboring sensors: lower floor (0 is a measured base), upper floor, drift in m.

        The drift needs no model of the frame: it is the difference of two accelerations, integrated twice. Frequencies
        below a fifth of the frame's first one are left out, because integration turns noise there into drift.
        """
        base = self.recording.input == "base"
        floors = [*([0] if base else []), *self.recording.floors.tolist()]
        peaks = np.zeros(len(floors) - 1)
        for run in self.runs:
            time = np.arange(len(run.measured))
            columns = [np.interp(time, time[there := np.isfinite(each)], each[there]) for each in run.measured.T]
            drift = np.diff(np.column_stack([*([run.excitation] if base else []), *columns]), axis=1)
            frequencies = np.fft.rfftfreq(len(drift), self.recording.step)
            kept = frequencies >= self.model.modes.frequencies[0] / 5
            square = np.where(kept, -((2 * np.pi * frequencies) ** 2), np.inf)
            moved = np.fft.irfft(np.fft.rfft(drift, axis=0) / square[:, None], len(drift), axis=0)
            peaks = np.maximum(peaks, np.max(np.abs(moved), axis=0))
        return [(*pair, float(peak)) for pair, peak in zip(itertools.pairwise(floors), peaks, strict=True)]

    @property
    def dampers(self) -> tuple[int, ...]:
        """Stories (from 1) that have a damper of their own, with a probability of at least `SURE`."""
        return self._sure(self.frame.dashpot_probability >= SURE)

    @property
    def masses_changed(self) -> bool:
        """Whether a mass change is reported."""
        return self.names_changes and self.frame.mass_probability >= SURE

    @property
    def gains_off(self) -> tuple[tuple[str, float, float], ...]:
        """Sensors whose gain error surely exceeds a field calibration's: name, relative error, standard deviation."""
        names = [f"the sensor of floor {floor}" for floor in self.recording.floors]
        names.append(f"the sensor of the {sources.DRIVING[self.recording.input]}")
        values, stds = self.frame.gains
        sure = self._sure(np.abs(values) - GAIN_STDS[1] > SIGN_KNOWN * stds)
        return tuple((names[place - 1], float(values[place - 1]), float(stds[place - 1])) for place in sure)

    def _sure(self, sure: Bools) -> tuple[int, ...]:
        """Return the places (from 1) of a mask; none if changes are not reported."""
        return tuple(int(place) + 1 for place in np.flatnonzero(sure)) if self.names_changes else ()

    @property
    def change_probability(self) -> Floats | None:
        """Probability that each story changed by itself, shape (N,); None if the frame was not fitted or determined."""
        return self.frame.story_probability if self.names_changes else None

    def to_dict(self) -> Json:
        """Return the documented JSON; null for values that do not apply."""
        frame, none = self.frame, [None] * len(self.model.M)
        sound = None if self.change_probability is None else frame
        damps = np.isin(np.arange(1, len(none) + 1), self.dampers if self.fitted.mass_known else ())
        noise = frame.errors.noise_at(frame.p)
        masses = frame.mass_change if self.masses_changed else (none, none)
        more: Json = as_json(
            {
                "frame": {
                    "story_factor": frame.factors,
                    "story_factor_std": frame.factors_std,
                    "change_probability": none if sound is None else sound.story_probability,
                    "changed": self.changed,
                    "dashpot_probability": none if sound is None else sound.dashpot_probability,
                    "dashpot": np.where(damps, frame.dashpots[0], np.nan),
                    "dashpot_std": np.where(damps, frame.dashpots[1], np.nan),
                    "mass_change_probability": sound and sound.mass_probability,
                    "mass_change": masses[0],
                    "mass_change_std": masses[1],
                    "gain_error": frame.gains[0],
                    "gain_error_std": frame.gains[1],
                    "frequencies": self.model.modes.frequencies,
                    "frequencies_std": self.model.modes.frequencies * frame.modal_std[0],
                    "damping_ratios": self.model.ratios,
                    "damping_ratios_std": self.model.ratios * frame.modal_std[1],
                    "converged": frame.converged,
                    "inflation": frame.inflation,
                },
                "noise": {"sensor": noise.sensors, "story_force": noise.force},
                "peaks": self.peaks,
                "predicted_peaks": self.predicted_peaks,
                "limits": limits_in_json(self.limits, self.passed, len(none)),
                "fallback": self.fallback or None,
                "sensor_drifts": [
                    {"from": lower, "to": upper, "drift": drift} for lower, upper, drift in self.sensor_drifts
                ],
                "remarks": (*self.warnings, *self.remarks),
            }
        )
        return super().to_dict() | more


def _reading_remark(excitation: str, straight: float, band_limited: float) -> str:
    """Report the assumed excitation between the samples: the one with the larger log evidence."""
    taken, other = (
        ("straight lines", "band-limited") if straight >= band_limited else ("band-limited", "straight lines")
    )
    return f"between its samples the {excitation} is taken as {taken}: the floors fit that better than {other}"


def _warnings(found: Reconstruction) -> list[str]:
    """List reasons for larger errors than the stated deviations."""
    said = []
    if found.fallback:
        said.append(
            f"{found.fallback}: the motion is that of the identified frame, and its bands allow for changes since the "
            "tests. Limits, the largest drift and changes of the frame cannot be told; drifts between neighboring "
            "sensors need no model"
        )
    if found.undetermined:
        names = "; ".join(listed(names) for names in found.fitted.undetermined[:1])
        said.append(
            f"the tests do not determine the frame: many have these modes (not determined: {names}). What changed "
            "since cannot be told then, and drifts are rough. Modes at more floors, or declared floor masses, would "
            "tell"
        )
    if found.fitted.lacking:
        said.append(
            f"the modes speak against the identified model (chi-square {found.fitted.misfit:.1f} a degree of freedom, "
            f"shapes off by up to {percent(found.fitted.lacking, 1)}): the bands were widened for it; look for what it "
            "lacks with cvxshear loop"
        )
    said += [
        f"{name} reads {percent(abs(value), 1)} ± {percent(std, 1)} too {'much' if value > 0 else 'little'}: the "
        "record contradicts the frame and its other sensors otherwise; that is taken out of the motion"
        for name, value, std in found.gains_off
    ]
    if found.widening > NORMAL_95:
        said.append(
            f"sensors that were left out missed by {found.widening:.1f} times their stated deviation: the model lacks "
            "something, and all bands are as much wider for it"
        )
    return said


def remarks_of(found: Reconstruction) -> list[str]:
    """Collect remarks that the reader needs besides the numbers."""
    said = [
        "residual displacement is out of reach: accelerations do not show where a floor comes to rest, and the model "
        "returns to where it began"
    ]
    if found.recording.input == "base" and found.fitted.mass_known and found.frame.scale_std == 0:
        said.append(
            "base motion does not tell how heavy the frame is: were all floors heavier than in the tests by one part, "
            "forces would be larger by as much, and stories would seem as much softer"
        )
    if found.masses_changed:
        said.append(
            "the floors do not weigh what they did in the tests: base motion tells the change of each against the "
            "others, not that of all together"
        )
    return said


@usual_arithmetic
def reconstruct(
    source: sources.ModelSource,
    record: RecordSource,
    backend: str | Backend = "auto",
    *,
    damping: str | None = None,
    configuration: str | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    detrend: bool = True,
    fit: bool = True,
    leave_out: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Find the motion of every floor, with standard deviations, from the floors with sensors.

    Parameters
    ----------
    source : str, Path, Experiment, LoopResult, Estimate or Models
        Source of the model, as for `predict`.
    record : str, Path, TimeRecord or DrivenRecord
        Accelerations of some floors, with nan in gaps, and the excitation.
    backend : str or Backend, optional
        Solver of the steps of the frame's fit.
    damping : str, optional
        "modal", "story" or "rayleigh"; by default, the damping that the experiment declares.
    configuration : str, optional
        Configuration of the frame during the record.
    assume : sequence of str or LocatedEffect, optional
        Effects that are in the model from the start of a loop that is closed here.
    detrend : bool, optional
        Whether straight lines through the accelerations are removed as faults of the sensors, if the identified frame
        fits the record better without them.
    fit : bool, optional
        Whether the frame is fitted to the record; otherwise only the noise is fitted.
    leave_out : bool, optional
        Whether each sensor is predicted from the others, as a check.
    progress : callable, optional
        Function of the number of finished parts and the number of all parts.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InputError
        If the frame's damping is unknown, the record does not fit the frame, or no floor was measured.
    NoSolutionError
        If the backend does not solve a program.
    """
    _, frame, recorded = set_up(source, record, backend, damping, configuration, assume)
    if not recorded.floors.size:
        raise InputError("no floor's acceleration was recorded; a reconstruction needs one at least")
    if len({run.floor for run in recorded.runs}) > 1:
        raise InputError(f"{recorded.name}: the force acts on several floors; reconstruct these runs one by one")
    identified = frame.centre.model
    detrend = detrend and lasts(identified, recorded) and _has_lines(frame, recorded)
    readings = readings_of(identified, without_drift(identified, recorded) if detrend else recorded)
    done, parts = itertools.count(1), 2 + (len(recorded.floors) if leave_out else 0)

    def advance() -> None:
        if progress is not None:
            progress(next(done), parts)

    work, fitted, smoothed, evidences, fallback = _motion(frame, readings, fit=fit, detrend=detrend)
    advance()
    predicted = predicted_responses(identified, work.recording)
    checks = []
    for channel in range(len(recorded.floors)) if leave_out and len(recorded.floors) > 1 else ():
        check = frame_motion.checked(work, fitted, smoothed, channel, predicted)
        # A sensor whose samples are all missing or spikes is no check.
        checks += [check] if check.stated else []
        advance()
    runs = work.runs(fitted, frame_motion.widening(checks))
    weights = np.concatenate([each.weights for each in smoothed])
    peaks = peaks_of((run.response, run.std) for run in runs)
    found = Reconstruction(
        work.recording, frame.configuration, frame.backend.name, frame.fitted, frame.kind, fitted, work.free, fallback,
        tuple(runs), peaks, peaks_of((item, {}) for item in predicted), tuple(checks),
        np.sum((weights > 0) & (weights < 1), axis=0), np.sum(weights == 0, axis=0), (),
    )  # fmt: skip
    advance()
    named = configuration is not None
    said = sources.assumptions(frame.fitted, frame.configuration, recorded, work.recording, found.passed, named=named)
    if len(evidences) > 1:
        said.append(_reading_remark(sources.DRIVING[recorded.input], *evidences))
    return replace(found, remarks=(*said, *remarks_of(found)))


def _has_lines(frame: UncertainFrame, recorded: DrivenRecord) -> bool:
    """Whether straight lines through the channels are their sensors', by the evidence of the identified frame.

    A piece of a motion has such lines, too.
    """
    without = without_drift(frame.centre.model, recorded)
    if not sources.line_remarks(recorded, without):
        return True
    try:
        as_recorded, off = (
            _most_probable(frame, [each], free=False, detrend=detrend)[1][0]
            for each, detrend in ((recorded, False), (without, True))
        )
    except (np.linalg.LinAlgError, NoModesError):
        # `_motion` tells why the identified frame has no motion near the record.
        return True
    return off >= as_recorded


#: The setup of the motion, the frame, and its motion with only the first states.
_Fit = tuple[frame_motion.FrameMotion, FittedFrame, list[frame_motion.Smoothed]]


def _motion(
    frame: UncertainFrame, readings: Sequence[DrivenRecord], *, fit: bool, detrend: bool
) -> tuple[frame_motion.FrameMotion, FittedFrame, list[frame_motion.Smoothed], list[float], str]:
    """Find the motion under the most probable reading; return the log evidence of each, and the reason of a fallback.

    The motion is the fitted frame's. If the record is short or not that of a linear frame, or the fit does not settle,
    or it ends at an implausible frame, the motion is the identified frame's.

    Raises
    ------
    UnsuitableError
        If there is no motion of the identified frame, either.
    """
    fallback = ""
    if fit and not lasts(frame.centre.model, readings[0]):
        fallback = "the record lasts less than two periods of the frame"
    elif fit:
        try:
            best, evidences = _most_probable(frame, readings, free=True, detrend=detrend)
            fallback = _implausible(best[1])
        except (np.linalg.LinAlgError, NoModesError, NoSolutionError):
            fallback = "the fit of the frame failed"
        if not fallback:
            return *best, evidences, ""
    try:
        best, evidences = _most_probable(frame, readings, free=False, detrend=detrend)
    except (np.linalg.LinAlgError, NoModesError) as error:
        raise UnsuitableError(f"{readings[0].name}: no motion of this frame comes near the record ({error})") from error
    work, fitted, smoothed = best
    return work, fitted.doubted() if fallback else fitted, smoothed, evidences, fallback


def _implausible(fitted: FittedFrame) -> str:
    """Return why a fitted frame does not stand; an empty text if it does."""
    if not fitted.converged:
        return "the fit of the frame did not settle"
    if fitted.inflation > NONLINEAR:
        return (
            "the record is not that of a linear frame with sound sensors (the scores of the stiffnesses scatter "
            f"{fitted.inflation:.0f} times as much): a story that yields or changes meanwhile does that, and so does a "
            "channel whose clock is late"
        )
    frequency, ratio = fitted.model.modes.frequencies[0], fitted.model.ratios[0]
    far = np.abs(np.log(fitted.factors)) > np.log(FURTHEST_FACTOR)
    if ratio > HIGH or np.any(far & (fitted.story_probability < SURE)):
        return f"the fitted frame is implausible (mode 1 at {frequency:.3g} Hz with {percent(ratio, 1)} of damping)"
    return ""


def _most_probable(
    frame: UncertainFrame, readings: Sequence[DrivenRecord], *, free: bool, detrend: bool
) -> tuple[_Fit, list[float]]:
    """Return the most probable fit, and the log evidence of each reading."""

    def fit(reading: DrivenRecord) -> _Fit:
        work, fitted, smoothed = frame_motion.FrameMotion.around(frame, reading, free=free).fitted(detrend=detrend)
        # The states of a long record need much memory; `runs` computes them again with their deviations.
        return work, fitted, [replace(own, states=own.states[:1].copy()) for own in smoothed]

    fits = [fit(each) for each in readings]
    evidences = [fitted.log_evidence for _, fitted, _ in fits]
    return fits[ranking.first_largest(evidences)], evidences
