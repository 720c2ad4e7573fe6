"""Test reconstruction against explicit least squares, finite differences and finite-element frames."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from scipy import linalg, signal

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.measurement.declaration import Limits
from cvxshear.programs import LeastSquares
from cvxshear.records import Channel, Run, TimeRecord
from cvxshear.records.motion import DrivenRecord, DrivenRun, band_limited
from cvxshear.report.blocks import describe
from cvxshear.response import DampedModel, Fitted, reconstruct, response
from cvxshear.response.compare import as_predicted, readings_of
from cvxshear.response.frame_motion import FrameMotion, settled_states, smooth
from cvxshear.response.frame_prior import Linear
from cvxshear.response.innovations import Directions, Filter, PredictionErrors, Segment
from cvxshear.response.predicted import RESPONSES, histories
from cvxshear.response.recording import parted, recording_of
from cvxshear.response.state_space import Noise, Setting, dynamics, recursion
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.response.varied_frame import VariedFrame
from cvxshear.util.errors import InputError, UnsuitableError
from tests.frames import chain
from tests.response.common import damped_frame, damped_measurement, declared, driven, matrices, shaking, straight
from tests.studies import reconstruction as study

STEP = 0.01
START = 1.5
"""Factor on the standard deviation of the state at the start of a run."""


@pytest.fixture(scope="module")
def three():
    """Return a three-story frame with two sensors, its state-space model, and 60 samples with a gap and a spike."""
    mass, stiffness, dashpots = damped_frame(3)
    M, C, K = matrices(mass, stiffness, dashpots)
    model = DampedModel(M, C, K, np.array([1.0, 1.0, 1.05]))
    omega = 2 * np.pi * model.modes.frequencies
    setting = Setting(np.array([1, 3]), STEP, 0, omega[0], 1e-3 * stiffness, model.M)
    system = dynamics(model, Noise(np.array([0.05, 0.08]), 0.05), setting)
    excitation = shaking(60, STEP)
    exact = response(model, DrivenRun(excitation), STEP).acceleration[:, [0, 2]] * model.gain[[0, 2]]
    rng = np.random.default_rng(0)
    y = exact + np.array([0.05, 0.08]) * rng.standard_normal((60, 2))
    y[20] += 4.0
    y[35:42, 0] = np.nan
    return model, setting, system, DrivenRun(excitation, responses=y)


def motion_program(model, run, weights):
    """Return the smoother's program as a table; the unknowns are the states, sample after sample."""
    samples, n = len(run.excitation), len(model.A)
    pushed = driven(model, run.drive)
    scaled, sides = [], []

    def add(blocks, side):
        row = np.zeros((len(side), samples * n))
        for at, block in blocks.items():
            row[:, at * n : (at + 1) * n] = block
        scaled.append(row)
        sides.append(side)

    add({0: whitening(START**2 * model.P0)}, np.zeros(n))
    for t in range(samples - 1):
        white = whitening(model.Q)
        add({t + 1: white, t: -white @ model.A}, white @ pushed[t])
    for t in range(samples):
        own = weights[t] > 0
        root = np.sqrt(weights[t, own] / model.R[own])
        side = run.measured[t, own] - model.direct[own] * run.excitation[t]
        add({t: root[:, None] * model.H[own]}, root * side)
    return LeastSquares(np.concatenate(scaled), np.concatenate(sides))


def whitening(covariance):
    """Return W with W covariance W' = 1."""
    unit = 1.0 / np.sqrt(np.diag(covariance))
    lower = np.linalg.cholesky(covariance * np.outer(unit, unit))
    return linalg.solve_triangular(lower, np.diag(unit), lower=True)


def test_the_sweeps_solve_the_program_on_every_backend(three):
    _, _, system, run = three
    found = smooth(system, run, system.outputs.rows, START**2 * system.P0)
    program = motion_program(system, run, found.weights)
    scale = np.abs(found.states).max(axis=0)
    for name in backends.available():
        x = backends.get(name).solve(program).x.reshape(found.states.shape)
        np.testing.assert_allclose(x / scale, found.states / scale, atol=1e-6, err_msg=name)
    assert found.weights[20].max() < 0.3
    assert np.all(found.weights[35:42, 0] == 0)
    # The covariance of least squares is the inverse of the normal matrix.
    covariance = np.linalg.inv(program.R.T @ program.R)
    rows, n = system.outputs.rows, len(system.A)
    for t in (0, 20, 38, 59):
        block = covariance[t * n : (t + 1) * n, t * n : (t + 1) * n]
        np.testing.assert_allclose(found.output_std[t], np.sqrt(np.diag(rows @ block @ rows.T)), rtol=1e-6)


def kalman(system, run, weights):
    """Return states and covariances by Kalman's filter and the Rauch-Tung-Striebel backward pass, sample by sample."""
    pushed = driven(system, run.drive)
    x, P = np.zeros(len(system.A)), START**2 * system.P0
    told, foretold = [], []
    for t, row in enumerate(run.measured):
        foretold.append((x, P))
        own = weights[t] > 0
        H, e = system.H[own], row[own] - system.direct[own] * run.excitation[t] - system.H[own] @ x
        gain = np.linalg.solve(H @ P @ H.T + np.diag(system.R[own] / weights[t, own]), H @ P).T
        x, P = x + gain @ e, P - gain @ H @ P
        told.append((x, P))
        x, P = system.A @ x + pushed[t], system.A @ P @ system.A.T + system.Q
    states, covariances = [told[-1][0]], [told[-1][1]]
    for (x, P), (after, spread) in zip(told[-2::-1], foretold[:0:-1], strict=True):
        back = np.linalg.solve(spread, system.A @ P).T
        states.insert(0, x + back @ (states[0] - after))
        covariances.insert(0, P + back @ (covariances[0] - spread) @ back.T)
    return np.array(states), np.array(covariances)


def test_long_stretches_are_smoothed_as_sample_by_sample(three):
    """The smoother treats settled gains as constant and runs its passes in blocks."""
    model, _, system, _ = three
    samples = 1500
    excitation = shaking(samples, STEP)
    exact = response(model, DrivenRun(excitation), STEP).acceleration[:, [0, 2]] * model.gain[[0, 2]]
    y = exact + np.array([0.05, 0.08]) * np.random.default_rng(2).standard_normal((samples, 2))
    y[700, 1] += 5.0
    y[900:1250, 0] = np.nan
    run = DrivenRun(excitation, responses=y)
    found = smooth(system, run, system.outputs.rows, START**2 * system.P0)
    states, covariances = kalman(system, run, found.weights)
    np.testing.assert_allclose(
        found.states / np.abs(states).max(axis=0), states / np.abs(states).max(axis=0), atol=1e-4
    )
    rows = system.outputs.rows
    std = np.sqrt(np.einsum("oi,tij,oj->to", rows, covariances, rows))
    # The limit covariance is accurate to a twentieth.
    np.testing.assert_allclose(found.output_std, std, rtol=0.025)
    assert np.sqrt(np.mean((found.output_std / std - 1.0) ** 2)) < 2e-3
    filled = states @ system.H.T + system.shown(run.drive)
    np.testing.assert_allclose(found.completed[900:1250, 0], filled[900:1250, 0], atol=1e-3)
    np.testing.assert_allclose(found.completed[:600], y[:600], atol=1e-9)


def test_settled_filters_with_a_gap_are_the_smoother_but_for_its_ends(three):
    """A sensor is missing for 1,500 of 4,000 samples; the motions agree away from both ends of the gap."""
    _, _, system, _ = three
    rng = np.random.default_rng(7)
    excitation = straight(shaking(4000, STEP))
    y = recursion(system.A, np.eye(9), driven(system, excitation), np.zeros(9)) @ system.H.T + system.shown(excitation)
    y += np.sqrt(system.R) * rng.standard_normal(y.shape)
    y[1000:2500, 1] = np.nan
    run = DrivenRun(excitation[:, 0], responses=y)
    found = smooth(system, run, np.zeros((0, 9)), system.P0)
    pieces = parted(run, 100)
    assert [(part.start, part.stop, seen.tolist()) for part, seen in pieces] == [
        (0, 1000, [True, True]), (1000, 2500, [True, False]), (2500, 4000, [True, True])
    ]  # fmt: skip
    assert len(parted(run, 1501)) == 1
    states = settled_states(system, excitation, found.completed, found.states[0], pieces)
    scale = np.abs(found.states).max(axis=0)
    away = np.ones(4000, dtype=bool)
    for end in (0, 1000, 2500, 4000):
        away[max(0, end - 300) : end + 300] = False
    assert np.max(np.abs(states - found.states)[away] / scale) < 1e-3
    # A smoother that took the filled-in samples for data would trust them.
    filled = settled_states(system, excitation, found.completed + [0.0, 0.3] * ~np.isfinite(y), found.states[0], pieces)
    np.testing.assert_allclose(filled, states)


@pytest.mark.parametrize("force_floor", [0, 3])
@pytest.mark.parametrize("gap", [500, 300])
def test_the_gradient_of_the_likelihood_is_that_of_differences(force_floor, gap):
    """The force is not linear between its samples; one sensor has no data from sample `gap`; the sensors are late."""
    mass, stiffness, dashpots = damped_frame(3)
    M, C, K = matrices(mass, stiffness, dashpots)
    rng, solver = np.random.default_rng(1), backends.get("auto")
    experiment = cvxshear.Experiment.from_dict(damped_measurement(3, rng=rng))
    frame = UncertainFrame.of(Fitted.of(efficient(experiment, solver)), experiment.configurations[0], None, solver)
    excitation = shaking(500, STEP) * (5.0 if force_floor else 1.0)
    drive = DrivenRun(excitation, force_floor, between=band_limited(excitation))
    both = np.column_stack([drive.between, excitation])
    y = response(DampedModel(M, C, K, np.ones(3)), drive, STEP).acceleration[:, [0, 2]]
    y = y + 0.02 * rng.standard_normal(y.shape)
    omega = 2 * np.pi * 8.0
    setting = Setting(np.array([1, 3]), STEP, force_floor, omega, 1e-3 * stiffness, M)
    sensors = np.array([[True, True], [True, False]])
    y[gap:, 1] = 1e3
    parts = [part for part in (slice(0, gap), slice(gap, 500)) if part.start < 500]
    slopes = np.gradient(y[:gap], axis=0)
    slopes = np.concatenate([slopes, np.zeros((500 - gap, 2))])
    slopes[gap:, 0] = np.gradient(y[gap:, 0]) if gap < 500 else 0.0
    pairs = list(zip(parts, sensors, strict=False))
    stretches = [Segment(both[part], y[part], seen, slopes[part]) for part, seen in pairs]
    errors = PredictionErrors(VariedFrame.around(frame), setting, stretches, Noise(np.array([0.03, 0.02]), 0.02))
    p = 0.02 * rng.standard_normal(errors.size)
    at = errors.linearised(p, Directions(np.eye(errors.size), np.eye(errors.size)))
    step = 1e-4 * np.eye(errors.size)
    differences = [(errors.objective(p + row) - errors.objective(p - row)) / 2e-4 for row in step]
    np.testing.assert_allclose(2 * at.U.T @ at.c, differences, rtol=1e-3, atol=0.05)
    # The settled filter's own objective by the plain recursion, minimized over the initial state L z.
    total, on_time = 0.0, y + slopes * p[errors.delays]
    for part, seen, L in zip(parts, sensors, errors.spreads, strict=False):
        filtered = Filter.settled(errors.dynamics(p).seen_by(seen))
        white = np.linalg.inv(np.linalg.cholesky(filtered.S))
        pushed = driven(filtered.model, both[part])
        x, moved, rows, sides = np.zeros(9), L, [np.eye(9)], [np.zeros(9)]
        for t in range(part.start, part.stop):
            e = on_time[t, seen] - filtered.model.H @ x - filtered.model.direct * excitation[t]
            rows.append(white @ filtered.model.H @ moved)
            sides.append(white @ e)
            total += np.linalg.slogdet(filtered.S)[1]
            x, moved = filtered.model.A @ x + filtered.K @ e + pushed[t - part.start], filtered.F @ moved
        rows, sides = np.concatenate(rows), np.concatenate(sides)
        total += np.sum((sides - rows @ np.linalg.lstsq(rows, sides)[0]) ** 2)
    assert errors.objective(p) == pytest.approx(total, rel=1e-9)


@pytest.fixture(scope="module")
def softened():
    """Return a three-story finite-element frame with one story 10 % softer in the record; one of two limits is met."""
    models, motion, drift, soft = study.setting(3, "soft", 1)
    ratio = np.abs(drift).max(axis=0) / 3.5
    limits = Limits([0.5 * ratio.min(), 2 * ratio.max()], ("seen", "not seen"))
    after = dataclasses.replace(models.after, experiment=dataclasses.replace(models.after.experiment, limits=limits))
    models = dataclasses.replace(models, after=after)
    return models, motion, drift, soft, reconstruct(models, motion)


def test_the_soft_story_is_named_though_predicted_drifts_are_wrong(softened):
    _, _, drift, soft, found = softened
    assert found.changed == (soft,)
    assert found.frame.factors[soft - 1] == pytest.approx(0.9, abs=0.02)
    true = np.abs(drift).max(axis=0)
    assert np.max(np.abs(found.predicted_peaks.values["story_drift"] / true - 1)) > 0.05
    assert np.all(found.model.ratios == pytest.approx(study.RECORDED_RATIO, abs=0.003))
    # The evidence is that of all answers together, with the likelihood linearized at the fitted frame.
    at, p, prior = found.frame.errors.linearised(found.frame.p, found.frame.along), found.frame.p, found.frame.prior
    each = [
        Linear(at, p, prior.gaussian((), answer.form_std)).evidences(prior.changes, [answer.changed])[0]
        + sum(prior.changes[place].log_odds for place in answer.changed)
        for answer in found.frame.answers
    ]
    constant = 0.5 * (at.c @ at.c - found.frame.errors.objective(p))
    assert found.frame.log_evidence == pytest.approx(np.logaddexp.reduce(each) + constant, rel=1e-9)
    lower, upper = found.frame.errors.bounds(found.frame.prior.gaussian((), 0.01))
    assert np.all((lower < 0) & (upper > 0))
    seen, not_seen = found.to_dict()["limits"]
    assert (seen["name"], not_seen["name"]) == ("seen", "not seen")
    assert min(seen["probability"]) > 0.99
    assert max(not_seen["probability"]) < 0.01


def test_bands_hold_every_quantity_and_the_sensors_left_out(softened):
    _, motion, drift, _, found = softened
    there = study.building(3, "soft", 1)[1]
    total, moved = study.shaken(there, motion.runs[0].excitation)
    shear = -np.cumsum((there.floor_mass * total)[:, ::-1], axis=1)[:, ::-1]
    true = {
        "floor_acceleration": total, "floor_displacement": moved, "story_drift": drift,
        "story_drift_ratio": drift / 3.5, "story_shear": shear, "base_shear": shear[:, 0],
        "overturning_moment": 3.5 * shear.sum(axis=1),
    }  # fmt: skip
    (run,) = found.runs
    for name, values in histories(run.response).items():
        off = (values - true[name]) / run.std[name]
        assert np.mean(np.abs(off) <= 1.96) > 0.9
        assert np.sqrt(np.mean(off**2)) > 0.4
        peaks = np.abs(true[name]).max(axis=0)
        np.testing.assert_allclose(found.peaks.values[name], peaks, rtol=0.01)
        assert np.all(np.abs(found.peaks.values[name] - peaks) < 2.0 * found.peaks.std[name])
    for check in found.checks:
        assert check.error < 1.5 * check.stated
        assert check.within > 0.85
        assert check.error < 0.5 * check.prediction_error


def test_spikes_a_gap_and_a_late_clock_change_no_drift_by_more_than_its_deviation(softened):
    models, motion, _, _, found = softened
    y = motion.runs[0].responses
    # Skip the refits without single sensors: they can only widen the deviations. The delay is applied to a
    # band-limited motion, because linear interpolation would color the noise.
    faulty = y.copy()
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(len(y), 1 / study.RATE) * 0.005)
    faulty[:, 1] = np.fft.irfft(np.fft.rfft(y[:, 1]) * turn, len(y))
    faulty[900, 1] += 10.0
    faulty[700:760, 0] = np.nan
    faulty[2000:3000:250, 0] += 0.5 * np.std(y[:, 0])
    drive = dataclasses.replace(motion.runs[0], responses=faulty)
    again = reconstruct(models, dataclasses.replace(motion, runs=(drive,)), leave_out=False)
    moved = np.abs(again.peaks.values["story_drift"] - found.peaks.values["story_drift"])
    assert np.all(moved <= 0.5 * again.peaks.std["story_drift"])
    assert (again.spikes.tolist(), again.missing[0]) == ([4, 0], 60)
    (said,) = again.warnings
    late = re.match(r"the clock of the sensor of floor 3 is (\S+) ms late .*; taken out$", said)
    assert float(late[1]) == pytest.approx(5.0, abs=0.5)


def late_by_three_samples(y):
    y[3:, 1] = y[:-3, 1]
    return y


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda y: y * [1.0, -1.0], r'channel "floor 3" \(floor 3\) is reversed: .*; turned round'),
        (lambda y: y / [9.80665, 1.0], r"floor 1 looks like g, the others like m/s2"),
        (late_by_three_samples, r'the clock of "floor 3" is (29|30).\d+ ms late .*; taken out'),
        (lambda y: y, None),
    ],
)
def test_what_is_surely_wrong_with_a_sensor_is_set_right_and_said(softened, fault, said):
    """Check that the restored record is the one before the fault, with gaps for lost samples."""
    motion = softened[1]
    y = np.array(motion.runs[0].responses)
    drive = dataclasses.replace(motion.runs[0], responses=fault(y.copy()))
    found = recording_of(dataclasses.replace(motion, runs=(drive,)), 3)
    got = found.runs[0].measured
    there = np.isfinite(got)
    missing = (~there).sum(axis=0)
    assert missing.max() == (48 if fault is late_by_three_samples else 0)
    # A delay is known to about 0.1 ms. This error rotates noise up to 50 Hz, but not the motion.
    assert np.all(np.abs(got - y)[there] < (0.35 if fault is late_by_three_samples else 1e-9))
    assert found.remarks == () if said is None else re.search(said, " ".join(found.remarks))


@pytest.mark.parametrize(("who", "off"), [("floor 3", -0.05), ("floor 3", 0.3), ("base motion", 0.04)])
def test_a_gain_that_is_off_moves_no_drift_and_is_named(who, off):
    """The frame is sound; without the unknown gain, the floors would seem heavier and drifts would be 25 % off."""
    models, motion, drift, _ = study.setting(3, "sound", 1, seconds=20.0)
    drive = motion.runs[0]
    if who == "base motion":
        drive = dataclasses.replace(drive, excitation=(1 + off) * drive.excitation)
    else:
        drive = dataclasses.replace(drive, responses=drive.responses * np.where(motion.floors == 3, 1 + off, 1.0))
    found = reconstruct(models, dataclasses.replace(motion, runs=(drive,)), leave_out=False)
    ((said, value, std),) = found.gains_off
    assert said == f"the sensor of {'the ' if who == 'base motion' else ''}{who}"
    assert value == pytest.approx(off, abs=3.0 * std)
    assert not found.changed
    assert not found.masses_changed
    true = np.abs(drift).max(axis=0)
    assert np.all(np.abs(found.peaks.values["story_drift"] - true) <= 2.5 * found.peaks.std["story_drift"])
    assert any(f"{said} reads" in warning for warning in found.warnings)


def test_a_sensor_that_moves_against_the_prediction_is_as_predicted(three):
    """The record is too short for an examination by itself; the identified frame reveals the sign."""
    model = three[0]
    ground = shaking(100, STEP)
    exact = response(model, DrivenRun(ground), STEP).acceleration * model.gain
    floors = np.array([1, 2, 3])
    wrong = DrivenRecord((DrivenRun(ground, responses=exact * [1.0, 1.0, -1.0]),), 1 / STEP, "base", floors)
    found = as_predicted(model, wrong)
    np.testing.assert_allclose(found.runs[0].measured, exact)
    (said,) = found.remarks
    assert said.startswith("the sensor of floor 3 is reversed")
    assert as_predicted(model, found).remarks == found.remarks
    # A record that moves with the prediction at one floor only may be another frame's.
    strange = np.column_stack([exact[::-1, :2], -exact[:, 2]])
    other = dataclasses.replace(wrong, runs=(DrivenRun(ground, responses=strange),))
    np.testing.assert_array_equal(as_predicted(model, other).runs[0].measured, strange)
    # If most sensors move against the prediction, the ground's own sign can be wrong.
    several = dataclasses.replace(wrong, runs=(DrivenRun(ground, responses=exact * [-1.0, 1.0, -1.0]),))
    kept = as_predicted(model, several)
    np.testing.assert_allclose(kept.runs[0].measured, several.runs[0].measured)
    assert kept.remarks[0].startswith("floors 1, 3 moved against the prediction")


def around(softened):
    """Return the motion of the identified frame around its record."""
    models, *_, found = softened
    frame = UncertainFrame.of(models.after, found.configuration, None, backends.get("auto"))
    return FrameMotion.around(frame, found.recording, free=True)


def test_a_deviation_that_leads_to_no_frame_is_followed_less_far(softened):
    """With form errors of the frame's own size, a frame one standard deviation away has no modes."""
    fitted = softened[-1].frame
    work = around(softened)
    wide = dataclasses.replace(fitted, covariance=4.0 * np.eye(len(fitted.p)))
    directions, _ = work.directions(wide)
    assert any(further > 1 for _, _, further in directions)
    for there, back, _ in directions:
        assert min(there.modes.eigenvalues[0], back.modes.eigenvalues[0]) > 0


def test_frames_a_hundredth_as_far_apart_move_a_hundredth_as_differently(softened):
    """A deviation is a small difference of two long motions; rounding must not dominate it."""
    fitted, recording, work = softened[-1].frame, softened[-1].recording, around(softened)
    noise, (smoothed,) = fitted.errors.noise_at(fitted.p), work.smoothed(fitted.errors, fitted.p)
    far, near = (
        np.abs(work.moved_by(sides, noise, recording.runs[0], smoothed))
        for share in (1.0, 1e-4)
        for sides in work.directions(dataclasses.replace(fitted, covariance=share * fitted.covariance))[0][:1]
    )
    off = np.sqrt(np.mean((100.0 * near - far) ** 2, axis=0) / np.mean(far**2, axis=0))
    assert np.max(off) < 0.02


def test_warnings_stand_before_the_numbers(softened):
    found = softened[-1]
    unsure = dataclasses.replace(
        found, recording=dataclasses.replace(found.recording, remarks=("floor 3 is reversed",))
    )
    first = [part.text for part in describe(unsure).sections[0].parts]
    assert first[0] == "Floor 3 is reversed."
    assert unsure.to_dict()["remarks"][0] == "floor 3 is reversed"
    assert describe(found).sections[0].parts[0].text.startswith(found.fitted.experiment.name)
    # A permanent property is no warning.
    (always,) = describe(found).sections[-1].parts
    assert describe(found).sections[-1].title == "What to bear in mind"
    assert always.texts == tuple(f"{each[0].upper()}{each[1:]}." for each in found.remarks)


@pytest.mark.parametrize(("finer", "taken"), [(1, "straight lines"), (8, "band-limited")])
def test_the_floors_tell_how_the_ground_moved_between_its_samples(finer, taken):
    """The floors reveal the ground motion between its samples; the other kind of motion would give wrong drifts."""
    models, motion, drift, _ = study.setting(3, "soft", 2, finer, seconds=24.0)
    found = reconstruct(models, motion, leave_out=False)
    (said,) = [remark for remark in found.remarks if remark.startswith("between its samples")]
    assert f"is taken as {taken}:" in said
    true, peaks = np.abs(drift).max(axis=0), found.peaks
    assert np.all(np.abs(peaks.values["story_drift"] - true) < 2.5 * peaks.std["story_drift"])
    np.testing.assert_allclose(peaks.values["story_drift"], true, rtol=0.01)


def test_of_a_record_that_is_not_a_linear_frames_only_what_needs_no_model_is_told():
    """A third of one story's stiffness is plastic; the motion is the identified frame's, with bands for its changes."""
    models, motion, drift, _ = study.setting(4, "yields", 0, seconds=20.0)
    experiment = dataclasses.replace(models.after.experiment, limits=Limits([0.0001, 0.02], ("low", "high")))
    models = dataclasses.replace(models, after=dataclasses.replace(models.after, experiment=experiment))
    found = reconstruct(models, motion, leave_out=False)
    assert "is not that of a linear frame with sound sensors" in found.warnings[0]
    assert (found.frame_fitted, found.changed, found.dampers, found.gains_off) == (False, (), (), ())
    np.testing.assert_allclose(found.frame.factors, 1.0)
    off = found.peaks.values["story_drift"] - study.largest(drift)
    assert np.all(np.abs(off) < 1.96 * found.peaks.std["story_drift"])
    # Drifts between neighboring sensors come from the difference of their records.
    sensors = np.concatenate([[0], motion.floors])
    floors = np.concatenate([np.zeros((len(drift), 1)), np.cumsum(drift, axis=1)], axis=1)
    true = study.largest(np.diff(floors[:, sensors], axis=1))
    assert [each[:2] for each in found.sensor_drifts] == list(itertools.pairwise(sensors.tolist()))
    np.testing.assert_allclose([each[2] for each in found.sensor_drifts], true, rtol=0.05)
    said = found.to_dict()
    assert said["fallback"] == found.fallback
    assert [item["probability"] for item in said["limits"]] == [[None] * 4] * 2
    headline = describe(found).headline
    assert headline.startswith("The record is not that of a linear frame with sound sensors; between ")
    assert "drifted most" not in headline
    assert "passed" not in headline


def test_a_fit_that_fails_leaves_the_frame_as_identified(softened, monkeypatch):
    models, motion, _, _, _ = softened
    drive, fit = motion.runs[0], FrameMotion.fitted
    drive = dataclasses.replace(drive, excitation=drive.excitation[:600], responses=drive.responses[:600])
    motion = dataclasses.replace(motion, runs=(drive,))

    failing = {True}

    def fitted(work, *, detrend):
        if work.free in failing:
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return fit(work, detrend=detrend)

    monkeypatch.setattr(FrameMotion, "fitted", fitted)
    found = reconstruct(models, motion, leave_out=False)
    assert (found.fallback, found.frame_fitted) == ("the fit of the frame failed", False)
    assert found.warnings[-1].startswith("the fit of the frame failed: the motion is that of the identified frame")
    failing.add(False)
    with pytest.raises(UnsuitableError, match="no motion of this frame comes near the record"):
        reconstruct(models, motion, leave_out=False)


def test_a_damper_in_one_story_is_named_and_moves_no_drift():
    """The frame has 2 % modal damping and, in tests and record, a dashpot that adds 3 % to the first mode."""
    rng = np.random.default_rng(6)
    mass, stiffness = 2e5 * np.exp(0.1 * rng.standard_normal(4)), 3e8 * np.array([1.0, 0.9, 0.7, 0.5])
    M, K = chain(mass, stiffness)
    squares, shapes = linalg.eigh(K, M)
    omega = np.sqrt(squares)
    turned = M @ shapes
    dashpot = 2 * 0.03 * omega[0] / (shapes[1, 0] - shapes[0, 0]) ** 2
    C = turned @ np.diag(2 * 0.02 * omega) @ turned.T + chain(mass, [0.0, dashpot, 0.0, 0.0])[1]
    ratios = np.diag(shapes.T @ C @ shapes) / (2 * omega)
    table = declared(mass, stiffness, np.minimum(ratios, 0.3), rng=rng, modes=[1, 2, 3])
    excitation = study.ground(6, 2500)
    rest = -np.linalg.solve(M, np.hstack([K, C]))
    frame = signal.StateSpace(
        np.vstack([np.eye(4, 8, 4), rest]), np.repeat([0.0, -1.0], 4)[:, None],
        np.vstack([rest, np.eye(4, 8)]), np.zeros((8, 1)),
    )  # fmt: skip
    moved = signal.lsim(frame, excitation, np.arange(2500) / study.RATE)[1]
    seen = moved[:, [1, 3]]
    seen = seen + 0.02 * seen.std(axis=0) * rng.standard_normal(seen.shape)
    motion = DrivenRecord((DrivenRun(excitation, 0, seen),), study.RATE, floors=np.array([2, 4]))
    found = reconstruct(cvxshear.Experiment.from_dict(table), motion, leave_out=False)
    assert found.dampers == (2,)
    size = found.frame.dashpots[0][1]
    assert size == pytest.approx(dashpot, rel=0.1)
    true = study.largest(np.diff(moved[:, 4:], axis=1, prepend=0.0))
    drift = found.peaks.values["story_drift"]
    np.testing.assert_allclose(drift, true, rtol=0.03)
    assert np.all(np.abs(drift - true) < 3 * found.peaks.std["story_drift"])
    assert "story 2 damps by itself, as a damper of " in describe(found).headline
    said = found.to_dict()["frame"]
    assert said["dashpot"] == [None, pytest.approx(size), None, None]
    frame = found.to_dataframe()
    assert frame.index.tolist() == [1, 2, 3, 4]
    np.testing.assert_allclose(frame["story_drift_m"], drift)
    assert frame.loc[2, "dashpot_probability"] > 0.95 > frame.loc[3, "dashpot_probability"]


def test_story_factors_are_stiffnesses_over_the_identified_ones(softened):
    """All unknowns of the stiffness contribute: masses scale all stories, and form errors change them."""
    _, _, _, _, found = softened
    errors, p = found.frame.errors, found.frame.p
    T = np.eye(3) - np.eye(3, k=1)

    def stories(unknowns):
        resists = np.linalg.inv(T) @ errors.varied.model(unknowns).K @ np.linalg.inv(T).T
        return np.diag(resists) / errors.varied.story_stiffness

    at = p[errors.frame]
    factors, J = errors.varied.story_factors(at)
    np.testing.assert_allclose(factors, stories(at), rtol=1e-12)
    np.testing.assert_allclose(found.frame.factors, factors)
    for column, step in zip(J.T, 1e-6 * np.eye(len(at)), strict=True):
        np.testing.assert_allclose(column, (stories(at + step) - stories(at - step)) / 2e-6, atol=1e-7)


def test_deviations_of_factors_and_modes_are_those_of_the_frame(softened):
    """Functions of the factors have linear deviations; those of modes are the scatter of drawn frames."""
    frame = softened[-1].frame
    errors, (N, D, W, _) = frame.errors, frame.errors.varied.sizes
    factors, J = errors.varied.story_factors(frame.p[errors.frame])
    masses = J[:, N + D : N + D + W]
    covariance = J @ frame.covariance[errors.frame, errors.frame] @ J.T + frame.prior.identified + masses @ masses.T
    np.testing.assert_allclose(frame.factors_std**2, np.diag(covariance) + frame.scale_std**2)
    mean, std = frame.mean_factor
    assert (mean, std**2) == pytest.approx((factors.mean(), covariance.mean() + frame.scale_std**2))
    weights = (1.0 - frame.story_probability) * (1.0 - np.eye(3))

    def apart(factors):
        return factors * weights.sum(axis=1) / (weights @ factors) - 1.0

    change, std = frame.against_others
    np.testing.assert_allclose(change, apart(factors), atol=1e-6)
    slopes = np.array([(apart(factors + step) - apart(factors - step)) / 2e-6 for step in 1e-6 * np.eye(3)])
    np.testing.assert_allclose(std**2, np.diag(slopes.T @ covariance @ slopes), rtol=1e-4)
    draws = map(errors.model, np.random.default_rng(0).multivariate_normal(frame.p, frame.covariance, 400))
    logarithms = np.log([[model.modes.frequencies, model.ratios] for model in draws])
    np.testing.assert_allclose(frame.modal_std, logarithms.std(axis=0), rtol=0.15)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"story_drift": [0.02, 0.01]}, "limits: story_drift must be ascending"),
        ({"story_drift": [2.0]}, "so 2 % is 0.02"),
        ({"story_drift": [0.01], "names": ["a", "b"]}, "limits: names must have"),
        ({"names": ["a"]}, "story_drift"),
    ],
)
def test_wrong_limits_are_refused(limits, message):
    mass, stiffness, _ = damped_frame(2)
    with pytest.raises(InputError, match=message):
        cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02, 0.02], limits=limits))


def test_limits_pass_through_a_dict():
    mass, stiffness, _ = damped_frame(2)
    table = declared(mass, stiffness, [0.02, 0.02], limits={"story_drift": [0.005, 0.01]})
    experiment = cvxshear.Experiment.from_dict(table)
    assert experiment.limits.names == ("0.5 %", "1 %")
    again = cvxshear.Experiment.from_dict(experiment.to_dict())
    assert again.limits.to_dict() == experiment.limits.to_dict()


def test_a_ground_that_stands_still_is_refused_and_a_slow_one_has_one_reading():
    """Linear interpolation at intervals h loses (pi f h)^2 / 3 of a sine: 8e-5 at 200 samples per period."""
    mass, stiffness, dashpots = damped_frame(2)
    model = DampedModel(*matrices(mass, stiffness, dashpots), np.ones(2))
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02, 0.02]))
    slow = np.hanning(400) * np.sin(2 * np.pi * np.arange(400) / 200)

    def recorded(ground):
        return DrivenRecord((DrivenRun(ground, responses=shaking(400)[:, None]),), 1 / STEP, floors=np.array([2]))

    # The channel has an offset, a drift and a tiny reading: the deviation from a straight line is rounding.
    for still in (np.full(400, 0.3), np.linspace(0.1, 1.0, 400), np.full(400, 1e-300)):
        with pytest.raises(InputError, match="run 1: the input channel shows no motion but a straight line"):
            reconstruct(experiment, recorded(still))
    with pytest.raises(InputError, match="run 1: the input channel is zero throughout"):
        reconstruct(experiment, recorded(np.zeros(400)))
    still = DrivenRun(shaking(200), responses=np.zeros((200, 1)))
    with pytest.raises(InputError, match="the channel on floor 2 shows no motion"):
        recording_of(DrivenRecord((still,), 100.0, floors=np.array([2])))
    bare = DrivenRecord((DrivenRun(slow),), 1 / STEP)
    with pytest.raises(InputError, match="no floor's acceleration was recorded"):
        reconstruct(experiment, bare)
    forced = [DrivenRun(slow, floor, shaking(400)[:, None]) for floor in (1, 2)]
    with pytest.raises(InputError, match="the force acts on several floors"):
        reconstruct(experiment, DrivenRecord(tuple(forced), 1 / STEP, "force", np.array([2])))
    assert len(readings_of(model, recording_of(recorded(slow)))) == 1
    lines, smooth_one = readings_of(model, recording_of(recorded(shaking(400))))
    np.testing.assert_allclose(smooth_one.runs[0].measured, lines.runs[0].measured)
    nobodys = TimeRecord((Channel("f2", 2),), runs=(Run(shaking(400)[:, None]),), sampling_rate=1 / STEP)
    with pytest.raises(InputError, match='has input = "none"; what drove the frame in time is needed'):
        recording_of(nobodys)


def test_a_record_file_gives_one_channel_a_floor_between_start_and_end(tmp_path):
    """Floor 2 has two sensors that turn against each other; one faces backwards, one across; 1.5 of 3 s are used."""
    time = np.arange(300) / 100
    moved, turned = np.sin(9 * time), 0.2 * np.cos(5 * time)
    columns = [time, np.cos(9 * time), moved + turned, turned - moved, 7 * moved]
    table = np.column_stack(columns)
    table[150, 2] = np.nan
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="time,ground,a,b,c", comments="")
    channel = '[[channel]]\ncolumn = "{}"\nfloor = {}\ndirection = {}\n'
    (tmp_path / "r.toml").write_text(
        '[record]\ninput = "base"\n[[run]]\nfile = "r.csv"\nstart = 1.0\nend = 2.5\n'
        '[[channel]]\ncolumn = "ground"\nfloor = 0\n'
        + "".join(channel.format(*each) for each in (("a", 2, 0.0), ("b", 2, 180.0), ("c", 1, 90.0)))
    )
    found = recording_of(tmp_path / "r.toml")
    assert found.floors.tolist() == [2]
    (only,) = found.runs
    expected = moved[100:250].copy()
    expected[50] = np.nan
    np.testing.assert_allclose(only.measured[:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(only.excitation, np.cos(9 * time[100:250]), atol=1e-12)


@pytest.mark.parametrize(("stories", "frames"), [(3, 2), (8, 1)])
def test_effects_that_the_model_lacks_are_in_the_bands(stories, frames):
    """The frames have flexible beams, the model is a shear model; drifts between the sensors must lie within bands."""
    by_prediction, by_fit = [], []
    for seed in range(frames):
        models, motion, drift, _ = study.setting(stories, "beams", seed, seconds=20.0)
        found = reconstruct(models, motion, leave_out=False)
        errors, deviations, within = study.against(found, drift)
        assert np.all(np.abs(deviations) < 3.0)
        assert np.mean(within) > 0.9
        assert not found.changed
        by_prediction.append(found.predicted_peaks.values["story_drift"] / np.abs(drift).max(axis=0) - 1)
        by_fit.append(errors)
    assert np.sqrt(np.mean(np.square(by_fit))) < 0.4 * np.sqrt(np.mean(np.square(by_prediction)))


def piece_of(motion, rows, baseline=0.0):
    """Return a piece of a record, with an offset of the base's sensor."""
    (run,) = motion.runs
    part = dataclasses.replace(run, excitation=run.excitation[rows] + baseline, responses=run.responses[rows])
    return dataclasses.replace(motion, runs=(part,))


@pytest.mark.parametrize(("samples", "baseline"), [(300, 0.0), (1000, 0.0), (3100, 0.02)])
def test_a_piece_of_a_motion_is_reconstructed_as_well(softened, samples, baseline):
    """No recorded excitation causes the first motion. Straight lines of strong motion are not its sensors'."""
    models, motion, drift, soft, _ = softened
    piece = slice(900, 900 + samples)
    part = piece_of(motion, piece, baseline)
    found = reconstruct(models, part, leave_out=False)
    true, drift_std = np.abs(drift[piece]).max(axis=0), found.runs[0].std["story_drift"]
    assert np.all(np.abs(drift[900:950]).max(axis=0) > 0.1 * true)
    np.testing.assert_allclose(part.runs[0].excitation - found.runs[0].excitation, baseline, atol=0.03)
    np.testing.assert_allclose(found.peaks.values["story_drift"], true, rtol=0.01)
    assert np.all(np.abs(found.peaks.values["story_drift"] - true) < 3 * found.peaks.std["story_drift"])
    assert np.mean(np.abs(found.runs[0].response.drift - drift[piece]) <= 1.96 * drift_std) > 0.9
    assert found.changed == (soft,) or (samples == 300 and not found.changed)


def test_of_a_record_shorter_than_two_periods_nothing_is_told(softened):
    """Such a record holds no scatter by which a fit could be judged, whatever its first samples are."""
    models, motion, _, _, found = softened
    samples = int(1.9 / found.model.modes.frequencies[0] * study.RATE)
    found = reconstruct(models, piece_of(motion, slice(600, 600 + samples)), leave_out=False)
    assert "two periods" in found.fallback
    assert np.all(np.isnan(found.passed))


def recorded(frame, seed, floors, seconds=20.0):
    """Return a frame's record by sensors on some floors with noise of 1 % of their rms, and its true drifts."""
    excitation = study.ground(seed, int(seconds * study.RATE))
    total, moved = study.shaken(frame, excitation)
    seen = total[:, np.array(floors) - 1]
    noise = 0.01 * np.sqrt(np.mean(seen**2, axis=0)) * np.random.default_rng(seed).standard_normal(seen.shape)
    drive = DrivenRun(excitation, responses=seen + noise)
    return DrivenRecord((drive,), study.RATE, "base", np.array(floors)), total, np.diff(moved, axis=1, prepend=0.0)


def test_of_a_frame_that_its_tests_do_not_determine_no_change_is_named():
    """Two modes at three of five floors, then a story 12 % softer: many frames have these modes."""
    sound, _, _ = study.building(5, "sound", 3)
    table = study.measurement(sound, 3)
    (test,) = table["configuration"]
    few = {key: test[key][:2] for key in ("frequencies", "damping_ratios")}
    shapes = [[row[floor - 1] for floor in (2, 3, 5)] for row in test["mode_shapes"][:2]]
    table["configuration"] = [test | few | {"mode_shapes": shapes, "measured_floors": [2, 3, 5]}]
    del table["prior"], table["frame"]["story_heights"]
    softer = sound.story_stiffness * np.array([1.0, 1.0, 1.0, 0.88, 1.0])
    motion, _, drift = recorded(dataclasses.replace(sound, story_stiffness=softer), 3, (2, 5))
    found = reconstruct(cvxshear.Experiment.from_dict(table), motion, leave_out=False)
    assert found.undetermined
    assert set(RESPONSES) - found.runs[0].std.keys() == {"story_drift_ratio", "overturning_moment"}
    assert (found.changed, found.masses_changed, found.gains_off) == ((), False, ())
    assert found.to_dict()["frame"]["change_probability"] == [None] * 5
    assert "the tests do not determine the frame" in found.warnings[0]
    assert "what changed since cannot be told" in describe(found).headline
    off = found.peaks.values["story_drift"] - np.abs(drift).max(axis=0)
    assert np.all(np.abs(off) < 3 * found.peaks.std["story_drift"])


def test_a_heavier_floor_makes_no_story_softer():
    """One floor of five is 15 % heavier. Base motion gives no mass scale; shears and mean factor allow for it."""
    sound, _, _ = study.building(5, "sound", 2)
    heavier = sound.floor_mass * np.array([1.0, 1.0, 1.15, 1.0, 1.0])
    motion, total, _ = recorded(dataclasses.replace(sound, floor_mass=heavier), 2, (1, 3, 5))
    table = {key: value for key, value in study.measurement(sound, 2).items() if key != "prior"}
    found = reconstruct(cvxshear.Experiment.from_dict(table), motion, leave_out=False)
    assert found.frame.mass_probability > 0.95
    change, deviation = found.frame.mass_change
    assert np.all(np.abs(change - [0.0, 0.0, 0.15, 0.0, 0.0] + 0.03) < 3 * deviation)
    mean, std = found.frame.mean_factor
    assert abs(mean - 1.0) < 2 * std
    forces = np.cumsum((heavier * total)[:, ::-1], axis=1)[:, ::-1]
    off = found.peaks.values["story_shear"] - np.abs(forces).max(axis=0)
    assert np.all(np.abs(off) < 3 * found.peaks.std["story_shear"])
