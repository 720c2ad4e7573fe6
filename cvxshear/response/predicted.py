"""Prediction: the response of an identified frame to a record, compared with the measured motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.measurement.experiment import Configuration
from cvxshear.records.motion import DrivenRecord
from cvxshear.response.compare import LIKE, RecordComparison, compared, moved_alike, seen
from cvxshear.response.damping import DampedModel
from cvxshear.response.peaks import Peaks, histories, peaks_of
from cvxshear.response.recording import recording_of
from cvxshear.response.sensor_checks import as_predicted
from cvxshear.response.sources import (
    DRIVING,
    WORTH_A_WORD,
    Fitted,
    Models,
    ModelSource,
    MotionSource,
    line_remarks,
    models_of,
    motion_of,
    state_of,
    state_remarks,
)
from cvxshear.response.state_space import Response, response
from cvxshear.response.uncertain import Damped, IdentifiedDamping, UncertainFrame, described, parts_of, propagated
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.quantities import listed, numbered, percent
from cvxshear.util.results import Shown
from cvxshear.util.typing import Floats

BANDS = ("floor_acceleration", "story_drift", "story_drift_ratio")
"""Quantities with standard deviations over time. Records show accelerations; owners need drifts."""


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """One model's response to the record.

    Parameters
    ----------
    fitted : Fitted
    damped : Damped
    responses : tuple of Response
        One response per run of the record.
    comparison : RecordComparison or None
        None if the record has no accelerations of floors.
    """

    fitted: Fitted
    damped: Damped
    responses: tuple[Response, ...]
    comparison: RecordComparison | None


@dataclass(frozen=True, eq=False, repr=False)
class RecordPrediction(Shown):
    """The result of `predict`.

    Parameters
    ----------
    motion : DrivenRecord
        The record of the prediction, without the drift of its sensors.
    configuration : Configuration
        Configuration of the frame in the prediction.
    backend : str
    before : ModelResponse or None
        Response of the shear model; None if there is only one model.
    after : ModelResponse
        Response of the model with the effects that were found.
    peaks : Peaks
        Peaks of `after`; their deviations include `missed`.
    damping : IdentifiedDamping
        Damping of `after`.
    std : tuple of dict of str to ndarray
        Standard deviations over time of `after`, one dict per run, with the names in `BANDS`; nan if the noise is
        unknown. They include the uncertainty of the frame and of the excitation between its samples.
    missed : float or None
        Error of the predicted accelerations of the measured floors beyond these deviations, relative to the motion;
        None if the record has no accelerations to compare with.
    remarks : tuple of str
        Assumptions, and evidence against the model.
    """

    motion: DrivenRecord
    configuration: Configuration
    backend: str
    before: ModelResponse | None
    after: ModelResponse
    peaks: Peaks
    damping: IdentifiedDamping
    std: tuple[dict[str, Floats], ...]
    missed: float | None
    remarks: tuple[str, ...]

    json_keys = (
        "experiment=after.fitted.experiment.name record=motion.name input=motion.input "
        "configuration=configuration.name backend effects=after.fitted.effects "
        "frequencies=after.damped.model.modes.frequencies before=before.comparison after=after.comparison "
        "peaks damping remarks"
    )

    @property
    def otherwise_before(self) -> ModelResponse | None:
        """Prediction of the shear model if it differs from `after`; None if the loop added no effect."""
        if self.before is None:
            return None
        before, after = self.before.fitted, self.after.fitted
        # Without added effects, both models are the same estimate.
        same = not before.effects and not after.effects and np.array_equal(before.theta, after.theta)
        return None if same else self.before


@usual_arithmetic
def predict(
    source: ModelSource,
    record: MotionSource,
    backend: str | Backend = "auto",
    *,
    damping: str | None = None,
    configuration: str | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    detrend: bool = True,
) -> RecordPrediction:
    """Predict the response of every floor to a record, and compare it with the measured motion.

    Parameters
    ----------
    source : str, Path, Experiment, LoopResult, Estimate or Models
        Source of the model. A file is a measurement file or a record file. If the loop is not closed yet, it is closed
        here.
    record : str, Path, TimeRecord or DrivenRecord
        Excitation of the frame: a record file or a record, with base motion or a force.
    backend : str or Backend, optional
    damping : str, optional
        "modal", "story" or "rayleigh"; by default, the damping that the experiment declares.
    configuration : str, optional
        Configuration of the frame; by default, the one with the record's added mass.
    assume : sequence of str or LocatedEffect, optional
        Effects that are in the model from the start of a loop that is closed here.
    detrend : bool, optional
        Whether the straight line through each acceleration of the record is removed as a fault of the sensor.

    Returns
    -------
    RecordPrediction

    Raises
    ------
    InputError
        If the frame's damping or the excitation is unknown, or the record does not fit the frame.
    NoSolutionError
        If the backend does not solve a program.
    """
    solver = backends.get(backend)
    recorded = motion_of(record)
    models = models_of(source, solver, assume)
    experiment = models.after.experiment
    state = state_of(experiment, recorded, configuration)
    frame_after = UncertainFrame.of(models.after, state, damping, solver)
    recorded, faults = _set_right(recorded, frame_after.at(np.zeros(frame_after.size)).model)
    motion = recorded.detrended() if detrend else recorded
    before = None
    if models.before is not None:
        frame = UncertainFrame.of(models.before, state, damping, solver)
        before = _model_response(models.before, frame.at(np.zeros(frame.size)), motion)
    found = _predicted(models, frame_after, motion, before)
    said = [*state_remarks(experiment, recorded, state, named=configuration is not None), *_taken_off(recorded, motion)]
    # The comparison may repeat remarks that the model made on the sensors before.
    said += [each for each in found.remarks if each not in faults]
    return dataclasses.replace(found, remarks=(*faults, *said))


def _set_right(motion: DrivenRecord, model: DampedModel) -> tuple[DrivenRecord, tuple[str, ...]]:
    """Return a record with the corrections of its sensors that `reconstruct` makes, and remarks on these corrections.

    Return the record unchanged if a sensor to be left out moves as predicted: then the model contradicts the fault.
    """
    forces = {driven.floor for driven in motion.runs}
    known = all(driven.responses is not None and np.isfinite(driven.responses).any() for driven in motion.runs)
    if not motion.floors.size or not known or len(forces) > 1:
        return motion, ()
    found = as_predicted(model, recording_of(motion, len(model.M)))
    gone = np.setdiff1d(motion.floors, found.floors)
    gone = gone[gone <= len(model.M)]
    if gone.size:
        columns = np.searchsorted(motion.floors, gone)
        measured = np.concatenate([np.asarray(driven.responses)[:, columns] for driven in motion.runs])
        predicted = np.concatenate([seen(model, response(model, driven, motion.step), gone) for driven in motion.runs])
        if np.any(moved_alike(np.nan_to_num(measured), predicted) > LIKE):
            return motion, ()
    runs = tuple(
        dataclasses.replace(driven, excitation=run.excitation, responses=run.measured)
        for driven, run in zip(motion.runs, found.runs, strict=True)
    )
    return dataclasses.replace(motion, runs=runs, floors=found.floors), found.remarks


def _predicted(
    models: Models, frame: UncertainFrame, motion: DrivenRecord, before: ModelResponse | None
) -> RecordPrediction:
    """Predict with the final model; one propagation gives all standard deviations."""

    def everything(damped: Damped, driven: DrivenRecord = motion) -> Floats:
        responses = _responses(damped, driven)
        bands = (item for moved in responses for item in _bands(moved).values())
        return np.concatenate([parts_of(damped), *_largest(responses).values(), *bands])

    centre, std = propagated(frame, everything)
    # The excitation between its samples is unknown: it may be linear or band-limited.
    between = everything(centre, motion.band_limited()) - everything(centre)
    std = np.hypot(std, between)
    after = _model_response(models.after, centre, motion)
    values = _largest(after.responses)
    sizes = [len(parts_of(centre)), *(len(item) for item in values.values())]
    sizes += [item.size for moved in after.responses for item in _bands(moved).values()]
    parts = np.cumsum(sizes)[:-1]
    of_damping, *rest = np.split(std, parts)
    of_samples = zip(values.values(), np.split(between, parts)[1:], strict=False)
    unseen = max(float(np.max(np.abs(change) / np.maximum(peak, 1e-300))) for peak, change in of_samples)
    bands = iter(rest[len(values) :])
    damping = described(frame, centre, of_damping)
    over_time = tuple(
        {name: next(bands).reshape(moved.acceleration.shape) for name in _bands(moved)} for moved in after.responses
    )
    missed = _missed(after, over_time)
    of_peaks = zip(values.items(), rest, strict=False)
    peaks = Peaks(values, {name: np.hypot(own, (missed or 0.0) * peak) for (name, peak), own in of_peaks})
    said = (*damping.remarks, *_between_samples(unseen, DRIVING[motion.input]), *_remarks(after, motion))
    return RecordPrediction(
        motion, frame.configuration, frame.backend.name, before, after, peaks, damping, over_time, missed, said
    )


def _missed(side: ModelResponse, std: tuple[dict[str, Floats], ...]) -> float | None:
    """Compute the error of the prediction beyond the stated deviations, relative to the size of the motion.

    The error is the root mean square over time and the measured floors. The error includes the noise of the measured
    excitation, its motion between the samples, the model's error, and the noise of the floors' sensors. If two motions
    fall out of step, their errors in time are larger than the errors of their peaks. The peaks of a few floors would
    therefore give too small an error.
    """
    beside = side.comparison
    if beside is None:
        return None
    places = beside.floors - 1
    band = np.concatenate([each["floor_acceleration"][:, places] for each in std]) * side.damped.model.gain[places]
    moved = np.concatenate([each.acceleration[:, places] for each in side.responses]) * side.damped.model.gain[places]
    with np.errstate(divide="ignore", invalid="ignore"):
        stated = beside.rms_ratio * np.sqrt(np.mean(band**2, axis=0) / np.mean(moved**2, axis=0))
        # Relative to the larger motion: if one motion is a tenth of the other, the error is at most 100 %.
        beyond = (beside.nrmse**2 - np.nan_to_num(stated) ** 2) / np.maximum(1.0, beside.rms_ratio) ** 2
    beyond = beyond[np.isfinite(beyond)]
    return float(np.sqrt(max(0.0, np.mean(beyond)))) if beyond.size else None


def _bands(moved: Response) -> dict[str, Floats]:
    """Return the quantities of `BANDS` that apply, as flat arrays."""
    found = histories(moved)
    return {name: values.ravel() for name in BANDS if (values := found[name]) is not None}


def _largest(responses: Sequence[Response]) -> dict[str, Floats]:
    return peaks_of((each, {}) for each in responses).values


def _responses(damped: Damped, motion: DrivenRecord) -> list[Response]:
    return [response(damped.model, driven, motion.step) for driven in motion.runs]


def _model_response(fitted: Fitted, damped: Damped, motion: DrivenRecord) -> ModelResponse:
    responses = tuple(_responses(damped, motion))
    tested = fitted.experiment.configurations
    modes = np.unique(np.concatenate([each.modes for each in tested]))
    return ModelResponse(fitted, damped, responses, compared(damped.model, responses, motion, modes))


def _taken_off(recorded: DrivenRecord, motion: DrivenRecord) -> list[str]:
    """Report the size of the straight lines that were removed as sensor faults, if they are large enough."""
    found = [(0.0, "")]
    for before, after in zip(recorded.runs, motion.runs, strict=True):
        columns = [("the base motion", before.excitation, after.excitation)] if recorded.input == "base" else []
        if before.responses is not None and after.responses is not None:
            columns += [
                (f"floor {floor}", before.responses[:, place], after.responses[:, place])
                for place, floor in enumerate(recorded.floors)
            ]
        for name, old, new in columns:
            line, rms = float(np.nanmax(np.abs(old - new))), float(np.sqrt(np.nanmean(new**2)))
            if rms > 0:
                found.append((line / rms, name))
    largest, where = max(found)
    return line_remarks(largest, f"the rms ({where})")


def _between_samples(unseen: float, excitation: str) -> list[str]:
    """Report the influence of the excitation between its samples on the peaks, if it is large enough."""
    if unseen < WORTH_A_WORD:
        return []
    return [
        f"between its samples the {excitation} is taken as straight lines; were it band-limited, peaks would be up to "
        f"{percent(unseen, 1)} larger, which the deviations include: a record at a higher rate tells"
    ]


def _remarks(after: ModelResponse, motion: DrivenRecord) -> list[str]:
    """Collect remarks that the reader needs besides the numbers."""
    said = []
    if after.fitted.undetermined:
        names = "; ".join(listed(names) for names in after.fitted.undetermined)
        said.append(f"not determined by the measurement: {names}; the deviations do not include that")
    if after.comparison is not None and after.comparison.contradiction:
        said.append(after.comparison.contradiction)
    if after.fitted.covariance is None:
        said.append("no standard deviations: the measurement declares no noise and has no data left to estimate it by")
    if not after.fitted.mass_known:
        said.append("the masses have no scale (give total_mass): forces and moments are left out")
    if not motion.floors.size:
        said.append("the record has no accelerations of floors to compare with")
    recorded = [each.responses for each in motion.runs if each.responses is not None]
    gaps = [~np.isfinite(each).all(axis=0) for each in recorded]
    if gaps and (beside := motion.floors[np.any(gaps, axis=0)].tolist()):
        said.append(f"samples of {numbered('floor', beside)} are missing: not compared here; reconstruct takes gaps")
    if after.comparison is not None and after.comparison.shifts:
        shifts = "; ".join(str(shift) for shift in after.comparison.shifts)
        said.append(
            f"{shifts}: frequencies and damping depend on the amplitude, or the frame has changed since its modes were "
            "measured. Errors in time (nrmse) are of two motions that fall out of step and say little else; compare "
            "rms, peaks and transfer functions"
        )
    return said
