"""Peaks of many frames at once are those of each by itself."""

import numpy as np
import pytest

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.model.shear import modes
from cvxshear.records.motion import Drive, Motion
from cvxshear.response import DampedModel, Fitted, batch_peaks, predict, predict_many, response, sample_peaks
from cvxshear.response.family import Family
from cvxshear.response.hold import held, held_at
from cvxshear.response.instants import possible_instants
from cvxshear.response.propagation import sampled
from cvxshear.response.uncertain import UncertainFrame, modal_matrix
from tests.response.common import damped_frame, declared, family, matrices, shaking

STEP = 0.01


def one_by_one(M, C, K, drive):
    found = [response(DampedModel(*abc, np.ones(M.shape[1])), drive, STEP) for abc in zip(M, C, K, strict=True)]
    return [np.array([np.abs(getattr(item, name)).max(axis=0) for item in found]) for name in ("acceleration", "drift")]


@pytest.mark.parametrize(
    ("stories", "spread"),
    [(1, 0.01), (2, 0.01), (6, 0.0), (6, 0.001), (6, 0.01), (6, 0.02), (6, 0.05), (6, 0.3), (20, 0.005)],
)
def test_peaks_of_many_are_those_of_each(stories, spread):
    matrices_of_all, drive = family(70, stories, spread), Drive(shaking(1500, STEP))
    for found, expected in zip(
        batch_peaks(*matrices_of_all, drive, STEP), one_by_one(*matrices_of_all, drive), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_peaks_where_nothing_dies_away(seed):
    """Under stationary noise many samples come near the largest; damping ratios scatter by a fifth."""
    excitation = np.random.default_rng(seed).standard_normal(2500)
    matrices_of_all, drive = family(60, 5, 0.02, seed), Drive(excitation)
    for found, expected in zip(
        batch_peaks(*matrices_of_all, drive, STEP), one_by_one(*matrices_of_all, drive), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_frames_with_coupled_masses():
    M, C, K = family(5, 3, 0.01)
    M = M + 0.2 * (np.eye(3, k=1) + np.eye(3, k=-1))
    C = np.array([modal_matrix(m, modes(m, k), np.array([0.01, 0.02, 0.03])) for m, k in zip(M, K, strict=True)])
    drive = Drive(shaking(800, STEP))
    for found, expected in zip(batch_peaks(M, C, K, drive, STEP), one_by_one(M, C, K, drive), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_response_at_a_few_samples_is_that_of_the_whole():
    s, p = np.array([-0.3 + 12j, -4.0 + 0j, -1e-4 + 1e-3j]), np.random.default_rng(3).standard_normal(400)
    instants = np.array([0, 1, 31, 32, 33, 64, 200, 399])
    np.testing.assert_allclose(held_at(s, p, STEP, instants), held(s, p, STEP)[:, instants].T, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("spread", [0.001, 0.02])
def test_few_samples_can_hold_a_peak(spread):
    """Those of all frames are among them, and hardly more."""
    M, C, K = family(200, 6, spread)
    found = Family.of(M, C, K)
    excitation = shaking(1500, STEP)
    instants = possible_instants(found, excitation, STEP)
    peaks = np.array(
        [
            np.argmax(np.abs(np.hstack([item.acceleration, item.drift])), axis=0)
            for item in (
                response(DampedModel(*abc, np.ones(6)), Drive(excitation), STEP) for abc in zip(M, C, K, strict=True)
            )
        ]
    )
    for own, of_frames in zip(instants, peaks.T, strict=True):
        assert set(of_frames) <= set(own)
    assert sum(map(len, instants)) < 0.03 * 12 * 1500


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

    np.testing.assert_allclose(found, sampled(frame, peaks, 20, np.random.default_rng(2)), rtol=1e-9)


def test_many_records():
    mass, stiffness, _ = damped_frame(3)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02, 0.02, 0.02]))
    estimate = efficient(experiment, backends.get("auto"))
    motions = [Motion((Drive(shaking(300, STEP, seed)),), 1 / STEP, name=f"record {seed}") for seed in (1, 2)]
    found = predict_many(estimate, motions)
    assert [item.motion.name for item in found] == ["record 1", "record 2"]
    assert found[1].to_dict() == predict(estimate, motions[1]).to_dict()
