"""Prediction: the response of an identified frame to a record and its peaks, compared with the measured motion."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.effects import LocatedEffect
from cvxshear.measurement.experiment import Configuration, Limits
from cvxshear.records.motion import DrivenRecord
from cvxshear.response import sources, uncertain
from cvxshear.response.compare import RecordComparison, as_predicted, compared, predicted_responses, without_drift
from cvxshear.response.recording import RecordSource, recording_of
from cvxshear.response.state_space import Response
from cvxshear.util import ranking
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.quantities import listed, numbered, percent
from cvxshear.util.results import Shown, as_json
from cvxshear.util.typing import Floats, Ints, Json

#: Quantities with standard deviations over time. Records show accelerations; owners need drifts.
BANDS = ("floor_acceleration", "story_drift", "story_drift_ratio")


@dataclass(frozen=True)
class Quantity:
    """A quantity of a response.

    Parameters
    ----------
    attribute : str
        Attribute of `Response` with the values over time.
    word, unit : str
        Name and unit; the unit of a ratio is empty.
    single : bool, optional
        Whether the quantity is one number, not one per floor or story.
    """

    attribute: str
    word: str
    unit: str
    single: bool = False


#: Quantities of a response.
RESPONSES = {
    "floor_acceleration": Quantity("acceleration", "acceleration", "m/s²"),
    "floor_displacement": Quantity("displacement", "displacement", "m"),
    "story_drift": Quantity("drift", "drift", "m"),
    "story_drift_ratio": Quantity("drift_ratio", "drift ratio", ""),
    "story_shear": Quantity("story_shear", "shear", "N"),
    "base_shear": Quantity("base_shear", "base shear", "N", single=True),
    "overturning_moment": Quantity("overturning_moment", "overturning moment", "N m", single=True),
}


def histories(response: Response) -> dict[str, Floats | None]:
    """Return every quantity over time, shapes (samples, N) or (samples,); None for quantities that do not apply."""
    return {name: getattr(response, quantity.attribute) for name, quantity in RESPONSES.items()}


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks with standard deviations.

    Parameters
    ----------
    values, std : dict of str to ndarray
        Keys are the names in `RESPONSES` that apply; shape (N,) or (1,); nan for unknown deviations.
    """

    values: dict[str, Floats]
    std: dict[str, Floats]

    def to_dict(self) -> Json:
        """Return each quantity and its `_std` as JSON; null for quantities that do not apply."""
        result: Json = {}
        for name, quantity in RESPONSES.items():
            for key, values in ((name, self.values.get(name)), (f"{name}_std", self.std.get(name))):
                result[key] = as_json(values[0] if quantity.single and values is not None else values)
        return result


def limits_passed(limits: Limits | None, peaks: Peaks) -> Floats | None:
    """Return the probability that the drift ratio of each story passed each limit, shape (L, N).

    It is nan for unknown deviations; the result is None without limits or story heights.
    """
    name = "story_drift_ratio"
    if limits is None or name not in peaks.values:
        return None
    away = peaks.values[name] - limits.story_drift[:, None]
    return np.asarray(special.ndtr(away / np.maximum(peaks.std[name], 1e-300)))


def limits_in_json(limits: Limits | None, passed: Floats | None, stories: int) -> list[Json] | None:
    """Return each limit with its probability in each story, null for unknown ones; None without limits."""
    if limits is None:
        return None
    chances = np.full((len(limits.names), stories), np.nan) if passed is None else passed
    rows = zip(limits.names, limits.story_drift, chances, strict=True)
    return [{"name": name, "story_drift": drift, "probability": each} for name, drift, each in rows]


#: Least size of a sample in the strong part of a motion, relative to the peak.
STRONG = 0.5


def peaks_of(runs: Iterable[tuple[Response, Mapping[str, Floats]]]) -> Peaks:
    """Find the peak of each quantity that applies, and its standard deviation.

    A peak is the top of the parabola through the largest sample and its neighbors. For a motion of 3 Hz at 50 Hz, the
    largest sample is up to 1.8 % too small, the parabola 0.05 %.

    The deviation of a peak is the deviation of its sample. Its ratio to the peak is at least the ratio of the rms
    deviation to the rms motion in the strong part. The reason: the change along one direction of the frame's
    uncertainty oscillates as the motion does. If this change is zero at the peak, the deviation of that sample lacks
    terms of second order and the errors of the model.

    Parameters
    ----------
    runs : iterable of (Response, dict of str to ndarray)
        Response and known standard deviations over time of each run, by the names in `RESPONSES`.
    """
    values: dict[str, Floats] = {}
    stds: dict[str, Floats] = {}
    for moved, deviations in runs:
        for name, history in histories(moved).items():
            if history is None:
                continue
            columns = history.reshape(len(history), -1)
            at = ranking.largest(np.abs(columns), axis=0)
            take = np.arange(columns.shape[1])
            peak = _between_samples(np.abs(columns), at)
            std = np.full(len(peak), np.nan)
            if name in deviations:
                band, strong = deviations[name].reshape(columns.shape), np.abs(columns) >= STRONG * peak
                of_motion = np.sum(band**2 * strong, axis=0) / np.maximum(np.sum(columns**2 * strong, axis=0), 1e-300)
                std = np.maximum(band[at, take], peak * np.sqrt(of_motion))
            if name in values:
                larger = peak > values[name]
                peak, std = np.where(larger, peak, values[name]), np.where(larger, std, stds[name])
            values[name], stds[name] = peak, std
    return Peaks(values, stds)


def _between_samples(sizes: Floats, at: Ints) -> Floats:
    """Find the top of the parabola through the largest sample of each column and its neighbors, shape (columns,)."""
    take = np.arange(sizes.shape[1])
    before, top, after = (sizes[np.clip(at + step, 0, len(sizes) - 1), take] for step in (-1, 0, 1))
    bend = 2 * top - before - after
    # A parabola fits neither a jump nor a motion with fewer than six samples per period.
    inside = (at > 0) & (at < len(sizes) - 1)
    smooth = inside & (bend > 0) & (np.minimum(before, after) > STRONG * top)
    rise: Floats = (after - before) ** 2 / (8 * np.where(smooth, bend, 1.0))
    return top + np.where(smooth, rise, 0.0)


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

    fitted: sources.Fitted
    damped: uncertain.Damped
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
    damping: uncertain.IdentifiedDamping
    std: tuple[dict[str, Floats], ...]
    missed: float | None
    remarks: tuple[str, ...]

    json_keys = (
        "experiment=after.fitted.experiment.name record=motion.name input=motion.input "
        "configuration=configuration.name backend effects=after.fitted.effects "
        "frequencies=after.damped.model.modes.frequencies before=before.comparison after=after.comparison "
        "peaks limits=limits_said damping remarks"
    )

    @property
    def limits(self) -> Limits | None:
        """The declared limits of drift ratios."""
        return self.after.fitted.experiment.limits

    @property
    def passed(self) -> Floats | None:
        """Probability that the drift ratio of each story passes each limit, shape (L, N); nan if unknown."""
        return limits_passed(self.limits, self.peaks)

    @property
    def limits_said(self) -> list[Json] | None:
        """The limits with their probabilities, as in the JSON; None without limits."""
        return limits_in_json(self.limits, self.passed, len(self.after.damped.model.M))

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
    source: sources.ModelSource,
    record: RecordSource,
    backend: str | backends.Backend = "auto",
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
    models, frame, recorded = set_up(source, record, backend, damping, configuration, assume)
    motion = without_drift(frame.centre.model, recorded) if detrend else recorded
    before = None
    if models.before is not None:
        other = replace(frame, fitted=models.before)
        before = _model_response(models.before, other.centre, motion)
    found = _predicted(models, frame, motion, before)
    named = configuration is not None
    said = sources.assumptions(models.after, frame.configuration, recorded, motion, found.passed, named=named)
    return replace(found, remarks=(*recorded.remarks, *said, *found.remarks))


def set_up(
    source: sources.ModelSource,
    record: RecordSource,
    backend: str | backends.Backend,
    damping: str | None,
    configuration: str | None,
    assume: Sequence[str | LocatedEffect],
) -> tuple[sources.Models, uncertain.UncertainFrame, DrivenRecord]:
    """Return the models, the final one in the state of the record, and the record with corrected sensors."""
    solver = backends.get(backend)
    models = sources.models_of(source, solver, assume)
    recorded = recording_of(record, models.after.experiment.stories)
    state = sources.state_of(models.after.experiment, recorded, configuration)
    frame = uncertain.UncertainFrame.of(models.after, state, damping, solver)
    return models, frame, as_predicted(frame.centre.model, recorded)


def _predicted(
    models: sources.Models, frame: uncertain.UncertainFrame, motion: DrivenRecord, before: ModelResponse | None
) -> RecordPrediction:
    """Predict with the final model; one propagation gives all standard deviations."""

    def everything(damped: uncertain.Damped, driven: DrivenRecord = motion) -> dict[str, Floats]:
        responses = predicted_responses(damped.model, driven)
        bands = {
            f"{name} over time {run}": values
            for run, moved in enumerate(responses)
            for name, values in histories(moved).items()
            if name in BANDS and values is not None
        }
        return uncertain.parts_of(damped) | _largest(responses) | bands | {"f": np.log(damped.model.modes.frequencies)}

    centre, std = frame.centre, uncertain.propagated(frame, everything)
    # The excitation between its samples is unknown: it may be linear or band-limited.
    straight, limited = everything(centre), everything(centre, motion.band_limited())
    std = {name: np.hypot(own, limited[name] - straight[name]) for name, own in std.items()}
    after = _model_response(models.after, centre, motion, std["f"])
    over_time = tuple(
        {name: std[f"{name} over time {run}"] for name in BANDS if f"{name} over time {run}" in std}
        for run in range(len(after.responses))
    )
    missed = _missed(after, over_time)
    values = _largest(after.responses)
    peaks = Peaks(values, {name: np.hypot(std[name], (missed or 0.0) * peak) for name, peak in values.items()})
    changes = (np.abs(limited[name] - peak) / np.maximum(peak, 1e-300) for name, peak in values.items())
    unseen = max(float(np.max(each)) for each in changes)
    damping = uncertain.described(frame, std)
    said = (*damping.remarks, *_reading_remarks(unseen, sources.DRIVING[motion.input]), *_remarks(after, motion))
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


def _largest(responses: Sequence[Response]) -> dict[str, Floats]:
    return peaks_of((each, {}) for each in responses).values


def _model_response(
    fitted: sources.Fitted, damped: uncertain.Damped, motion: DrivenRecord, frequency_std: Floats | None = None
) -> ModelResponse:
    responses = tuple(predicted_responses(damped.model, motion))
    tested = fitted.experiment.configurations
    modes = np.unique(np.concatenate([each.modes for each in tested]))
    return ModelResponse(fitted, damped, responses, compared(damped.model, responses, motion, modes, frequency_std))


def _reading_remarks(unseen: float, excitation: str) -> list[str]:
    """Report the influence of the excitation between its samples on the peaks, if it is large enough."""
    if unseen < sources.WORTH_A_WORD:
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
    if not motion.floors.size:
        said.append("the record has no accelerations of floors to compare with")
    gaps = np.any([~np.isfinite(each.measured).all(axis=0) for each in motion.runs], axis=0)
    if beside := motion.floors[gaps].tolist():
        said.append(f"samples of {numbered('floor', beside)} are missing: not compared here; reconstruct takes gaps")
    if after.comparison is not None and after.comparison.shifts:
        shifts = "; ".join(str(shift) for shift in after.comparison.shifts)
        said.append(
            f"{shifts}: frequencies and damping depend on the amplitude, or the frame has changed since its modes were "
            "measured. Errors in time (nrmse) are of two motions that fall out of step and say little else; compare "
            "rms, peaks and transfer functions"
        )
    return said
