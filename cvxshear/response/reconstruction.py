"""Reconstruction: how every floor moved, from the floors that carry sensors.

First the frame as it was in this record is found from the innovations of the filter (`innovations`), then its motion by
the smoother (`smoother`), then how far both can be off: the smoother's own covariance, and what the uncertainty of the
frame moves. Each sensor is also predicted from all others, which is the one check of the bands that nothing assumes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.fit.results import plain
from cvxshear.measurement.experiment import Configuration, Limits
from cvxshear.records.motion import Drive
from cvxshear.response.damped import DampedModel, Response, response
from cvxshear.response.dynamics import Noise, Setting, dynamics
from cvxshear.response.fitted import Fitted
from cvxshear.response.frame_fit import FITTED_SAMPLES, FittedFrame, fit_frame, informative, refitted
from cvxshear.response.innovations import FIRST_FORCE, FIRST_SENSOR, PredictionErrors, Stretch
from cvxshear.response.peaks import FloorSpectra, Peaks, floor_spectra, histories, spectrum_lines
from cvxshear.response.recording import Recording, RecordingSource, recording_of
from cvxshear.response.smoother import Observed, Smoothed, Steady, smooth
from cvxshear.response.sources import ModelSource, models_of, state_of, state_remarks
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.response.varied_frame import FramePrior, VariedFrame
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import percent, ranged
from cvxshear.util.showing import Shown
from cvxshear.util.typing import Floats, Json

NAMED_CHANGE = 0.95
"""Probability from which on a story is named as changed: the loop's own level for what it adds."""

PROBED_SAMPLES = 1500
"""Samples of the strongest motion on which the directions of the frame's uncertainty are compared."""

MOST_DIRECTIONS = 8
CARRIED_SHARE = 0.995
"""Directions of the frame's uncertainty that are propagated at most, and the share of the variance that they carry
together at least where fewer do."""

CHECK_STEPS = 4
"""Gauss-Newton steps of the frame without one sensor: it starts from the fit to all."""

CHECKED_DIRECTIONS = 4
"""Directions propagated to a floor whose sensor was left out."""

WIDER = 1.3
"""Ratio of the left-out sensors' errors to their stated deviations, by which all bands are then widened, that is said:
twenty effective samples scatter by as much."""

COLOURED = 0.3
"""Correlation of an innovation with an earlier one from which on it is said that the model misses something there."""

LAGS = 20
"""Lags of the test of whiteness (Ljung and Box 1978)."""


@dataclass(frozen=True, eq=False)
class ReconstructedRun:
    """The motion during one run.

    Parameters
    ----------
    name : str
    response : Response
    std : dict of str to ndarray
        Standard deviations of the quantities over time, by the names of `peaks.histories`.
    base : ndarray, shape (samples,), optional
        Base acceleration that was estimated, m/s2; None where it was measured.
    base_std : ndarray, shape (samples,), optional
    measured : ndarray, shape (samples, m)
        m/s2; nan where missing.
    excitation : ndarray, shape (samples,)
    """

    name: str
    response: Response
    std: dict[str, Floats]
    base: Floats | None
    base_std: Floats | None
    measured: Floats
    excitation: Floats


@dataclass(frozen=True)
class SensorCheck:
    """One sensor's acceleration from all other sensors.

    Parameters
    ----------
    floor : int
    error : float
        Root mean square over time of what was left, m/s2.
    stated : float
        The same of its standard deviation, the sensor's own noise included, m/s2.
    measured : float
        Root mean square of the measurement, m/s2.
    prediction_error : float or None
        Error of the model's prediction, which looks at no sensor; None where the excitation was not measured.
    within : float
        Share of samples within 1.96 stated standard deviations.
    """

    floor: int
    error: float
    stated: float
    measured: float
    prediction_error: float | None
    within: float


@dataclass(frozen=True)
class Whiteness:
    """Whether one floor's innovations are white.

    Parameters
    ----------
    floor : int
    size : float
        Their standard deviation over the stated one.
    correlation : float
        The largest, with an earlier sample.
    lag : float
        Of that sample, s.
    p_value : float
        Of Ljung and Box's statistic.
    spikes : int
        Samples whose weight Huber's loss reduced.
    missing : int
        Samples that were not measured.
    """

    floor: int
    size: float
    correlation: float
    lag: float
    p_value: float
    spikes: int
    missing: int


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Shown):
    """The result of `reconstruct`.

    Parameters
    ----------
    recording : Recording
        As it was used.
    configuration : Configuration
    backend : str
    fitted : Fitted
        The model that was identified.
    kind : str
        Of damping.
    frame : FittedFrame
        The frame in this record.
    model : DampedModel
        Its matrices.
    runs : tuple of ReconstructedRun
    peaks : Peaks
    predicted_peaks : Peaks or None
        Of the identified model without a look at the sensors; None where the excitation was not measured.
    checks : tuple of SensorCheck
    whiteness : tuple of Whiteness
    limits : Limits or None
    passed : ndarray, shape (L, N), or None
        Probability that the drift ratio of each story passed each limit.
    remarks : tuple of str
    """

    recording: Recording
    configuration: Configuration
    backend: str
    fitted: Fitted
    kind: str
    frame: FittedFrame
    model: DampedModel
    runs: tuple[ReconstructedRun, ...]
    peaks: Peaks
    predicted_peaks: Peaks | None
    checks: tuple[SensorCheck, ...]
    whiteness: tuple[Whiteness, ...]
    limits: Limits | None
    passed: Floats | None
    remarks: tuple[str, ...]

    @property
    def widening(self) -> float:
        """Factor on all bands by which left-out sensors missed more than stated; at least 1."""
        return _widening(self.checks)

    @property
    def changed(self) -> tuple[int, ...]:
        """Stories (from 1) that changed by themselves with a probability of at least `NAMED_CHANGE`.

        Where the modes speak against the model, only those that changed by more than twice what it lacks.
        """
        large = np.abs(self.frame.factors - 1.0) > 2.0 * self.fitted.lacking
        return tuple(int(j) + 1 for j in np.flatnonzero((self.frame.story_probability >= NAMED_CHANGE) & large))

    @cached_property
    def spectra(self) -> FloorSpectra:
        """Response spectra of the floors at 5 % damping, the largest over all runs."""
        natural = self.model.modes.frequencies
        lines = spectrum_lines(float(natural[0]), float(natural[-1]), self.recording.sampling_rate)
        runs = [floor_spectra(item.response.acceleration, self.recording.step, lines) for item in self.runs]
        return FloorSpectra(lines, runs[0].damping, np.max([run.acceleration for run in runs], axis=0))

    @cached_property
    def spectra_std(self) -> Floats:
        """Of the spectra, shape (N, lines): relative, that of the floor's peak acceleration at every frequency."""
        peak = self.peaks.values["floor_acceleration"]
        relative: Floats = self.peaks.std["floor_acceleration"] / np.where(peak > 0, peak, 1.0)
        return self.spectra.acceleration * relative[:, None]

    def to_dict(self) -> Json:
        """The documented JSON; null where it does not apply."""
        frame, n = self.frame, len(self.model.M)
        noise = frame.errors.noise_at(frame.p)
        return {
            "experiment": self.fitted.experiment.name,
            "record": self.recording.name,
            "input": self.recording.input,
            "configuration": self.configuration.name,
            "backend": self.backend,
            "effects": [placed.to_dict() for placed in self.fitted.effects],
            "measured_floors": self.recording.floors.tolist(),
            "checks": [dataclasses.asdict(each) for each in self.checks],
            "widening": self.widening,
            "whiteness": [dataclasses.asdict(each) for each in self.whiteness],
            "frame": {
                "story_factor": plain(frame.factors),
                "story_factor_std": plain(frame.factors_std),
                "change_probability": plain(frame.story_probability),
                "changed": list(self.changed),
                "frequencies": plain(self.model.modes.frequencies),
                "damping_ratios": plain(self.model.ratios),
                "converged": frame.converged,
                "inflation": frame.inflation,
            },
            "noise": {"sensor": plain(noise.sensors), "story_force": noise.force},
            "peaks": self.peaks.to_dict(),
            "predicted_peaks": None if self.predicted_peaks is None else self.predicted_peaks.to_dict(),
            "limits": None
            if self.limits is None
            else [
                {
                    "name": name,
                    "story_drift": float(limit),
                    "probability": [None] * n if self.passed is None else plain(self.passed[place]),
                }
                for place, (name, limit) in enumerate(zip(self.limits.names, self.limits.story_drift, strict=True))
            ],
            "floor_spectra": {**self.spectra.to_dict(), "acceleration_std": plain(self.spectra_std)},
            "remarks": list(self.remarks),
        }


def reconstruct(
    source: ModelSource,
    record: RecordingSource,
    backend: str | Backend = "auto",
    *,
    damping: str | None = None,
    configuration: str | None = None,
    detrend: bool = True,
    fit: bool = True,
    leave_out: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Reconstruction:
    """Find how every floor moved, with deviations, from the floors that carry sensors.

    Parameters
    ----------
    source : str, Path, Experiment, Closure, Estimate or Models
        What the model is made of, as for `predict`.
    record : str, Path, TimeRecord or Motion
        Accelerations of some floors, with gaps (nan) where pieces are missing, and what drove the frame; with
        input = "none" the base acceleration is estimated.
    backend : str or Backend, optional
        Solves the steps of the frame's fit.
    damping : str, optional
        "modal", "story" or "rayleigh"; what the experiment declares where not given.
    configuration : str, optional
        Which state the frame is in.
    detrend : bool, optional
        Whether the straight line through each acceleration is taken for its sensor's, and off.
    fit : bool, optional
        Whether the frame is fitted to the record; otherwise only the noise is, and the frame stays as identified.
    leave_out : bool, optional
        Whether each sensor is predicted from the others.
    progress : callable, optional
        Called with the number of parts done and to do.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InputError
        Where nothing tells the frame's damping, the record is of another frame, or no floor was measured.
    NoSolutionError
        Where the backend does not solve a program.
    """
    solver = backends.get(backend)
    recording, line = recording_of(record), 0.0
    if detrend:
        recording, line = recording.detrended()
    models = models_of(source, solver)
    experiment = models.after.experiment
    highest = int(max(recording.floors.max(), recording.force_floor))
    if highest > experiment.stories:
        raise InputError(f"{recording.name} speaks of floor {highest}, the frame has {experiment.stories} stories")
    state = state_of(experiment, recording, configuration)
    frame = UncertainFrame.of(models.after, state, damping, solver)
    work = _Reconstructing(frame, recording, solver, progress, free=fit)
    found = work.result(leave_out=leave_out)
    remarks = [*state_remarks(experiment, recording, state), *_remarks(found, line)]
    return dataclasses.replace(found, remarks=tuple(remarks))


class _Reconstructing:
    """The parts of one reconstruction, each of which the next needs.

    Parameters
    ----------
    frame : UncertainFrame
    recording : Recording
    backend : Backend
    progress : callable, optional
    free : bool
        Whether the frame is fitted.
    """

    def __init__(
        self, frame: UncertainFrame, recording: Recording, backend: Backend,
        progress: Callable[[int, int], None] | None, *, free: bool,
    ) -> None:  # fmt: skip
        self.frame, self.recording, self.backend = frame, recording, backend
        # Without the base motion a softer first story and another base motion are one and the same.
        self.free = free and recording.input != "none"
        self.varied = VariedFrame.around(frame)
        self._progress, self._done = progress, 0
        self._parts = 5 + len(recording.floors)
        model = self.varied.centre.model
        self.predicted = self._predicted(model)
        frequencies = model.modes.frequencies
        self.setting = Setting(
            recording.floors, recording.step, recording.force_floor, recording.input != "none",
            2 * np.pi * float(frequencies[0]), 2 * np.pi * float(frequencies[-1]),
            frame.story_stiffness * self._drift_rms(model),
        )  # fmt: skip
        self.envelopes = recording.envelopes(1.0 / float(frequencies[0]))
        rms = recording.rms()
        self.noise = Noise(FIRST_SENSOR * rms, FIRST_FORCE, 0.0 if self.setting.base_measured else float(rms.min()))

    def _advance(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._parts)

    def _predicted(self, model: DampedModel) -> list[Response] | None:
        """Of the identified frame; None where the excitation was not measured."""
        recording = self.recording
        if recording.input == "none":
            return None
        drives = [Drive(run.driven, recording.force_floor, name=run.name) for run in recording.runs]
        return [response(model, drive, recording.step) for drive in drives]

    def _drift_rms(self, model: DampedModel) -> Floats:
        """Of each story, from the first mode scaled to the sensors: what a wrong frame predicts might be any size."""
        first = model.modes.shapes[0]
        seen = np.abs(first[self.recording.floors - 1] * model.gain[self.recording.floors - 1])
        amplitude = float(np.linalg.norm(self.recording.rms()) / np.linalg.norm(seen)) / float(
            model.modes.eigenvalues[0]
        )
        drift: Floats = np.abs(np.diff(first, prepend=0.0)) * amplitude
        if self.predicted is None:
            return drift
        together = np.concatenate([item.drift for item in self.predicted])
        own: Floats = np.sqrt(np.mean(together**2, axis=0))
        return own

    def result(self, *, leave_out: bool) -> Reconstruction:
        """Everything but the remarks."""
        fitted, smoothed = self._fitted()
        self._advance()
        model = fitted.model
        directions = self._directions(fitted, MOST_DIRECTIONS)
        channels = range(len(self.recording.floors)) if leave_out and len(self.recording.floors) > 1 else ()
        checks = tuple(self._check(fitted, channel, smoothed) for channel in channels)
        wider = _widening(checks)
        runs = [self._run(fitted, model, directions, place, found, wider) for place, found in enumerate(smoothed)]
        self._advance()
        peaks = _peaks([(run.response, run.std) for run in runs])
        experiment = self.frame.fitted.experiment
        passed = None
        if experiment.limits is not None and "story_drift_ratio" in peaks.values:
            ratio, std = peaks.values["story_drift_ratio"], np.maximum(peaks.std["story_drift_ratio"], 1e-300)
            passed = np.asarray(stats.norm.sf(experiment.limits.story_drift[:, None], ratio, std), dtype=np.float64)
        predicted = None
        if self.predicted is not None:
            predicted = _peaks([(item, {}) for item in self.predicted])
        return Reconstruction(
            self.recording, self.frame.configuration, self.backend.name, self.frame.fitted, self.frame.kind, fitted,
            model, tuple(runs), peaks, predicted, checks, self._whiteness(smoothed), experiment.limits, passed, (),
        )  # fmt: skip

    def _observed(self, model: DampedModel, errors: PredictionErrors, p: Floats) -> list[Observed]:
        """The runs with the process noise that the motion's strength calls for."""
        plain_model = errors.dynamics(p)
        stationary = np.sqrt(np.maximum(np.sum(plain_model.H @ plain_model.P0 * plain_model.H, axis=1), 1e-300))
        period = 1.0 / float(model.modes.frequencies[0])
        first = max(2, round(period * self.recording.sampling_rate))
        found = []
        for run, envelope in zip(self.recording.runs, self.envelopes, strict=True):
            begins = run.measured[:first]
            if not np.isfinite(begins).any():
                begins = run.measured
            moved = np.sqrt(np.nanmean(begins**2))
            scale = max(float(envelope[0]), float(moved / np.sqrt(np.mean(stationary**2))))
            found.append(Observed(run.driven, run.measured, envelope, scale))
        return found

    def _errors(self, smoothed: list[Smoothed] | None, p: Floats | None = None) -> PredictionErrors:
        """The innovations of the strongest part of each run, gaps and spikes filled in by the smoother."""
        stretches = []
        for place, run in enumerate(self.recording.runs):
            y = np.nan_to_num(run.measured) if smoothed is None else smoothed[place].completed
            start = np.zeros(3 * len(self.varied.story_stiffness) + (0 if self.setting.base_measured else 1))
            if smoothed is not None:
                start = smoothed[place].states[0]
            stretches.append(Stretch(run.driven, y, start))
        errors = PredictionErrors(self.varied, self.setting, stretches, self.noise)
        return errors.shortened(FITTED_SAMPLES, np.zeros(errors.size) if p is None else p)

    def _fitted(self) -> tuple[FittedFrame, list[Smoothed]]:
        """The frame and its motion: gaps and spikes are filled in by the identified frame, then by the fitted one."""
        fitted: FittedFrame | None = None
        smoothed: list[Smoothed] = []
        errors = self._errors(None)
        prior = FramePrior.around(self.frame, self.varied, errors.size - errors.frame.stop)
        p = np.zeros(errors.size)
        whole = not any(np.isnan(run.measured).any() for run in self.recording.runs)
        for turn in range(2):
            if turn or not whole:
                smoothed = self._smoothed(errors, p)
                errors = self._errors(smoothed, p)
                self._advance()
            if turn and fitted is not None and _clean(smoothed):
                break
            fitted = fit_frame(errors, prior, self.backend, p, free=self.free)
            p = fitted.p
            self._advance()
        assert fitted is not None
        if not _clean(smoothed):
            smoothed = self._smoothed(errors, fitted.p)
        return fitted, smoothed

    def _smoothed(self, errors: PredictionErrors, p: Floats) -> list[Smoothed]:
        model = errors.dynamics(p)
        rows = self._rows(model.outputs.rows)
        return [smooth(model, run, rows) for run in self._observed(errors.model(p), errors, p)]

    def _rows(self, outputs: Floats) -> Floats:
        """The outputs, the overturning moment, and the base acceleration where it is estimated."""
        n = len(self.varied.story_stiffness)
        heights = self.varied.centre.model.heights
        more = [] if heights is None else [heights @ outputs[3 * n :]]
        if not self.setting.base_measured:
            more.append(np.eye(outputs.shape[1])[3 * n])
        return np.concatenate([outputs, np.array(more)]) if more else outputs

    def _outputs(self, states: Floats, dynamics_outputs: Floats, direct: Floats, excitation: Floats) -> Floats:
        rows = self._rows(dynamics_outputs)
        n = len(self.varied.story_stiffness)
        heights = self.varied.centre.model.heights
        weights = np.zeros(len(rows))
        weights[: 4 * n] = direct
        if heights is not None:
            weights[4 * n] = heights @ direct[3 * n :]
        result: Floats = states @ rows.T + np.outer(excitation, weights)
        return result

    def _run(
        self, fitted: FittedFrame, model: DampedModel, directions: _Directions, place: int, found: Smoothed,
        wider: float,
    ) -> ReconstructedRun:  # fmt: skip
        """One run's motion and its deviations."""
        n = len(model.M)
        recorded = self.recording.runs[place]
        whole = fitted.errors.dynamics(fitted.p)
        moved = self._outputs(found.states, whole.outputs.rows, whole.outputs.direct, recorded.driven)
        variance = found.output_std**2
        noise = fitted.errors.noise_at(fitted.p)
        for sides in directions.sides:
            moved_by = self._moved_by(sides, noise, recorded.driven, found.completed, found.states[0])
            variance += directions.allowance * moved_by**2
        std: Floats = wider * np.sqrt(variance)
        acceleration, displacement, _, force = (moved[:, k * n : (k + 1) * n] for k in range(4))
        time = self.recording.step * np.arange(len(moved), dtype=np.float64)
        motion = Response(
            time, acceleration, displacement, force, model.heights,
            model.mass_known,
        )  # fmt: skip
        stds = dict(
            zip(
                ("floor_acceleration", "floor_displacement", "story_drift", "story_shear"),
                (std[:, k * n : (k + 1) * n] for k in range(4)),
                strict=True,
            )
        )
        if model.heights is not None:
            stds["story_drift_ratio"] = stds["story_drift"] / model.heights
            stds["overturning_moment"] = std[:, 4 * n]
        stds["base_shear"] = stds["story_shear"][:, 0]
        base = None if self.setting.base_measured else moved[:, -1]
        return ReconstructedRun(
            recorded.name, motion, stds, base, None if base is None else std[:, -1], recorded.measured, recorded.driven
        )

    def _moved_by(self, models: tuple[DampedModel, DampedModel], noise: Noise, excitation: Floats, y: Floats, start: Floats) -> Floats:
        """Half the difference of all outputs between plus and minus one standard deviation along a direction."""
        sides = []
        for model in models:
            moved = dynamics(model, noise, self.setting)
            states = Steady.of(moved).states(excitation, y, start)
            sides.append(self._outputs(states, moved.outputs.rows, moved.outputs.direct, excitation))
        result: Floats = 0.5 * (sides[0] - sides[1])
        return result

    def _directions(self, fitted: FittedFrame, most: int) -> _Directions:
        """The directions of the frame's uncertainty that move its motion most, one standard deviation long."""
        frame = fitted.errors.frame
        values, vectors = np.linalg.eigh(fitted.covariance[frame, frame])
        own = vectors * np.sqrt(np.maximum(values, 0.0))
        noise = fitted.errors.noise_at(fitted.p)
        run = max(fitted.errors.stretches, key=lambda each: float(np.mean(each.y**2)))
        part = run.strongest(PROBED_SAMPLES)
        excitation, y, start = run.excitation[part], run.y[part], np.zeros(len(run.start))

        def model_at(weights: Floats) -> DampedModel:
            p = fitted.p.copy()
            p[frame] += own @ weights
            return fitted.errors.model(p)

        def outputs(model: DampedModel) -> Floats:
            moved = dynamics(model, noise, self.setting)
            states = Steady.of(moved).states(excitation, y, start)
            return self._outputs(states, moved.outputs.rows, moved.outputs.direct, excitation)

        centre = outputs(fitted.model)
        scale = np.maximum(np.sqrt(np.mean(centre**2, axis=0)), 1e-300)
        # A tenth of a standard deviation: the directions are needed to first order only.
        slopes = np.array([(outputs(model_at(0.1 * row)) - centre) / scale / 0.1 for row in np.eye(len(own))])
        flat = slopes.reshape(len(own), -1)
        strength, turned = np.linalg.eigh(flat @ flat.T)
        order = np.argsort(-strength)
        carried = np.cumsum(np.maximum(strength[order], 0.0))
        if carried[-1] <= 0:
            return _Directions((), np.ones(len(scale)))
        chosen = order[: min(int(np.searchsorted(carried, CARRIED_SHARE * carried[-1])) + 1, most)]
        part_of = np.sum(np.tensordot(turned[:, chosen].T, slopes, axes=1) ** 2, axis=(0, 1))
        whole = np.sum(slopes**2, axis=(0, 1))
        sides = tuple((model_at(turned[:, k]), model_at(-turned[:, k])) for k in chosen)
        return _Directions(sides, whole / np.maximum(part_of, 1e-300))

    def _check(self, fitted: FittedFrame, channel: int, smoothed: list[Smoothed]) -> SensorCheck:
        """One sensor from the others: the frame fitted and the motion smoothed without it."""
        self._advance()
        setting = self.setting.without(channel)
        noise = dataclasses.replace(self.noise, sensors=np.delete(self.noise.sensors, channel))
        stretches = [
            dataclasses.replace(each, y=np.delete(each.y, channel, axis=1)) for each in fitted.errors.stretches
        ]
        errors = PredictionErrors(self.varied, setting, stretches, noise)
        start = np.delete(fitted.p, fitted.errors.frame.stop + channel)
        along = informative(errors, dataclasses.replace(fitted.prior, others=errors.size - errors.frame.stop), start)
        again = refitted(fitted, errors, start, along, self.backend, CHECK_STEPS if self.free else 0)
        other = _Reconstructing.__new__(_Reconstructing)
        other.__dict__ |= self.__dict__ | {
            "setting": setting, "recording": self.recording.without(channel), "noise": noise
        }  # fmt: skip
        directions = other._directions(again, CHECKED_DIRECTIONS)
        model = errors.dynamics(again.p)
        place = int(self.recording.floors[channel]) - 1
        gain = float(self.varied.centre.model.gain[place])
        row, direct = gain * model.outputs.rows[place], gain * model.outputs.direct[place]
        sigma = fitted.errors.noise_at(fitted.p).sensors[channel]
        error, stated, measured, predicted = [], [], [], []
        observed = other._observed(again.model, errors, again.p)
        for number, (run, given) in enumerate(zip(self.recording.runs, observed, strict=True)):
            found = smooth(model, given, row[None, :])
            variance = found.output_std[:, 0] ** 2 + sigma**2
            for sides in directions.sides:
                moved = other._moved_by(sides, errors.noise_at(again.p), run.driven, found.completed, found.states[0])
                variance += directions.allowance[place] * (gain * moved[:, place]) ** 2
            there = smoothed[number].weights[:, channel] == 1.0
            value = found.states @ row + direct * run.driven
            error.append((value - run.measured[:, channel])[there])
            stated.append(variance[there])
            measured.append(run.measured[there, channel])
            if self.predicted is not None:
                predicted.append(
                    (gain * self.predicted[number].acceleration[:, place] - run.measured[:, channel])[there]
                )
        errors_all, variances = np.concatenate(error), np.concatenate(stated)
        return SensorCheck(
            place + 1, _rms(errors_all), float(np.sqrt(np.mean(variances))), _rms(np.concatenate(measured)),
            _rms(np.concatenate(predicted)) if predicted else None,
            float(np.mean(np.abs(errors_all) <= 1.959964 * np.sqrt(variances))),
        )  # fmt: skip

    def _whiteness(self, smoothed: list[Smoothed]) -> tuple[Whiteness, ...]:
        """Of the innovations of each floor over all runs."""
        found = []
        for channel, floor in enumerate(self.recording.floors):
            runs = [np.nan_to_num(each.innovations[:, channel]) for each in smoothed]
            weights = np.concatenate([each.weights[:, channel] for each in smoothed])
            # A spike is no sign of a model that is wrong.
            power = sum(float(np.sum(np.clip(run, -5, 5) ** 2)) for run in runs)
            count = int(np.sum(weights > 0))
            lags = np.arange(1, min(LAGS, min(len(run) for run in runs) - 1) + 1)
            products = np.array(
                [sum(float(np.clip(run[lag:], -5, 5) @ np.clip(run[:-lag], -5, 5)) for run in runs) for lag in lags]
            )
            correlation = products / power
            statistic = count * (count + 2) * float(np.sum(correlation**2 / (count - lags)))
            at = int(np.argmax(np.abs(correlation)))
            found.append(
                Whiteness(
                    int(floor), float(np.sqrt(power / count)), float(correlation[at]),
                    float(lags[at]) * self.recording.step, float(stats.chi2.sf(statistic, len(lags))),
                    int(np.sum((weights > 0) & (weights < 1))), int(np.sum(weights == 0)),
                )
            )  # fmt: skip
        return tuple(found)


@dataclass(frozen=True, eq=False)
class _Directions:
    """Directions of the frame's uncertainty.

    Parameters
    ----------
    sides : tuple of pairs of DampedModel
        The frame one standard deviation to either side along each.
    allowance : ndarray, shape (outputs,)
        Variance of each output along all directions over that along these.
    """

    sides: tuple[tuple[DampedModel, DampedModel], ...]
    allowance: Floats


def _clean(smoothed: list[Smoothed]) -> bool:
    """Whether no sample was missing or a spike."""
    return all(bool(np.all(each.weights == 1.0)) for each in smoothed)


def _widening(checks: tuple[SensorCheck, ...]) -> float:
    """Factor on all bands: by how much sensors that were left out missed more than stated; at least 1."""
    if not checks:
        return 1.0
    return max(1.0, float(np.sqrt(np.mean([(each.error / each.stated) ** 2 for each in checks]))))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _peaks(runs: list[tuple[Response, dict[str, Floats]]]) -> Peaks:
    """Largest sizes over all runs, with the deviation of the sample at which each stands."""
    values: dict[str, Floats] = {}
    stds: dict[str, Floats] = {}
    for moved, deviations in runs:
        for name, history in histories(moved).items():
            if history is None:
                continue
            columns = history.reshape(len(history), -1)
            at = np.argmax(np.abs(columns), axis=0)
            take = np.arange(columns.shape[1])
            peak = np.abs(columns[at, take])
            std = np.full(len(peak), np.nan)
            if name in deviations:
                std = deviations[name].reshape(columns.shape)[at, take]
            if name in values:
                larger = peak > values[name]
                peak, std = np.where(larger, peak, values[name]), np.where(larger, std, stds[name])
            values[name], stds[name] = peak, std
    return Peaks(values, stds)


def _remarks(found: Reconstruction, line: float) -> list[str]:
    """What the reader has to know besides the numbers."""
    said = [
        "residual displacement is out of reach: accelerations do not show where a floor comes to rest, and the model "
        "returns to where it began"
    ]
    if line > 0.01:
        said.append(
            f"a straight line of up to {percent(line, 1)} of a channel's rms was taken for its sensor's and off; "
            "--no-detrend leaves it in"
        )
    if found.fitted.covariance is None:
        said.append(
            "the measurement tells no noise: the identified stiffnesses are taken as exact"
        )
    if found.recording.input == "none":
        said.append(
            "nobody measured the base motion: it is estimated with the rest, the frame is taken as identified, and "
            "whether a story changed is not asked, since another base motion would look the same"
        )
    if not found.fitted.mass_known:
        said.append("the masses have no scale (give total_mass): forces and moments are left out")
    if found.limits is not None and found.passed is None:
        said.append("drift ratios need story_heights in [frame]: the limits cannot be judged")
    if found.fitted.lacking:
        said.append(
            f"the modes speak against the identified model (chi-square {found.fitted.misfit:.1f} a degree of freedom, "
            f"shapes off by up to {percent(found.fitted.lacking, 1)}): the bands were widened for it; look for what it "
            "lacks with cvxshear loop"
        )
    if not found.frame.converged:
        said.append("the fit of the frame did not settle; its deviations may be too small")
    wider = _widening(found.checks)
    if wider > WIDER:
        said.append(
            f"sensors that were left out missed by {wider:.1f} times their stated deviation: the model lacks "
            "something, and all bands are as much wider for it"
        )
    coloured = [each for each in found.whiteness if abs(each.correlation) > COLOURED]
    if coloured:
        said.append(
            f"the innovations of floor {ranged([each.floor for each in coloured])} are not white: the model misses a "
            "part of the motion there, and the deviations of the frame were widened for it "
            f"(by {np.sqrt(found.frame.inflation):.1f})"
        )
    return said
