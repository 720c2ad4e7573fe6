"""Test the motion of damped frames against an ODE solver, closed forms and scipy's state-space simulation."""

import numpy as np
import pytest

from cvxshear.records.motion import band_limited
from cvxshear.response import DampedModel, DrivenRecord, DrivenRun, Response, response
from cvxshear.response.predicted import peaks_of
from cvxshear.response.recording import recording_of
from cvxshear.util.errors import InputError
from tests.response.common import damped_frame, integrated, matrices, shaking

STEP = 0.01


def model_of(stories, **options):
    return DampedModel(*matrices(*damped_frame(stories, **options)), np.ones(stories), np.full(stories, 3.0))


@pytest.mark.parametrize(("stories", "ratio"), [(3, 0.08), (3, 3.0), (8, 0.08), (20, 0.08)])
@pytest.mark.parametrize("floor", [0, 2])
def test_response_equals_an_independent_integration(stories, ratio, floor):
    """Dashpots of a ratio of 3 overdamp the upper modes."""
    of, excitation = model_of(stories, ratio=ratio), shaking(120, STEP)
    total, moved = integrated(of.M, of.C, of.K, excitation, STEP, floor)
    found = response(of, DrivenRun(excitation, floor), STEP)
    np.testing.assert_allclose(found.acceleration, total, atol=1e-8 * np.abs(total).max())
    np.testing.assert_allclose(found.displacement, moved, atol=1e-8 * np.abs(moved).max())


def test_one_mass_under_a_ramp():
    """An undamped oscillator under a force p t moves by u = p / k (t - sin(omega t) / omega)."""
    of = DampedModel(np.array([[2.0]]), np.zeros((1, 1)), np.array([[50.0]]), np.ones(1))
    time = 0.05 * np.arange(200)
    found = response(of, DrivenRun(3.0 * time, floor=1), 0.05)
    np.testing.assert_allclose(found.displacement[:, 0], 3.0 / 50 * (time - np.sin(5 * time) / 5), atol=1e-12)
    np.testing.assert_allclose(found.acceleration[:, 0], 3.0 / 2 * np.sin(5 * time) / 5, atol=1e-11)


@pytest.mark.parametrize("floor", [0, 1])
def test_samples_of_a_band_limited_motion_move_an_oscillator_as_its_harmonics_do(floor):
    """Compare with the steady state; linear interpolation would lose 1 - sinc(f h)^2 of each harmonic."""
    omega, ratio, time = 2 * np.pi * 12.0, 0.05, STEP * np.arange(4000)
    of = DampedModel(np.array([[1.0]]), np.array([[2 * ratio * omega]]), np.array([[omega**2]]), np.ones(1))
    expected, excitation = np.zeros(4000), np.zeros(4000)
    for frequency, phase in ((5.0, 0.3), (11.0, 1.1), (20.0, 2.0)):
        w = 2 * np.pi * frequency
        shown = -(w**2) if floor else omega**2 + 2j * ratio * omega * w
        transmitted = shown / (omega**2 - w**2 + 2j * ratio * omega * w)
        excitation += np.cos(w * time + phase)
        expected += (transmitted * np.exp(1j * (w * time + phase))).real
    middle = slice(2000, 3800)
    errors = [
        np.max(np.abs(response(of, drive, STEP).acceleration[:, 0] - expected)[middle])
        for drive in (DrivenRun(excitation, floor, between=band_limited(excitation)), DrivenRun(excitation, floor))
    ]
    assert errors[0] < 1e-3 * np.max(np.abs(expected))
    assert errors[1] > 0.03 * np.max(np.abs(expected))


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 9, 50])
def test_pieces_of_any_length_and_a_still_ground_stay_finite(samples):
    """Short records and records of zeros cause no division by zero (warnings are errors)."""
    for motion in (np.zeros(samples), np.ones(samples), np.sin(np.arange(samples))):
        found = band_limited(motion)
        assert found.shape == motion.shape
        assert np.isfinite(found).all()
    np.testing.assert_array_equal(band_limited(np.zeros(samples)), 0.0)


def test_white_samples_are_no_band_limited_motion():
    white = np.random.default_rng(0).standard_normal(6000)
    assert np.sqrt(np.mean((band_limited(white) - white) ** 2)) < 0.02


def test_forces_are_in_equilibrium():
    of, excitation = model_of(4), shaking(300, STEP)
    by_base = response(of, DrivenRun(excitation), STEP)
    np.testing.assert_allclose(by_base.base_shear, -by_base.acceleration @ np.diag(of.M), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(
        by_base.overturning_moment, -by_base.acceleration @ (np.diag(of.M) * [3, 6, 9, 12]), rtol=1e-10, atol=1e-8
    )
    # Springs and dashpots carry the story force: k drift + c drift rate, with the rate by differences.
    _, stiffness, dashpots = damped_frame(4)
    rate = np.gradient(by_base.drift, STEP, axis=0)
    resisted = by_base.drift * stiffness + rate * dashpots
    error = (by_base.story_shear - resisted)[5:-5]
    assert np.abs(error).max() < 0.02 * np.abs(resisted).max()
    by_force = response(of, DrivenRun(excitation, floor=2), STEP)
    above = -by_force.acceleration[:, 2:] @ np.diag(of.M)[2:]
    np.testing.assert_allclose(by_force.story_shear[:, 2], above, atol=1e-10)


def test_excitations_that_cannot_be_right():
    with pytest.raises(InputError, match="run 1: excitation, entry 2 must be a finite number, not nan"):
        DrivenRun([0.0, float("nan"), 1.0])
    with pytest.raises(InputError, match="has one sample; at least two"):
        DrivenRun([1.0])
    with pytest.raises(InputError, match="zero throughout"):
        recording_of(DrivenRecord((DrivenRun([0.0, 0.0]),), 100.0))
    with pytest.raises(InputError, match="responses must be a table of 2 samples by floors"):
        DrivenRun([0.0, 1.0], responses=np.zeros((3, 1)))
    with pytest.raises(InputError, match="the responses have 1 columns, 2 floors are named"):
        DrivenRecord((DrivenRun([0.0, 1.0], responses=np.zeros((2, 1))),), 100.0, floors=np.array([1, 2]))
    with pytest.raises(InputError, match="the force acts on floor 4 of a frame of 3 stories"):
        response(model_of(3), DrivenRun([0.0, 1.0], floor=4), STEP)


def test_a_peak_is_known_no_better_than_the_strong_part_of_its_motion():
    """For the motion cos t with deviation 0.02 |sin t|, the peak's deviation is the rms over |cos t| > 1/2."""
    time = np.linspace(0.0, 20 * np.pi, 100_001)
    nothing, moved = np.zeros((len(time), 1)), 3.0 * np.cos(time)[:, None]
    moved[50_000] *= 1.001
    run = Response(time, nothing, moved, nothing, None, mass_known=False)
    (std,) = peaks_of([(run, {"floor_displacement": 0.06 * np.abs(np.sin(time))[:, None]})]).std["floor_displacement"]
    # Over |t| < pi / 3, the integrals of sin^2 and cos^2 are pi / 3 -+ sqrt(3) / 4.
    expected = 0.02 * np.sqrt((np.pi / 3 - np.sqrt(3) / 4) / (np.pi / 3 + np.sqrt(3) / 4))
    assert std == pytest.approx(3.003 * expected, rel=1e-3)
    # A deviation proportional to the motion has the same ratio at the peak.
    (std,) = peaks_of([(run, {"floor_displacement": 0.02 * np.abs(moved)})]).std["floor_displacement"]
    assert std == pytest.approx(0.02 * 3.003)
