"""Reconstruction: the motion of every floor, with standard deviations, from the floors with sensors.

`frame_fit` fits the frame to the innovations of the filter. `smoother` computes the motion, and `frame_motion` the
standard deviations. `sensor_checks` predicts each sensor from all others, which checks the deviations.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.measurement.experiment import Configuration, Limits
from cvxshear.response.damped import DampedModel
from cvxshear.response.frame_fit import NONLINEAR, FittedFrame
from cvxshear.response.frame_motion import FrameMotion, ReconstructedRun, predicted_responses, readings_of, shown_by
from cvxshear.response.peaks import FloorSpectra, Peaks, largest_spectra, peaks_of
from cvxshear.response.recording import Recording, RecordingSource, recording_of
from cvxshear.response.sensor_checks import SensorCheck, Whiteness, as_predicted, checked, whiteness, widening
from cvxshear.response.smoother import Smoothed
from cvxshear.response.sources import DRIVING, Fitted, ModelSource, line_remarks, models_of, state_of, state_remarks
from cvxshear.response.state_space import Response
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property, usual_arithmetic
from cvxshear.util.quantities import listed, numbered, percent, ranged
from cvxshear.util.results import Shown, as_json
from cvxshear.util.typing import Floats, Json

NAMED_CHANGE = 0.95
"""Minimum probability of a reported change; the loop uses the same level for effects."""

SIGN_KNOWN = 1.645
"""Minimum change of a reported story, in standard deviations: its sign is 95 % probable."""

WIDER = 1.3
"""Maximum ratio of the left-out sensors' errors to their deviations without a warning: the scatter of twenty
independent samples."""

GAIN_OFF = 3.0, 0.005
"""Minimum gain error that is reported, in standard deviations and relative: a good calibration has less."""

MISSED_MOST = 1.5
"""Minimum ratio of the missed force between two sensors to the largest elsewhere for these stories to be reported; a
yielding story gave 1.5 to 2.5 in simulated frames."""

SOUND_SCORES = 2.0
"""Maximum inflation of the scores for a reported mass change. Linear frames have 1 to 2; undeclared dampers give 3 and
more and resemble mass changes."""

LARGEST_ODDS = 1000.0
"""Largest odds that are printed as a number; model errors make larger odds meaningless."""

UNSETTLED = "the fit of the frame did not settle, so no number is sure, and drifts are rough"
"""Warning that is the first of the findings."""

QUIET_ENOUGH = 0.25
"""Maximum strength of the quietest part of a record, relative to its rms, for a reliable straight line. In a record
without a quieter part, the line changes peaks by up to four standard deviations."""

ROUGH_DRIFT = 0.1
"""Relative standard deviation of drifts if the record does not fit a linear frame, the fit does not converge, or the
tests do not determine the frame. The drift of a yielding story is 3 to 17 % too low, and of its neighbors up to 9 % too
high (``tests.studies.reconstruction``)."""


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Shown):
    """The result of `reconstruct`.

    Parameters
    ----------
    recording : Recording
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
        Whether the frame was fitted to the record: not if the base motion was not measured or `fit` was False.
    model : DampedModel
        Matrices of the frame in this record.
    runs : tuple of ReconstructedRun
    peaks : Peaks
    predicted_peaks : Peaks or None
        Peaks that the identified model predicts from the excitation alone; None if the excitation was not measured.
    checks : tuple of SensorCheck
    whiteness : tuple of Whiteness
    limits : Limits or None
    passed : ndarray, shape (L, N), or None
        Probability that the drift ratio of each story passed each limit; nan if it is unknown.
    remarks : tuple of str
    """

    recording: Recording
    configuration: Configuration
    backend: str
    fitted: Fitted
    kind: str
    frame: FittedFrame
    frame_fitted: bool
    model: DampedModel
    runs: tuple[ReconstructedRun, ...]
    peaks: Peaks
    predicted_peaks: Peaks | None
    checks: tuple[SensorCheck, ...]
    whiteness: tuple[Whiteness, ...]
    limits: Limits | None
    passed: Floats | None
    remarks: tuple[str, ...]

    json_keys = (
        "experiment=fitted.experiment.name record=recording.name input=recording.input "
        "configuration=configuration.name backend effects=fitted.effects measured_floors=recording.floors checks "
        "widening whiteness"
    )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sensor faults, and reasons for larger errors than the stated deviations; read them before the numbers."""
        return *self.recording.remarks, *_warnings(self)

    @property
    def widening(self) -> float:
        """Factor on all bands: ratio of the left-out sensors' errors to their stated deviations, at least 1."""
        return widening(self.checks)

    @property
    def changed(self) -> tuple[int, ...]:
        """Stories (from 1) that changed by themselves with a probability of at least `NAMED_CHANGE`.

        The sign of the change must be known. If the modes contradict the model, the change must also exceed twice the
        model's shape error. The tuple is empty if the fit did not converge.
        """
        if self.change_probability is None or not self.names_changes:
            return ()
        change, std = self.frame.against_others
        large = np.abs(change) > np.maximum(2.0 * self.fitted.lacking, SIGN_KNOWN * std)
        return tuple(int(j) + 1 for j in np.flatnonzero((self.change_probability >= NAMED_CHANGE) & large))

    @property
    def nonlinear(self) -> bool:
        """Whether the record does not fit a linear frame with sound sensors."""
        return self.frame.inflation > NONLINEAR

    @property
    def names_changes(self) -> bool:
        """Whether changes since the tests are reported: record and tests must fit the model of a linear frame."""
        fits = self.frame_fitted and self.frame.converged and not self.nonlinear and not self.undetermined
        return fits and self.widening <= WIDER

    @property
    def undetermined(self) -> bool:
        """Whether many frames have the modes of the tests; changes since the tests are then not reported."""
        return bool(self.fitted.undetermined)

    @property
    def coloured(self) -> tuple[int, ...]:
        """Floors with colored innovations: the model misses a part of the motion there."""
        return tuple(each.floor for each in self.whiteness if each.coloured)

    @property
    def sound(self) -> bool:
        """Whether the model passes its checks: a linear frame, small errors of left-out sensors, white innovations."""
        return self.names_changes and not self.coloured

    @property
    def dampers(self) -> tuple[int, ...]:
        """Stories (from 1) that have a damper of their own, with a probability of at least `NAMED_CHANGE`.

        The damper must also exceed `SIGN_KNOWN` standard deviations.
        """
        if not self.names_changes:
            return ()
        damper, std = self.frame.dashpots
        there = (self.frame.dashpot_probability >= NAMED_CHANGE) & (damper > SIGN_KNOWN * std)
        return tuple(int(j) + 1 for j in np.flatnonzero(there))

    @property
    def missed_most(self) -> tuple[int, ...]:
        """Stories (from 1) between two floors with sensors, with the largest deviations from a linear frame.

        Empty if the record fits a linear frame, or if no stories exceed the others clearly.
        """
        edges = np.concatenate([[0], self.recording.floors])
        stories = np.split(np.arange(1, len(self.model.M) + 1), edges[1:])
        if not self.nonlinear or not self.frame_fitted:
            return ()
        missed = np.max([run.missed for run in self.runs], axis=0)
        between = [each for each in stories if each.size]
        sizes = [float(np.max(missed[each - 1])) for each in between]
        most = ranking.first_largest(sizes)
        others = max(np.delete(sizes, most), default=0.0)
        return tuple(between[most].tolist()) if len(sizes) > 1 and sizes[most] > MISSED_MOST * others else ()

    @property
    def masses_changed(self) -> bool:
        """Whether a mass change is reported."""
        return self.sound and self.frame.inflation <= SOUND_SCORES and self.frame.mass_probability >= NAMED_CHANGE

    @property
    def gains_off(self) -> tuple[tuple[str, float, float], ...]:
        """Sensors with a wrong gain: name, relative gain error, and its standard deviation."""
        names = [f"the sensor of floor {floor}" for floor in self.recording.floors]
        names += [f"the sensor of the {DRIVING[self.recording.input]}"] if self.recording.input != "none" else []
        deviations, least = GAIN_OFF
        return tuple(
            (name, float(value), float(std))
            for name, value, std in zip(names, *self.frame.gains, strict=True)
            if self.frame_fitted and not self.undetermined and abs(value) > max(deviations * std, least)
        )

    @property
    def change_probability(self) -> Floats | None:
        """Probability that each story changed by itself, shape (N,); None if the frame was not fitted or determined."""
        return self.frame.story_probability if self.frame_fitted and not self.undetermined else None

    @cached_property
    def spectra(self) -> FloorSpectra:
        """Response spectra of the floors at 5 % damping, the largest over all runs."""
        return largest_spectra(self.model, [run.response.acceleration for run in self.runs], self.recording.step)

    @cached_property
    def spectra_std(self) -> Floats:
        """Standard deviations of the spectra, shape (N, lines), from the relative deviations of the floors' peaks."""
        peak = self.peaks.values["floor_acceleration"]
        relative: Floats = self.peaks.std["floor_acceleration"] / np.where(peak > 0, peak, 1.0)
        return self.spectra.acceleration * relative[:, None]

    def to_dict(self) -> Json:
        """Return the documented JSON; null for values that do not apply."""
        frame, none = self.frame, [None] * len(self.model.M)
        sound = None if self.change_probability is None else frame
        damps = np.isin(np.arange(1, len(none) + 1), self.dampers if self.fitted.mass_known else ())
        noise, chances = frame.errors.noise_at(frame.p), self.passed
        limits = self.limits and [
            {"name": name, "story_drift": drift, "probability": none if chances is None else chances[place]}
            for place, (name, drift) in enumerate(zip(self.limits.names, self.limits.story_drift, strict=True))
        ]
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
                    "missed_most": self.missed_most,
                    "mass_change_probability": sound and sound.mass_probability,
                    "mass_change": masses[0],
                    "mass_change_std": masses[1],
                    "gain_error": frame.gains[0],
                    "gain_error_std": frame.gains[1],
                    "frequencies": self.model.modes.frequencies,
                    "damping_ratios": self.model.ratios,
                    "converged": frame.converged,
                    "inflation": frame.inflation,
                },
                "noise": {"sensor": noise.sensors, "story_force": noise.force},
                "peaks": self.peaks,
                "predicted_peaks": self.predicted_peaks,
                "limits": limits,
                "floor_spectra": {**self.spectra.to_dict(), "acceleration_std": self.spectra_std},
                "remarks": (*self.warnings, *self.remarks),
            }
        )
        return super().to_dict() | more


def reading_remark(excitation: str, straight: float, band_limited: float, *, sound: bool) -> str:
    """Report the assumed excitation between the samples, and the evidence for it if the model is sound."""
    taken, other = "band-limited", "straight lines"
    if straight >= band_limited:
        taken, other = other, taken
    odds = abs(straight - band_limited)
    shown = f"above {LARGEST_ODDS:g}" if odds > np.log(LARGEST_ODDS) else f"{np.exp(odds):.0f} to 1"
    speaks = f"that makes what the floors did more probable than {other} would (odds {shown})"
    if not sound:
        speaks = f"so the model fits the floors better, but it fails a check, and {other} may be as right"
    elif odds < np.log(10):
        speaks = f"the floors hardly tell that from {other}; a record at a higher rate would"
    return f"between its samples the {excitation} is taken as {taken}: {speaks}"


def _warnings(found: Reconstruction) -> list[str]:
    """List reasons for larger errors than the stated deviations."""
    said = []
    if found.undetermined:
        names = "; ".join(listed(names) for names in found.fitted.undetermined[:1])
        said.append(
            f"the tests do not determine the frame: many have these modes (not determined: {names}). What changed "
            f"since cannot be told then, and drifts are rough: {percent(ROUGH_DRIFT, 0)} of each is in its deviation. "
            "Modes at more floors, or declared floor masses, would tell"
        )
    if found.fitted.lacking:
        said.append(
            f"the modes speak against the identified model (chi-square {found.fitted.misfit:.1f} a degree of freedom, "
            f"shapes off by up to {percent(found.fitted.lacking, 1)}): the bands were widened for it; look for what it "
            "lacks with cvxshear loop"
        )
    if found.frame_fitted and not found.frame.converged:
        said.append(UNSETTLED)
    said += [
        f"{name} reads {percent(abs(value), 1)} ± {percent(std, 1)} too {'much' if value > 0 else 'little'}: the "
        "record contradicts the frame and its other sensors otherwise; that is taken out of the motion"
        for name, value, std in found.gains_off
    ]
    wider = widening(found.checks)
    if wider > WIDER:
        said.append(
            f"sensors that were left out missed by {wider:.1f} times their stated deviation: the model lacks "
            "something, and all bands are as much wider for it"
        )
    if found.nonlinear:
        said.append(
            "the record is not that of a linear frame with sound sensors (the scores of the stiffnesses scatter "
            f"{found.frame.inflation:.0f} times as much): a story that yields or changes meanwhile does that, and so "
            f"does a channel whose clock is late; a story of which a third yields drifted up to a sixth more than is "
            f"said, and {percent(ROUGH_DRIFT, 0)} of each drift is in its deviation, but one that yields as a "
            "whole drifted further: where a limit was not passed for sure, it is not said"
        )
    if found.missed_most:
        said.append(
            f"what no linear frame explains is largest in {numbered('story', found.missed_most)}, between floors with "
            "sensors: a story that yields is most likely there (provisional: one record, one model)"
        )
    return said


def remarks_of(found: Reconstruction, recorded: Recording) -> list[str]:
    """Collect remarks that the reader needs besides the numbers."""
    said = [
        "residual displacement is out of reach: accelerations do not show where a floor comes to rest, and the model "
        "returns to where it began"
    ]
    pairs = zip(recorded.runs, found.recording.runs, strict=True)
    line = max(float(np.nanmax(np.abs(raw.measured - run.measured) / recorded.rms())) for raw, run in pairs)
    of_lines = line_remarks(line, "a channel's rms")
    quietest = max(float(each.min()) for each in found.recording.envelopes(found.frame.errors.varied.period))
    if of_lines and quietest > QUIET_ENOUGH:
        of_lines.append(
            "the record is cut out of the motion, and what is cut off leaves a straight line, too: a peak is known no "
            "better than --no-detrend moves it"
        )
    said += of_lines
    if found.recording.input == "base" and found.fitted.mass_known and found.frame.scale_std == 0:
        said.append(
            "base motion does not tell how heavy the frame is: were all floors heavier than in the tests by one part, "
            "forces would be larger by as much, and stories would seem as much softer"
        )
    if found.fitted.covariance is None:
        said.append("the measurement tells no noise: the identified stiffnesses are taken as exact")
    if found.recording.input == "none":
        said.append(
            "nobody measured the base motion: it is estimated with the rest, the frame is taken as identified, and "
            "whether a story changed is not asked, since another base motion would look the same"
        )
    if not found.fitted.mass_known:
        said.append("the masses have no scale (give total_mass): forces and moments are left out")
    if found.masses_changed:
        said.append(
            "the floors do not weigh what they did in the tests: base motion tells the change of each against the "
            "others, not that of all together"
        )
    if found.limits is not None and found.passed is None:
        said.append("drift ratios need story_heights in [frame]: the limits cannot be judged")
    if found.coloured:
        inflated = np.sqrt(found.frame.inflation)
        more = f", and the deviations of the frame are {inflated:.2g} times those of white innovations"
        said.append(
            f"the innovations of floor {ranged(found.coloured)} are not white: the model misses a "
            f"part of the motion there{more if inflated > WIDER else ''}; a channel whose clock is late (cvxshear "
            "modes says which), a story that yields or another kind of damping (--damping) does that"
        )
    return said


@usual_arithmetic
def reconstruct(
    source: ModelSource,
    record: RecordingSource,
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
        Accelerations of some floors, with nan in gaps, and the excitation; with input = "none" the base acceleration
        is estimated.
    backend : str or Backend, optional
        Solver of the steps of the frame's fit.
    damping : str, optional
        "modal", "story" or "rayleigh"; by default, the damping that the experiment declares.
    configuration : str, optional
        Configuration of the frame during the record.
    assume : sequence of str or LocatedEffect, optional
        Effects that are in the model from the start of a loop that is closed here.
    detrend : bool, optional
        Whether the straight line through each acceleration is removed as a fault of the sensor.
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
    solver = backends.get(backend)
    models = models_of(source, solver, assume)
    experiment = models.after.experiment
    recording = recording_of(record, experiment.stories)
    state = state_of(experiment, recording, configuration)
    frame = UncertainFrame.of(models.after, state, damping, solver)
    identified = frame.at(np.zeros(frame.size)).model
    recording = recorded = as_predicted(identified, recording)
    if detrend:
        recording = recording.without_base_line()
    readings = readings_of(identified, recording)
    done, parts = itertools.count(1), 2 + len(readings) + (len(recording.floors) if leave_out else 0)

    def advance() -> None:
        if progress is not None:
            progress(next(done), parts)

    def fits() -> Iterator[_Fit]:
        for each in readings:
            reading = each
            if detrend:
                shown = shown_by(identified, predicted_responses(identified, reading), reading)
                reading = reading.less(reading.lines(shown))
            work, fitted, smoothed = FrameMotion.around(frame, reading, solver, free=fit).fitted(detrend=detrend)
            # The states of a long record need much memory; `runs` computes them again with their deviations.
            yield work, fitted, [dataclasses.replace(own, states=own.states[:1].copy()) for own in smoothed]
            advance()

    (work, fitted, smoothed), evidences = _most_probable(fits())
    predicted = predicted_responses(identified, work.recording)
    advance()
    checks = []
    for channel in range(len(recording.floors)) if leave_out and len(recording.floors) > 1 else ():
        checks.append(checked(work, fitted, smoothed, channel, predicted))
        advance()
    nonlinear = fitted.inflation > NONLINEAR
    rough = nonlinear or bool(frame.fitted.undetermined) or (work.free and not fitted.converged)
    runs = work.runs(fitted, widening(checks), ROUGH_DRIFT if rough else 0.0)
    peaks = peaks_of((run.response, run.std) for run in runs)
    passed = None if experiment.limits is None else _passed(experiment.limits, peaks, predicted, nonlinear=nonlinear)
    found = Reconstruction(
        work.recording, state, solver.name, frame.fitted, frame.kind, fitted, work.free, fitted.model, tuple(runs),
        peaks,
        None if predicted is None else peaks_of((item, {}) for item in predicted), tuple(checks),
        whiteness(work, smoothed), experiment.limits, passed, (),
    )  # fmt: skip
    advance()
    said = state_remarks(experiment, recording, state, named=configuration is not None)
    if len(evidences) > 1:
        said.append(reading_remark(DRIVING[recording.input], *evidences, sound=found.sound))
    return dataclasses.replace(found, remarks=(*said, *remarks_of(found, recorded)))


def _passed(limits: Limits, peaks: Peaks, predicted: Sequence[Response] | None, *, nonlinear: bool) -> Floats | None:
    """Compute the probability that each drift ratio passed each limit, shape (L, N); None without story heights.

    If the frame is nonlinear, the drift of a yielding story is unknown. Then only certain exceedances are reported, and
    only if the identified frame would have exceeded the limit, too.
    """
    name = "story_drift_ratio"
    if name not in peaks.values:
        return None
    drift, std = limits.story_drift[:, None], np.maximum(peaks.std[name], 1e-300)
    passed = np.asarray(special.ndtr((peaks.values[name] - drift) / std), dtype=np.float64)
    if not nonlinear:
        return passed
    alone = np.inf if predicted is None else peaks_of((each, {}) for each in predicted).values[name]
    return np.where((passed >= NAMED_CHANGE) & (alone > drift), passed, np.nan)


_Fit = tuple[FrameMotion, FittedFrame, list[Smoothed]]
"""The setup of the motion, the frame, and its motion with only the first states."""


def _most_probable(fits: Iterator[_Fit]) -> tuple[_Fit, list[float]]:
    """Return the most probable fit, and the log evidence of each; only one fit is kept, to save memory."""
    best = next(fits)
    evidences = [best[1].log_evidence]
    for other in fits:
        evidences.append(other[1].log_evidence)
        if evidences[-1] > best[1].log_evidence:
            best = other
    return best, evidences
