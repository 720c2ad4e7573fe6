"""Peaks of many frames at once are those of each by itself."""

import numpy as np
import pytest

import cvxshear
from cvxshear import backends
from cvxshear.identification.efficient import efficient
from cvxshear.modal.motion import Drive, Motion
from cvxshear.response import DampedModel, Fitted, batch_peaks, predict, predict_many, response, sample_peaks
from cvxshear.response.propagation import sampled
from cvxshear.response.uncertain import UncertainFrame
from tests.response.common import damped_frame, declared, family, matrices, shaking

STEP = 0.01


def one_by_one(M, C, K, drive):
    found = [response(DampedModel(*abc, np.ones(M.shape[1])), drive, STEP) for abc in zip(M, C, K, strict=True)]
    return [np.array([np.abs(getattr(item, name)).max(axis=0) for item in found]) for name in ("acceleration", "drift")]


@pytest.mark.parametrize(
    ("stories", "spread"),
    [(2, 0.01), (6, 0.001), (6, 0.01), (6, 0.3)],
    ids=["two stories", "alike", "scattered", "too far apart for one polynomial"],
)
def test_peaks_of_many_are_those_of_each(stories, spread):
    matrices_of_all, drive = family(70, stories, spread), Drive(shaking(1500, STEP))
    for found, expected in zip(
        batch_peaks(*matrices_of_all, drive, STEP), one_by_one(*matrices_of_all, drive), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_frames_whose_modes_couple_are_taken_one_by_one():
    M, C, K = (np.array([each, each]) for each in matrices(*damped_frame(3)))
    drive = Drive(shaking(300, STEP))
    np.testing.assert_allclose(batch_peaks(M, C, K, drive, STEP)[0], one_by_one(M, C, K, drive)[0])


def test_samples_of_an_uncertain_frame():
    mass, stiffness, _ = damped_frame(3)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02, 0.02, 0.02]))
    solver = backends.get("auto")
    fitted = Fitted.of(efficient(experiment, solver))
    frame = UncertainFrame.of(fitted, experiment.configurations[0], "modal", solver)
    drive = Drive(shaking(600, STEP))
    found, _ = sample_peaks(frame, drive, STEP, 20, np.random.default_rng(2))

    def peaks(damped):
        return np.abs(response(damped.model, drive, STEP).acceleration).max(axis=0)

    np.testing.assert_allclose(found, sampled(frame, peaks, 20, np.random.default_rng(2)), rtol=1e-5)


def test_many_records():
    mass, stiffness, _ = damped_frame(3)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02, 0.02, 0.02]))
    estimate = efficient(experiment, backends.get("auto"))
    motions = [Motion((Drive(shaking(300, STEP, seed)),), 1 / STEP, name=f"record {seed}") for seed in (1, 2)]
    found = predict_many(estimate, motions)
    assert [item.motion.name for item in found] == ["record 1", "record 2"]
    assert found[1].to_dict() == predict(estimate, motions[1]).to_dict()
