"""Motion of a frame in a record by a smoother, its standard deviations, and its check by sensors that are left out.

A standard deviation has two parts: the smoother's own for a given frame, and the effect of the frame's uncertainty,
along the directions that change the motion most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from cvxshear.records.motion import DrivenRecord, DrivenRun, differentiated
from cvxshear.response import frame_fit, state_space
from cvxshear.response.compare import predicted_responses
from cvxshear.response.damping import DampedModel
from cvxshear.response.frame_prior import FramePrior
from cvxshear.response.innovations import FIRST_NOISE, Filter, PredictionErrors, Segment, strongest
from cvxshear.response.recording import Piece, cut, on_time, parted, rms, without_lines
from cvxshear.response.sources import covariance_root
from cvxshear.response.state_space import BLOCK, Dynamics
from cvxshear.response.uncertain import UncertainFrame, either_side
from cvxshear.response.varied_frame import DIFFERENCE, VariedFrame
from cvxshear.util import ranking
from cvxshear.util.quantities import NORMAL_95
from cvxshear.util.typing import Floats

#: Minimum residual of a spike, in standard deviations; Gaussian noise has one in two million samples.
SPIKE = 5.0

#: Maximum number of rounds of reweighting; each needs one sweep.
MOST_REWEIGHTINGS = 12

#: Maximum change of a weight at convergence: a fiftieth of the sample's influence.
SAME_WEIGHT = 0.02

#: Relative difference of variances from their limits, a `BLOCK` or more after a change of the weights, at which the
#: limits replace them. The replacement saves time and memory.
NEAR_LIMIT = 0.05

#: Number of propagated directions of the frame's uncertainty. A factor accounts for the rest of the variance.
MOST_DIRECTIONS = 8


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The states of a run and their uncertainty.

    Parameters
    ----------
    states : ndarray, shape (samples, n)
    weights : ndarray, shape (samples, m)
        Weights of the samples: 1, less for a spike, 0 if missing.
    output_std : ndarray, shape (samples, outputs)
        Standard deviations of the requested outputs, given the frame.
    completed : ndarray, shape (samples, m)
        The measured accelerations, spikes cut to Huber's limit and missing samples estimated. An ordinary
        smoother finds the same motion from them.
    """

    states: Floats
    weights: Floats
    output_std: Floats
    completed: Floats


#: First sample of a segment, the sample after its end, and its filter.
Stretch = tuple[int, int, Filter]


def smooth(model: Dynamics, run: DrivenRun, rows: Floats, P0: Floats) -> Smoothed:
    """Find the most probable motion, and standard deviations of rows times the states.

    Over the states x_0, x_1, ... of `Dynamics`, the motion minimizes

        |P0^(-1/2) x_0|^2 + sum |Q^(-1/2) (x_(t+1) - A x_t - B p_t)|^2 + sum w_tj (y_tj - H_j x_t - D_j p_t)^2 / R_j,

    with the covariance P0 of the first state, shape (n, n).
    The normal matrix is block tridiagonal. It is eliminated forward (the Kalman filter) and back (the smoother of
    Bryson and Frazier 1963, which needs no inverse of a covariance). A missing sample has the weight zero. Iterative
    reweighting minimizes Huber's loss, which grows linearly beyond `SPIKE` standard deviations and limits the influence
    of spikes.
    """
    present = np.isfinite(run.measured)
    weights = present.astype(np.float64)
    shown, measured = model.shown(run.drive), np.nan_to_num(run.measured)
    for _ in range(MOST_REWEIGHTINGS):
        stretches = _stretches(model, P0, weights)
        states = _swept(stretches, run.drive, measured, np.zeros(len(model.A)))
        fitted = states @ model.H.T + shown
        size = np.abs(measured - fitted) / np.sqrt(model.R)
        found = np.where(present, np.minimum(1.0, SPIKE / np.maximum(size, SPIKE)), 0.0)
        if np.max(np.abs(found - weights), initial=0.0) <= SAME_WEIGHT:
            break
        weights = found
    completed = fitted + weights * (measured - fitted)
    std = _deviations(rows, stretches, len(states))
    return Smoothed(states, weights, std, completed)


def _stretches(model: Dynamics, P: Floats, weights: Floats) -> list[Stretch]:
    """Split a run into segments with one filter: a filter that settles has one sample per segment."""
    edges = [0, *(np.flatnonzero(np.any(np.diff(weights, axis=0), axis=1)) + 1).tolist(), len(weights)]
    found = []
    for first, last in pairwise(edges):
        own = model.weighted(weights[first])
        limit = Filter.settled(own) if last - first > BLOCK else None
        t = first
        while t < last:
            settled = limit if limit and t - first >= BLOCK and _near(P, limit.P) else None
            here, until = (Filter.at(own, P), t + 1) if settled is None else (settled, last)
            found.append((t, until, here))
            t, P = until, here.following
    return found


def _near(covariance: Floats, limit: Floats) -> bool:
    """Return whether all variances are close to their limits."""
    variances, limits = covariance.diagonal(), limit.diagonal()
    return bool(np.all(np.abs(variances - limits) <= NEAR_LIMIT * limits))


def _swept(stretches: Sequence[Stretch], excitation: Floats, y: Floats, start: Floats) -> Floats:
    """Compute the smoothed states: one sweep forward, one back."""
    states, e = np.empty((len(y), len(start))), np.empty_like(y)
    for first, last, here in stretches:
        # The filter predicts the first sample of the next segment, too.
        reached = slice(first, last + 1)
        own = np.where(here.model.H.any(axis=1), y[reached], here.model.shown(excitation[reached]))
        predicted, left = here.predicted(excitation[reached], own, start)
        if last == len(y):
            predicted, left = np.vstack([predicted, start]), np.vstack([left, left[-1]])
        states[first:last], start = predicted[: last - first], predicted[last - first]
        e[first:last] = left[: last - first]
    # The backward sweep adds the information of later samples: r_(t-1) = H' S^-1 e_t + F' r_t.
    r = np.zeros(len(start))
    for first, last, here in reversed(stretches):
        ahead = np.concatenate([e[first:last][::-1], np.zeros((1, e.shape[1]))])
        pulls = state_space.recursion(here.F.T, here.pull, ahead, r)[:0:-1]
        states[first:last] += pulls @ here.P
        r = pulls[0]
    return states


def _deviations(rows: Floats, stretches: Sequence[Stretch], samples: int) -> Floats:
    """Compute standard deviations of smoothed outputs: P - P N P with N = H' S^-1 H + F' N F, backward."""
    N: Floats = np.zeros_like(stretches[0][2].P)
    result = np.empty((samples, len(rows)))
    for first, last, here in reversed(stretches if len(rows) else ()):
        F, own, spread = here.F, here.model.H.T @ here.pull, rows @ here.P
        plain = np.sum(spread * rows, axis=1)
        limit = state_space.doubled(F.T, own) if last - first > BLOCK else None
        for t in range(last - 1, first - 1, -1):
            N = own + F.T @ N @ F
            N = 0.5 * (N + N.T)
            settled = limit is not None and last - t > BLOCK and _near(N, limit)
            N = limit if limit is not None and settled else N
            variance = plain - np.sum((spread @ N) * spread, axis=1)
            result[first if settled else t : t + 1] = np.sqrt(np.maximum(variance, 0.0))
            if settled:
                break
    return result


def settled_states(model: Dynamics, excitation: Floats, y: Floats, start: Floats, pieces: Sequence[Piece]) -> Floats:
    """Compute smoothed states with filters that are settled from the beginning of each piece, shape (samples, n).

    Parameters
    ----------
    excitation : ndarray, shape (samples, 2)
    y : ndarray, shape (samples, m)
        Accelerations without missing samples.
    start : ndarray, shape (n,)
    pieces : sequence of Piece
        Consecutive pieces from the first to the last sample.
    """
    filters = {each.tobytes(): Filter.settled(model.weighted(each.astype(np.float64))) for _, each in pieces}
    stretches = [(part.start, part.stop, filters[each.tobytes()]) for part, each in pieces]
    return _swept(stretches, excitation, y, start)


@dataclass(frozen=True, eq=False)
class ReconstructedRun:
    """Motion during one run.

    Parameters
    ----------
    std : dict of str to ndarray
        Standard deviations over time, by the names of `predicted.histories`.
    measured : ndarray, shape (samples, m)
        m/s2; nan for missing samples.
    excitation : ndarray, shape (samples,)
    """

    name: str
    response: state_space.Response
    std: dict[str, Floats]
    measured: Floats
    excitation: Floats


#: Frames on both sides along a direction of the frame's uncertainty, and the ratio of a standard deviation to their
#: distance: 1 if the frame has modes at this distance.
Sides = tuple[DampedModel, DampedModel, float]

#: Sides along the directions that change the motion most, and the ratio of each output's variance along all directions
#: to the variance along these, shape (outputs,).
Directions = tuple[tuple[Sides, ...], Floats]


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """A frame and the recording of its sensors.

    Parameters
    ----------
    frame : UncertainFrame
        The identified frame.
    noise : Noise
        Starting values of the noise levels.
    free : bool
        Whether the frame is fitted.
    """

    frame: UncertainFrame
    varied: VariedFrame
    recording: DrivenRecord
    setting: state_space.Setting
    noise: state_space.Noise
    free: bool

    @staticmethod
    def around(frame: UncertainFrame, recording: DrivenRecord, *, free: bool) -> FrameMotion:
        """Set up the reconstruction of a recording around an identified frame."""
        varied = VariedFrame.around(frame, recording.floors)
        model = varied.centre.model
        drifts = np.concatenate([each.drift for each in predicted_responses(model, recording)])
        setting = state_space.Setting(
            recording.floors, recording.step, recording.runs[0].floor, 2 * np.pi / varied.period,
            frame.story_stiffness * np.sqrt(np.mean(drifts**2, axis=0)), model.M,
        )  # fmt: skip
        driven, *moved = recording.rms()
        noise = state_space.Noise(FIRST_NOISE * np.array(moved), FIRST_NOISE, FIRST_NOISE * driven)
        return FrameMotion(frame, varied, recording, setting, noise, free)

    def fitted(self, *, detrend: bool) -> tuple[FrameMotion, frame_fit.FittedFrame, list[Smoothed]]:
        """Fit the frame and find its motion; first the identified frame, then the fitted one fills in short gaps.

        With `detrend`, straight lines beside the motion of the fitted frame are removed from the record.
        Spikes are filled in as well. One more fit is enough: an error of a gap decreases by its share of the
        information, and longer gaps are not filled in. A sure delay of a sensor is removed and the fit repeated.
        """
        errors = self.errors()
        prior = FramePrior.around(self.frame, self.varied, errors.size - errors.frame.stop)
        p = np.zeros(errors.size)
        if any(np.isnan(run.measured).any() for run in self.recording.runs):
            errors = self.errors(self.smoothed(errors, p))
        fitted = frame_fit.fit_frame(errors, prior, self.frame.backend, free=self.free)
        work, smoothed = self, self.smoothed(errors, fitted.p)
        if detrend:
            model, pairs = errors.dynamics(fitted.p), zip(self.recording.runs, smoothed, strict=True)
            shown = [found.states @ model.H.T + model.shown(run.drive) for run, found in pairs]
            work = replace(self, recording=without_lines(self.recording, shown))
            smoothed = work.smoothed(errors, fitted.p)
        recording, late, known = work.recording, *np.zeros((2, len(self.recording.floors)))
        for again in range(frame_fit.MOST_REFITS):
            (more, std), p = fitted.delays, fitted.p.copy()
            if not np.any(more) and (again or all(np.all(each.weights == 1.0) for each in smoothed)):
                break
            if np.any(more):
                late, known = late + more, np.where(more, std, known)
                work = replace(work, recording=_on_time(recording, late, known))
                p[errors.delays] = 0.0
                smoothed = work.smoothed(errors, p)
            errors = work.errors(smoothed)
            fitted = frame_fit.fit_frame(errors, prior, self.frame.backend, p, free=self.free)
            smoothed = work.smoothed(errors, fitted.p)
        return work, fitted, smoothed

    def errors(self, smoothed: list[Smoothed] | None = None) -> PredictionErrors:
        """Set up the innovations of the strongest part of each run; the smoother fills in spikes and short gaps."""
        stretches = []
        for place, run in enumerate(self.recording.runs):
            y = np.nan_to_num(run.measured) if smoothed is None else smoothed[place].completed
            parts = [each for each in self.pieces(run) if each[1].any()]
            slopes = np.column_stack([differentiated(each, 1.0, "velocity")[0] for each in y.T])
            stretches += [Segment(run.drive[part], y[part], channels, slopes[part]) for part, channels in parts]
        return PredictionErrors(self.varied, self.setting, stretches, self.noise).shortened(frame_fit.FITTED_SAMPLES)

    def pieces(self, run: DrivenRun) -> list[Piece]:
        """Split a run at the ends of gaps of a sensor that last a period of the frame or longer."""
        return parted(run, self.varied.first_samples(self.recording.step))

    def smoothed(self, errors: PredictionErrors, p: Floats, rows: Floats | None = None) -> list[Smoothed]:
        """Find the motion of each run; rows on the state, if any, define outputs with standard deviations."""
        model = errors.dynamics(p)
        asked = np.zeros((0, self.setting.states)) if rows is None else rows
        found = []
        for run in self.recording.runs:
            seen = run.measured[: self.varied.first_samples(self.recording.step)]
            seen = seen if np.isfinite(seen).any() else run.measured
            found.append(smooth(model, run, asked, model.start_covariance(seen)))
        return found

    def runs(self, fitted: frame_fit.FittedFrame, wider: float) -> list[ReconstructedRun]:
        """Return every run's motion; widen all deviations by a factor."""
        sides, allowance = self.directions(fitted)
        noise = fitted.errors.noise_at(fitted.p)
        rows = fitted.errors.dynamics(fitted.p).outputs
        model, n = fitted.model, len(self.varied.story_stiffness)
        result = []
        smoothed = self.smoothed(fitted.errors, fitted.p, rows.rows)
        for run, found in zip(self.recording.runs, smoothed, strict=True):
            std = found.output_std
            np.square(std, out=std)
            std += allowance * sum(self.moved_by(each, noise, run, found) ** 2 for each in sides)
            np.sqrt(std, out=std)
            std *= wider
            moved = rows.of(found.states, run.drive)
            forces = slice(3 * n, 4 * n + (model.heights is not None))
            std[:, forces] = np.hypot(std[:, forces], fitted.scale_std * moved[:, forces])
            motion = state_space.response_of(model, moved, self.recording.step)
            names = ("floor_acceleration", "floor_displacement", "story_drift", "story_shear")
            stds = {name: std[:, k * n : (k + 1) * n] for k, name in enumerate(names)}
            stds["base_shear"] = stds["story_shear"][:, 0]
            if model.heights is not None:
                stds["story_drift_ratio"] = stds["story_drift"] / model.heights
                stds["overturning_moment"] = std[:, 4 * n]
            result.append(ReconstructedRun(run.name, motion, stds, run.measured, run.excitation))
        return result

    def moved_by(self, sides: Sides, noise: state_space.Noise, run: DrivenRun, found: Smoothed) -> Floats:
        """Compute half the difference of all outputs between two frames, per standard deviation, (samples, outputs)."""
        systems = [state_space.dynamics(model, noise, self.setting) for model in sides[:2]]
        of_run = run.drive, found.completed, found.states[0], self.pieces(run)
        there, back = (system.outputs.of(settled_states(system, *of_run), run.drive) for system in systems)
        return 0.5 * sides[2] * (there - back)

    def directions(self, fitted: frame_fit.FittedFrame) -> Directions:
        """Find the directions of the frame's uncertainty that change its motion most, one standard deviation long."""
        frame = fitted.errors.frame
        own = covariance_root(fitted.covariance[frame, frame])
        noise, setting = fitted.errors.noise_at(fitted.p), self.setting
        run = max(fitted.errors.stretches, key=lambda each: float(np.mean(each.y**2)))
        part = strongest(run.y, frame_fit.PROBED_SAMPLES)
        system = fitted.errors.dynamics(fitted.p)
        # Starting at rest in the middle of the motion would give other directions.
        filtered = Filter.settled(system.seen_by(run.channels))
        start = filtered.predicted(run.excitation, run.seen, np.zeros(setting.states))[0][part.start]
        probed = run.excitation[part], run.y[part], start, [(slice(0, part.stop - part.start), run.channels)]

        def model_at(weights: Floats, size: float) -> DampedModel:
            p = fitted.p.copy()
            p[frame] += size * (own @ weights)
            return fitted.errors.model(p)

        def moved(system: state_space.Dynamics) -> Floats:
            return system.outputs.of(settled_states(system, *probed), run.excitation[part])

        centre = moved(system)
        scale = np.maximum(np.sqrt(np.mean(centre**2, axis=0)), 1e-300)
        near = (state_space.dynamics(model_at(row, DIFFERENCE), noise, setting) for row in np.eye(own.shape[1]))
        slopes = np.array([(moved(each) - centre) / (DIFFERENCE * scale) for each in near])
        flat = slopes.reshape(len(slopes), -1)
        strength, turned = np.linalg.eigh(flat @ flat.T)
        chosen = ranking.order(strength)[:MOST_DIRECTIONS]
        along = np.sum(np.tensordot(turned[:, chosen].T, slopes, axes=1) ** 2, axis=(0, 1))
        pairs = (either_side(partial(model_at, row)) for row in turned[:, chosen].T)
        sides = tuple((there, back, 1.0 / size) for there, back, size in pairs)
        return sides, np.sum(slopes**2, axis=(0, 1)) / np.maximum(along, 1e-300)


def _on_time(record: DrivenRecord, late: Floats, std: Floats) -> DrivenRecord:
    """Remove the delays of sensors, in samples, and report them."""
    said = [
        f"the clock of the sensor of floor {floor} is {abs(own):.3g} ms {'late' if own > 0 else 'early'} "
        f"(std {off:.2g} ms): the record contradicts the frame and its other sensors otherwise; taken out"
        for floor, own, off in zip(record.floors, 1e3 * record.step * late, 1e3 * record.step * std, strict=True)
        if abs(own) > NORMAL_95 * off
    ]
    moved = on_time(record, record.step * np.column_stack([late, np.zeros(len(late))]))
    return replace(moved, remarks=(*record.remarks, *said))


@dataclass(frozen=True)
class SensorCheck:
    """One sensor's acceleration, predicted from all other sensors.

    Parameters
    ----------
    error : float
        Root mean square over time of the prediction's error, m/s2.
    stated : float
        Root mean square of the stated standard deviation, with the sensor's own noise, m/s2.
    measured : float
        Root mean square of the measurement, m/s2.
    prediction_error : float
        Error of the model's prediction from the excitation alone.
    within : float
        Fraction of samples within 1.96 stated standard deviations.
    """

    floor: int
    error: float
    stated: float
    measured: float
    prediction_error: float
    within: float


def checked(
    work: FrameMotion, fitted: frame_fit.FittedFrame, smoothed: Sequence[Smoothed], channel: int,
    predicted: Sequence[state_space.Response],
) -> SensorCheck:  # fmt: skip
    """Predict one sensor from the others in the strongest part of each run, with a fit without this sensor.

    Parameters
    ----------
    fitted : FittedFrame
        Fit with all sensors.
    smoothed : sequence of Smoothed
        Motion with all sensors.
    predicted : sequence of Response
        Motion predicted from the excitation alone.
    """
    others = np.arange(len(work.recording.floors)) != channel
    parts = [strongest(each.completed, frame_fit.FITTED_SAMPLES) for each in smoothed]
    other = replace(work, recording=cut(work.recording, others, parts))
    stretches = [replace(each, channels=each.channels & others) for each in fitted.errors.stretches]
    stretches = [each for each in stretches if each.channels.any()]
    errors = PredictionErrors(work.varied, work.setting, stretches, work.noise)
    again = frame_fit.refitted(fitted, errors, work.frame.backend, free=work.free)
    place = int(work.recording.floors[channel]) - 1
    gain, sigma = fitted.model.gain[place], fitted.errors.noise_at(fitted.p).sensors[channel]
    rows = []
    runs = zip(other.runs(again, 1.0), work.recording.runs, smoothed, predicted, parts, strict=True)
    for found, run, own, motion, part in runs:
        seen, std = run.measured[part, channel], found.std["floor_acceleration"][:, place]
        moved, alone = found.response.acceleration[:, place], motion.acceleration[part, place]
        columns = np.column_stack([gain * moved - seen, (gain * std) ** 2 + sigma**2, seen, gain * alone - seen])
        rows.append(columns[own.weights[part, channel] == 1.0])
    error, variance, measured, alone = np.concatenate(rows).T
    std = np.sqrt(variance)
    within = np.count_nonzero(np.abs(error) <= NORMAL_95 * std) / max(len(std), 1)
    return SensorCheck(place + 1, rms(error), rms(std), rms(measured), rms(alone), within)


def widening(checks: Sequence[SensorCheck]) -> float:
    """Compute the factor on all bands: errors of left-out sensors relative to their stated deviations; at least 1."""
    return max(1.0, float(np.sqrt(np.mean([(each.error / each.stated) ** 2 for each in checks])))) if checks else 1.0
