"""Checks of a reconstruction: prediction of each sensor from all others, and whiteness of the innovations."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.records.motion import trend
from cvxshear.response.compare import contradiction, moved_against
from cvxshear.response.damping import DampedModel
from cvxshear.response.frame_fit import FITTED_SAMPLES, FittedFrame, refitted
from cvxshear.response.frame_motion import FrameMotion, predicted_responses, shown_by
from cvxshear.response.innovations import PredictionErrors, Segment
from cvxshear.response.recording import Recording, earlier, rms
from cvxshear.response.state_space import Response, Smoothed
from cvxshear.util.quantities import NORMAL_95
from cvxshear.util.typing import Floats

CHECKED_DIRECTIONS = 4
"""Number of directions propagated to a floor without its sensor."""


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
    prediction_error : float or None
        Error of the model's prediction from the excitation alone; None if the excitation was not measured.
    within : float
        Fraction of samples within 1.96 stated standard deviations.
    """

    floor: int
    error: float
    stated: float
    measured: float
    prediction_error: float | None
    within: float


def as_predicted(model: DampedModel, recording: Recording) -> Recording:
    """Return a recording corrected by the prediction of the identified model.

    A channel is inverted if it alone moves opposite to its prediction. A removed delay is restored if the sensor was
    nearer to its prediction with the delay: dampers shift phases as clocks do, and the model includes dampers. Other
    contradictions are added to the remarks.
    """
    responses = predicted_responses(model, recording)
    if responses is None:
        return recording
    shown = shown_by(model, responses, recording)
    recording = _with_delays(recording, shown)
    measured = [run.measured - trend(run.measured) for run in recording.runs]
    predicted = [
        np.where(np.isfinite(values), own - trend(own), 0.0) for values, own in zip(measured, shown, strict=True)
    ]
    measured = [np.nan_to_num(values) for values in measured]
    against = moved_against(measured, predicted)
    signs = np.where(against, -1.0, 1.0)
    said = [
        f"the sensor of floor {floor} is reversed: it moves against the prediction, where all others move with it; "
        "turned round, check its sign in the record file"
        for floor in recording.floors[against]
    ]
    contradicted = contradiction([signs * values for values in measured], predicted, recording.floors)
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


def checked(
    work: FrameMotion, fitted: FittedFrame, smoothed: Sequence[Smoothed], channel: int,
    predicted: Sequence[Response] | None,
) -> SensorCheck:  # fmt: skip
    """Predict one sensor from the others in the strongest part of each run, with a fit without this sensor.

    Parameters
    ----------
    fitted : FittedFrame
        Fit with all sensors.
    smoothed : sequence of Smoothed
        Motion with all sensors.
    predicted : sequence of Response or None
        Motion predicted from the excitation alone.
    """
    every = np.ones(len(work.recording.floors), dtype=bool)
    whole = [Segment(run.drive, each.completed, every, each.states[0])
             for run, each in zip(work.recording.runs, smoothed, strict=True)]  # fmt: skip
    parts = [each.strongest(FITTED_SAMPLES) for each in whole]
    other = work.without(channel, parts)
    others = np.arange(len(every)) != channel
    stretches = [
        dataclasses.replace(each, y=each.y[:, others], channels=each.channels[others])
        for each in fitted.errors.stretches if each.channels[others].any()
    ]  # fmt: skip
    errors = PredictionErrors(work.varied, other.setting, stretches, other.noise)
    at = fitted.errors.frame.stop + channel
    again = refitted(fitted, errors, at, work.backend, free=work.free)
    directions, noise = other.directions(again, CHECKED_DIRECTIONS), errors.noise_at(again.p)
    outputs = errors.dynamics(again.p).outputs
    place = int(work.recording.floors[channel]) - 1
    gain = float(fitted.model.gain[place])
    row, direct = gain * outputs.rows[place], gain * outputs.direct[place]
    sigma = fitted.errors.noise_at(fitted.p).sensors[channel]
    left, stated, measured, alone = [], [], [], []
    found = other.smoothed(errors, again.p, row[None, :])
    for number, (run, each, part) in enumerate(zip(other.recording.runs, found, parts, strict=True)):
        variance = each.output_std[:, 0] ** 2 + sigma**2
        for sides in directions.sides:
            moved = other.moved_by(sides, noise, run, each)[:, place]
            variance += directions.allowance[place] * (gain * moved) ** 2
        there = smoothed[number].weights[part, channel] == 1.0
        seen = work.recording.runs[number].measured[part, channel]
        left.append((each.states @ row + direct * run.excitation - seen)[there])
        stated.append(variance[there])
        measured.append(seen[there])
        if predicted is not None:
            alone.append((gain * predicted[number].acceleration[part, place] - seen)[there])
    error, variances = np.concatenate(left), np.concatenate(stated)
    return SensorCheck(
        place + 1, rms(error), float(np.sqrt(np.mean(variances))), rms(np.concatenate(measured)),
        rms(np.concatenate(alone)) if alone else None,
        float(np.mean(np.abs(error) <= NORMAL_95 * np.sqrt(variances))),
    )  # fmt: skip


def widening(checks: Sequence[SensorCheck]) -> float:
    """Compute the factor on all bands: errors of left-out sensors relative to their stated deviations; at least 1."""
    return max(1.0, float(np.sqrt(np.mean([(each.error / each.stated) ** 2 for each in checks])))) if checks else 1.0
