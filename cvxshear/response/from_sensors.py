"""Reconstruction: how every floor moved, from the floors that carry sensors.

First the frame as it was in this record is found from the innovations of the filter (`frame_fit`), then its motion by
the smoother (`smoother`), then how far both can be off (`frame_motion`). Each sensor is also predicted from all others,
which is the one check of the bands that nothing assumes (`sensor_checks`).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.response.fitted_frame import FittedFrame
from cvxshear.response.frame_fit import NONLINEAR
from cvxshear.response.frame_motion import FrameMotion, predicted_responses, readings_of, shown_by
from cvxshear.response.peaks import peaks_of
from cvxshear.response.recording import RecordingSource, recording_of
from cvxshear.response.sensor_checks import as_predicted, checked, whiteness, widening
from cvxshear.response.smoother import Smoothed
from cvxshear.response.sources import DRIVING, ModelSource, models_of, state_of, state_remarks
from cvxshear.response.uncertain import UncertainFrame

if TYPE_CHECKING:
    pass
from cvxshear.response.reconstruction import NAMED_CHANGE, ROUGH_DRIFT, Reconstruction, reading_remark, remarks_of


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
    models = models_of(source, solver)
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
            # The states of a long record are large, and found once more with their deviations.
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
    passed = None
    name = "story_drift_ratio"
    if experiment.limits is not None and name in peaks.values:
        ratio, std = peaks.values[name], np.maximum(peaks.std[name], 1e-300)
        passed = np.asarray(special.ndtr((ratio - experiment.limits.story_drift[:, None]) / std), dtype=np.float64)
        if nonlinear:
            # How far a story that yields went is not seen: that it stayed below a limit cannot be said, and that
            # another passed one only where the frame as it was identified would have passed it, too.
            alone = np.inf if predicted is None else peaks_of((each, {}) for each in predicted).values[name]
            sure = (passed >= NAMED_CHANGE) & (alone > experiment.limits.story_drift[:, None])
            passed = np.where(sure, passed, np.nan)
    found = Reconstruction(
        work.recording, state, solver.name, frame.fitted, frame.kind, fitted, work.free, fitted.model, tuple(runs),
        peaks,
        None if predicted is None else peaks_of((item, {}) for item in predicted), tuple(checks),
        whiteness(work, smoothed), experiment.limits, passed, (),
    )  # fmt: skip
    advance()
    said = state_remarks(experiment, recording, state, named=configuration is not None)
    if len(evidences) > 1:
        said.append(reading_remark(DRIVING[recording.input], *evidences, told=found.sound))
    return dataclasses.replace(found, remarks=(*said, *remarks_of(found, recorded)))


_Fit = tuple[FrameMotion, FittedFrame, list[Smoothed]]
"""The motion as it was set up, the frame, and its motion without its states but the first."""


def _most_probable(fits: Iterator[_Fit]) -> tuple[_Fit, list[float]]:
    """Return the most probable fit, and the log evidence of each; long records fill the memory, so one is kept."""
    best = next(fits)
    evidences = [best[1].log_evidence]
    for other in fits:
        evidences.append(other[1].log_evidence)
        if evidences[-1] > best[1].log_evidence:
            best = other
    return best, evidences
