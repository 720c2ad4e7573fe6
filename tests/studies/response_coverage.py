"""Measure the share of true peaks within the stated deviations of predictions.

`python -m tests.studies response_coverage [TRIALS [JOBS]]` prints the table.

Frames with story dashpots are identified from simulated noisy modes. The models predict peaks under a base motion.
The table has the share of 95 % intervals that contain the true peak, by assumed kind of damping. One trial also gives
the ratio of linearized to sampled deviations.
"""

from __future__ import annotations

import sys
import warnings
from functools import partial

import numpy as np

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.records.motion import DrivenRun
from cvxshear.response import DampedModel, Fitted, response
from cvxshear.response.predicted import peaks_of
from cvxshear.response.uncertain import UncertainFrame, propagated
from cvxshear.util.parallel import each
from tests.response.common import damped_frame, declared, matrices, pole_ratios, sampled, shaking

STORIES = (3, 8, 20)
KINDS = ("modal", "story")
STEP = 0.01
QUANTITIES = ("floor_acceleration", "story_drift", "base_shear")
NORMAL_95 = 1.959964


def uncertain(stories, kind, seed):
    """Return a frame identified from noisy modes."""
    mass, stiffness, dashpots = damped_frame(stories)
    ratios = pole_ratios(*matrices(mass, stiffness, dashpots))
    rng = np.random.default_rng([stories, seed])
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, ratios, rng=rng))
    solver = backends.get("auto")
    fitted = Fitted.of(efficient(experiment, solver))
    return UncertainFrame.of(fitted, experiment.configurations[0], kind, solver)


def peaks(damped, drive):
    found = peaks_of([(response(damped.model, drive, STEP), {})]).values
    return {"peaks": np.concatenate([found[name] for name in QUANTITIES])}


def true_peaks(stories, drive):
    M, C, K = matrices(*damped_frame(stories))
    model = DampedModel(M, C, K, np.ones(stories))
    found = peaks_of([(response(model, drive, STEP), {})]).values
    return np.concatenate([found[name] for name in QUANTITIES])


def deviation(seed, stories, kind):
    """Return errors of the predicted peaks in stated standard deviations."""
    drive = DrivenRun(shaking(1000, STEP))
    frame = uncertain(stories, kind, seed)
    std = propagated(frame, partial(peaks, drive=drive))
    return (peaks(frame.centre, drive)["peaks"] - true_peaks(stories, drive)) / std["peaks"]


def coverage(stories, kind, trials, jobs=1):
    """Return the share of 95 % intervals with the true peak, and the errors in stated deviations, trials by peaks."""
    deviations = np.array(each(partial(deviation, stories=stories, kind=kind), range(trials), jobs=jobs))
    return float(np.mean(np.abs(deviations) <= NORMAL_95)), deviations


def linear_over_sampled(stories, kind, samples=400):
    """Return the ratio of stated to sampled deviations, one per peak."""
    function = partial(peaks, drive=DrivenRun(shaking(1000, STEP)))
    frame = uncertain(stories, kind, 0)
    std = propagated(frame, function)
    drawn = sampled(frame, lambda damped: function(damped)["peaks"], samples, np.random.default_rng(1))
    return std["peaks"] / drawn.std(axis=0)


def main(trials=500, jobs=1):
    print(f"{trials} trials a row; frequencies within 0.2 %, shapes 1 %, damping ratios 10 %")
    print("stories  damping  within 95 %   mean deviation   linear / sampled")
    for stories in STORIES:
        for kind in KINDS:
            share, deviations = coverage(stories, kind, trials, jobs)
            ratio = linear_over_sampled(stories, kind)
            print(
                f"{stories:7d}  {kind:7s}  {100 * share:8.1f} %     {deviations.mean():+.2f}"
                f"             {ratio.min():.2f} to {ratio.max():.2f}",
                flush=True,
            )


if __name__ == "__main__":
    warnings.simplefilter("error")
    main(*(int(word) for word in sys.argv[1:]))
