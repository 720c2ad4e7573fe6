"""Test whole predictions against simulated frames, from every kind of source, and their remarks."""

import dataclasses
import re

import numpy as np
import pytest
from scipy import signal

import cvxshear
from cvxshear import backends, close_loop, effects
from cvxshear.effects import LocatedEffect
from cvxshear.fit.efficient import efficient
from cvxshear.io.toml import write_measurement
from cvxshear.measurement.declaration import Limits
from cvxshear.records import Channel, Run, TimeRecord
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.report.blocks import describe
from cvxshear.report.responses import series
from cvxshear.response import DampedModel, Fitted, Models, predict, response
from cvxshear.response.compare import compared, peak
from cvxshear.response.predicted import peaks_of
from cvxshear.response.sources import state_of
from cvxshear.response.state_space import Response
from cvxshear.util.errors import InputError
from tests.response.common import damped_frame, damped_measurement, declared, matrices, pole_ratios, shaking
from tests.studies.response_coverage import coverage, linear_over_sampled

RATE = 100.0


@pytest.fixture(scope="module")
def frame():
    """Return three stories: exact modes with small deviations, and the truth."""
    M, C, K = matrices(*damped_frame(3))
    table = damped_measurement(3, ratio_std=1e-4, shape_std=0.002, damping={"kind": "story"})
    experiment = cvxshear.Experiment.from_dict(table, name="three")
    return experiment, efficient(experiment, backends.get("auto")), DampedModel(M, C, K, np.ones(3), np.full(3, 3.0))


def recorded(truth, floors=(1, 2, 3), gain=None, samples=3000, input_floor=0, **options):
    """Return a record of the true frame."""
    excitation = shaking(samples, 1 / RATE, **options)
    found = response(truth, DrivenRun(excitation, input_floor), 1 / RATE).acceleration
    found = found * (np.ones(len(truth.M)) if gain is None else gain)
    channels = tuple(Channel(f"floor{floor}", floor) for floor in floors)
    runs, kind = (Run(found[:, np.array(floors) - 1], excitation, input_floor),), "force" if input_floor else "base"
    return TimeRecord(channels, name="shaken", runs=runs, sampling_rate=RATE, input=kind)


@pytest.mark.parametrize("input_floor", [0, 3])
def test_the_true_frame_has_no_error(frame, input_floor):
    _, estimate, truth = frame
    found = predict(estimate, recorded(truth, input_floor=input_floor), detrend=False)
    assert found.before is None
    beside = found.after.comparison
    assert beside.floors.tolist() == [1, 2, 3]
    np.testing.assert_allclose(beside.nrmse, 0, atol=1e-5)
    np.testing.assert_allclose(beside.rms_ratio, 1, atol=1e-5)
    np.testing.assert_allclose(beside.peak_ratio, 1, atol=1e-5)
    np.testing.assert_allclose(beside.frf_error[np.isfinite(beside.frf_error)], 0, atol=1e-5)
    assert np.isfinite(beside.frf_error[:, 0]).all()
    assert beside.shifts == ()
    # The excitation is linear between its samples, so the motion is known at any time.
    drive = found.motion.runs[0]
    times = np.arange(len(drive.excitation))
    finer = np.interp(np.arange(0, times[-1], 1 / 32), times, drive.excitation)
    exact = response(truth, DrivenRun(finer, input_floor), 1 / (32 * RATE))
    np.testing.assert_allclose(found.peaks.values["story_drift"], np.abs(exact.drift).max(axis=0), rtol=3e-3)
    np.testing.assert_allclose(found.peaks.values["base_shear"], np.abs(exact.base_shear).max(), rtol=3e-3)
    np.testing.assert_allclose(found.damping.story_dashpot, damped_frame(3)[2], rtol=1e-3)


@pytest.mark.parametrize(("frequency", "rest"), [(1.0, 1e-5), (3.0, 5e-4)])
def test_a_peak_stands_between_samples(frequency, rest):
    """A harmonic of 2 mm, sampled at 50 Hz, peaks between samples for any phase. A jump peaks at a sample.

    So does the harmonic whose peak is the last sample but one.
    """
    time = np.arange(200) / 50
    phases = 2 * np.pi * frequency * time[:, None] + np.linspace(0, np.pi, 12)
    nothing = np.zeros_like(phases)
    late = np.where(time > time[-6], np.cos(2 * np.pi * frequency * (time - time[-2])), 0.0)[:, None]
    for motion in (np.cos(phases), np.where(time[:, None] < 2, nothing, 1.0), late):
        moved = Response(time, nothing, 2e-3 * motion, nothing, None, True)
        found = peaks_of([(moved, {})]).values["floor_displacement"]
        np.testing.assert_allclose(found, 2e-3, rtol=rest)


def test_deviations_of_peaks_are_those_of_samples():
    ratio = linear_over_sampled(3, "modal", 200)
    # With 200 samples, deviations are known to 5 %. Curvature explains the rest.
    assert np.all((ratio > 0.85) & (ratio < 1.2))


@pytest.mark.parametrize(("stories", "kind", "trials"), [(3, "modal", 40), (3, "story", 40), (8, "story", 20)])
def test_intervals_hold_the_truth_as_often_as_they_say(stories, kind, trials):
    """Run a seeded part of `tests.studies.response_coverage`: trials with 7 or 17 dependent peaks."""
    share, deviations = coverage(stories, kind, trials)
    assert 0.88 <= share <= 0.99
    assert abs(deviations.mean()) < 0.4


def test_the_effect_found_takes_the_error_away():
    """The record's top sensor reads 8 % too much, so the shear model is wrong."""
    M, C, K = matrices(*damped_frame(3))
    gain = np.array([1.0, 1.0, 1.08])
    table = damped_measurement(3, frequency_std=0.0005, shape_std=0.002)
    shapes = np.array(table["configuration"][0]["mode_shapes"]) * gain
    table["configuration"][0]["mode_shapes"] = shapes.tolist()
    experiment = cvxshear.Experiment.from_dict(table)
    gained = LocatedEffect(effects.named(["sensor_gain"])[0], effects.Place(floor=3))
    solver = backends.get("auto")
    pair = Models(Fitted.of(efficient(experiment, solver)), Fitted.of(efficient(experiment, solver, [gained])))
    truth = DampedModel(M, C, K, np.ones(3))
    found = predict(pair, recorded(truth, gain=gain), damping="story", detrend=False)
    assert found.before.comparison.rms_ratio[2] < 0.97
    np.testing.assert_allclose(found.after.comparison.rms_ratio, 1.0, atol=1e-3)
    assert found.to_dict()["effects"] == [gained.to_dict()]


def test_a_changed_frame_is_told(frame):
    """Stiffnesses 10 % lower give frequencies 5 % lower."""
    _, estimate, truth = frame
    softer = DampedModel(truth.M, truth.C, 0.9 * truth.K, truth.gain)
    found = predict(estimate, recorded(softer, samples=20_000))
    shifts = found.after.comparison.shifts
    # The second mode shifted by the same ratio. The remark names both.
    assert {1, 2} <= {shift.mode for shift in shifts}
    for shift in shifts:
        assert shift.measured / shift.modelled == pytest.approx(np.sqrt(0.9), abs=0.01)
    (said,) = [remark for remark in found.remarks if "depend on the amplitude, or the frame has changed" in remark]
    # Shift of the first mode in percent: sqrt(0.9) - 1.
    assert float(said.partition("Hz (")[2].partition(" %")[0]) == pytest.approx(-5.1, abs=1.0)
    assert predict(estimate, recorded(truth, samples=20_000)).after.comparison.shifts == ()


def test_the_line_that_is_taken_off_is_told_with_its_floor(frame):
    """Floor 2's sensor drifts from minus to plus twice the rms of the motion."""
    _, estimate, truth = frame
    exact = recorded(truth)
    run = exact.runs[0]
    seen, rms = run.responses.copy(), float(np.sqrt(np.mean(run.responses[:, 1] ** 2)))
    seen[:, 1] += 2.0 * rms * np.linspace(-1.0, 1.0, len(seen))
    found = predict(estimate, dataclasses.replace(exact, runs=(Run(seen, run.excitation),)))
    (said,) = [remark for remark in found.remarks if "a straight line of up to" in remark]
    size, _, where = said.removeprefix("a straight line of up to ").partition(" % of ")
    assert where.startswith("the rms (floor 2) ")
    assert float(size) == pytest.approx(200.0, rel=0.05)
    assert np.all(found.after.comparison.nrmse < 0.02)
    left_in = predict(estimate, dataclasses.replace(exact, runs=(Run(seen, run.excitation),)), detrend=False)
    assert left_in.after.comparison.nrmse[1] > 0.5
    assert not any("a straight line" in remark for remark in left_in.remarks)


def test_limits_have_probabilities(frame):
    experiment, estimate, truth = frame
    record = recorded(truth)
    drift = predict(estimate, record).peaks.values["story_drift_ratio"]
    limited = dataclasses.replace(experiment, limits=Limits([0.5 * drift.min(), 2 * drift.max()], ("low", "high")))
    found = predict(Models(None, dataclasses.replace(Fitted.of(estimate), experiment=limited)), record)
    np.testing.assert_allclose(found.passed, [[1.0] * 3, [0.0] * 3], atol=1e-3)
    assert [each["name"] for each in found.to_dict()["limits"]] == ["low", "high"]
    assert "limit low" in describe(found).headline
    bare = dataclasses.replace(limited, frame=dataclasses.replace(limited.frame, story_heights=None))
    found = predict(Models(None, dataclasses.replace(Fitted.of(estimate), experiment=bare)), record)
    assert found.passed is None
    assert found.to_dict()["limits"][0]["probability"] == [None] * 3
    assert any("the limits cannot be judged" in remark for remark in found.remarks)


def test_noise_on_the_record_of_the_same_frame_is_no_change_of_it(frame):
    """In a third of the records or more, noise moves the largest line of mode 2's flat peak by two to ten lines."""
    _, _, truth = frame
    moved = 0
    for noise, samples, records in ((0.02, 4000, 4), (0.1, 4000, 4), (0.1, 20_000, 2)):
        exact = recorded(truth, samples=samples)
        for seed in range(records):
            rng = np.random.default_rng(seed)
            run = exact.runs[0]
            seen = run.responses + noise * run.responses.std(axis=0) * rng.standard_normal(run.responses.shape)
            motion = DrivenRecord.of(dataclasses.replace(exact, runs=(Run(seen, run.excitation),)))
            beside = compared(truth, [response(truth, motion.runs[0], motion.step)], motion)
            assert beside.shifts == ()
            tops = [peak(side, truth.modes.frequencies, 1) for side in (beside.measured, beside.predicted)]
            moved += abs(tops[0] - tops[1]) > 2 * beside.measured.frequencies[1]
    assert moved >= 4


def test_a_measurement_predicts_as_its_closed_loop_does(frame):
    experiment, _, truth = frame
    record = recorded(truth)
    assert predict(experiment, record).to_dict() == predict(close_loop(experiment), record).to_dict()


def test_the_state_follows_the_added_mass(frame):
    _, estimate, truth = frame
    added = np.array([0.0, 1.0, 2.0])
    heavier = DampedModel(truth.M + np.diag(added), truth.C, truth.K, truth.gain)
    motion = DrivenRecord.of(recorded(heavier), added.tolist())
    found = predict(estimate, motion, detrend=False)
    assert found.configuration.name == "3 kg added"
    # The state names its tests. The prediction uses the test with the record's added mass.
    table = frame[0].to_dict()
    table["configuration"] = [{**each, "state": "frame"} for each in table["configuration"]]
    assert state_of(cvxshear.Experiment.from_dict(table), motion, "frame").name == "3 kg added"
    np.testing.assert_allclose(found.after.comparison.nrmse, 0, atol=1e-5)
    with pytest.raises(InputError, match="configuration must be one of configuration 1, not 'other'"):
        predict(estimate, motion, configuration="other")
    with pytest.raises(InputError, match="added_mass has 2 entries, the frame 3 stories"):
        predict(estimate, DrivenRecord.of(recorded(heavier), [1.0, 2.0]))


def test_forces_are_left_out_where_masses_have_no_scale(frame):
    _, estimate, truth = frame
    fitted = Fitted.of(estimate)
    unscaled = dataclasses.replace(fitted.experiment.frame, total_mass_placeholder=True)
    fitted = dataclasses.replace(fitted, experiment=dataclasses.replace(fitted.experiment, frame=unscaled))
    models = Models(None, fitted)
    said = predict(models, recorded(truth)).to_dict()
    assert said["peaks"]["base_shear"] is None
    assert said["peaks"]["story_shear_std"] is None
    assert said["peaks"]["story_drift"] is not None
    assert any("no scale" in remark for remark in said["remarks"])


def test_several_runs_and_some_floors(frame):
    _, estimate, truth = frame
    one = recorded(truth, floors=(1, 3))
    other = recorded(truth, floors=(1, 3), seed=9, samples=2000)
    both = TimeRecord(one.channels, runs=(*one.runs, *other.runs), sampling_rate=RATE, input="base")
    found = predict(estimate, both, detrend=False)
    np.testing.assert_allclose(found.after.comparison.nrmse, 0, atol=1e-5)
    assert found.after.comparison.floors.tolist() == [1, 3]
    single = [predict(estimate, each, detrend=False).peaks.values["floor_acceleration"] for each in (one, other)]
    np.testing.assert_allclose(found.peaks.values["floor_acceleration"], np.maximum(*single), rtol=1e-9)
    columns = series(found)
    assert np.bincount(columns["run"].astype(int)).tolist() == [0, 3000, 2000]
    assert columns["time"][3000] == 0


def test_a_record_of_another_frame(frame):
    _, estimate, _ = frame
    taller = DampedModel(*matrices(*damped_frame(4)), np.ones(4))
    with pytest.raises(InputError, match="shaken speaks of floor 4, the frame has 3 stories"):
        predict(estimate, recorded(taller, floors=(4,)))
    with pytest.raises(InputError, match="the model of a prediction is a file, an Experiment"):
        predict(3, recorded(taller, floors=(4,)))
    with pytest.raises(InputError, match="what drives a frame is a record file"):
        predict(estimate, 3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda y: 9.81 * y, "9.81 times as large as predicted"),
        (lambda y: y[:, [2, 1, 0]], "look swapped"),
        (lambda y: y, None),
    ],
)
def test_a_record_that_contradicts_the_model_in_one_thing_says_so(frame, change, said):
    _, estimate, truth = frame
    record = recorded(truth)
    run = record.runs[0]
    found = predict(estimate, dataclasses.replace(record, runs=(Run(change(run.responses), run.excitation),)))
    remarks = " ".join(found.remarks)
    assert "times as large" not in remarks if said is None else said in remarks


def test_a_floor_with_a_gap_is_not_compared_and_that_is_said(frame):
    _, estimate, truth = frame
    record = recorded(truth)
    seen = record.runs[0].responses.copy()
    seen[500:600, 0] = np.nan
    motion = DrivenRecord((DrivenRun(record.runs[0].excitation, 0, seen),), RATE, floors=np.array([1, 2, 3]))
    found = predict(estimate, motion)
    assert found.after.comparison.floors.tolist() == [2, 3]
    assert sum(remark.startswith("samples of floor 1 are missing: not compared") for remark in found.remarks) == 1
    whole = predict(estimate, record)
    assert not any("not compared" in remark for remark in whole.remarks)


@pytest.mark.parametrize(
    ("signs", "said"), [([1, -1, 1], "floor 2.*is reversed.*turned round"), ([-1, -1, -1], "is reversed.*turned round")]
)
def test_a_reversed_sensor_is_turned_round_before_it_is_compared(frame, signs, said):
    """`predict` restores the lost sign before the comparison, like `reconstruct`."""
    _, estimate, truth = frame
    record = recorded(truth)
    run = record.runs[0]
    right = predict(estimate, record).after.comparison
    found = predict(estimate, dataclasses.replace(record, runs=(Run(run.responses * signs, run.excitation),)))
    assert re.search(said, found.remarks[0])
    np.testing.assert_allclose(found.after.comparison.nrmse, right.nrmse, rtol=1e-6)
    assert not any("moved against the prediction" in remark for remark in found.remarks)


def test_a_record_of_a_changed_state_predicts_that_state():
    """The first story is 20 % softer in the second state; a record with a state gets the prediction of this state."""
    mass, stiffness, dashpots = damped_frame(3)
    softer = stiffness * [0.8, 1.0, 1.0]
    M, C, K = matrices(mass, softer, dashpots)
    after = DampedModel(M, C, K, np.ones(3), np.full(3, 3.0))
    ratios = [pole_ratios(*matrices(mass, k, dashpots)) for k in (stiffness, softer)]
    options = {"shape_std": 0.002, "frequency_std": 0.0005, "ratio_std": 1e-3}
    tables = [declared(mass, k, ratio, **options) for k, ratio in zip((stiffness, softer), ratios, strict=True)]
    states = [{**table["configuration"][0], "name": name, "state": name}
              for table, name in zip(tables, ("before", "after"), strict=True)]  # fmt: skip
    experiment = cvxshear.Experiment.from_dict({**tables[0], "configuration": states})
    change = LocatedEffect(effects.named(["story_change"])[0], effects.Place(None, 1, "after"))
    pair = Models(None, Fitted.of(efficient(experiment, backends.get("auto"), [change])))
    record = recorded(after)
    found = predict(pair, DrivenRecord.of(record, state="after"), damping="modal")
    assert found.configuration.name == "after"
    assert np.all(found.after.comparison.nrmse < 0.1)
    unnamed = predict(pair, DrivenRecord.of(record))
    assert np.all(unnamed.after.comparison.nrmse > 0.3)
    assert any("the record names no state" in remark for remark in unnamed.remarks)
    asked = predict(pair, DrivenRecord.of(record), configuration="before")
    assert not any("the record names no state" in remark for remark in asked.remarks)
    (other,) = (said for said in predict(pair, DrivenRecord.of(record, state="after"), configuration="before").remarks
                if "the record is of state" in said)  # fmt: skip
    assert other == 'the record is of state "after", the model that of "before", as asked'
    # The remark names only effects that act in the predicted state.
    assert "by the shear model with story change at story 1" in describe(found)["how"].parts[0].text
    assert "story 1" not in describe(asked)["how"].parts[0].text
    with pytest.raises(InputError, match='recorded in state "later", the model knows "before" and "after"'):
        predict(pair, DrivenRecord.of(record, state="later"))


def test_drifts_have_bands_over_time(frame):
    _, estimate, truth = frame
    found = predict(estimate, recorded(truth))
    drift = found.after.responses[0].drift
    at = np.argmax(np.abs(drift), axis=0)
    band = found.std[0]["story_drift"][at, np.arange(3)]
    np.testing.assert_allclose(band, found.peaks.std["story_drift"], rtol=0.5)
    assert "drift_std_1" in series(found)


def test_base_motion_needs_no_scale_of_the_masses(frame, tmp_path):
    experiment, _, truth = frame
    table = experiment.to_dict()
    del table["frame"]["total_mass"]
    write_measurement(tmp_path / "unscaled.toml", table)
    record = recorded(truth)
    found = predict(tmp_path / "unscaled.toml", record)
    assert found.peaks.to_dict()["base_shear"] is None
    np.testing.assert_allclose(found.after.comparison.nrmse, 0, atol=0.02)


def test_deviations_of_peaks_hold_what_the_record_shows_of_its_errors(frame):
    """The ground sensor has noise of 10 % of its rms; a frame known to 0.01 % cannot explain the misfit."""
    _, rough, truth = frame
    precise = {"frequency_std": 1e-4, "shape_std": 2e-4, "ratio_std": 1e-3, "damping": {"kind": "story"}}
    estimate = efficient(cvxshear.Experiment.from_dict(damped_measurement(3, **precise)), backends.get("auto"))
    exact = recorded(truth, floors=(1, 3))
    run = exact.runs[0]
    true = np.abs(response(truth, DrivenRun(run.excitation), 1 / RATE).drift).max(axis=0)
    off, alone = [], []
    for seed in range(8):
        noise = 0.1 * run.excitation.std() * np.random.default_rng(seed).standard_normal(len(run.excitation))
        noisy = Run(run.responses, run.excitation + noise)
        seen = predict(estimate, dataclasses.replace(exact, runs=(noisy,)), detrend=False)
        bare = predict(estimate, DrivenRecord((DrivenRun(noisy.excitation),), RATE), detrend=False)
        error = seen.peaks.values["story_drift"] - true
        off.append(error / seen.peaks.std["story_drift"])
        alone.append(error / bare.peaks.std["story_drift"])
        assert bare.missed is None
    assert np.mean(np.abs(alone) < 1.96) < 0.7
    assert np.mean(np.abs(off) < 1.96) > 0.9
    said = describe(seen)["peaks"].parts[-1].text
    assert f"{100 * seen.missed:.1f} % of each peak, by which the accelerations of floors 1, 3 in" in said
    assert "not the noise of the measured excitation" in describe(bare)["peaks"].parts[-1].text
    # If the frame explains the whole misfit, the deviations stay.
    well = predict(rough, exact, detrend=False)
    assert well.missed < 1e-4
    assert "uncertain and < 0.1 % of each peak" in describe(well)["peaks"].parts[-1].text


def test_deviations_hold_how_the_ground_moved_between_its_samples(frame):
    """The ground is band-limited with six samples per period of the highest mode; the truth has 8 times finer steps."""
    _, estimate, truth = frame
    low = signal.butter(8, 18.0, fs=RATE, output="sos")
    excitation = signal.sosfiltfilt(low, shaking(3000, 1 / RATE))
    found = predict(estimate, DrivenRecord((DrivenRun(excitation),), RATE), detrend=False)
    fine = response(truth, DrivenRun(signal.resample_poly(excitation, 8, 1)), 1 / (8 * RATE))
    exact = np.abs(fine.acceleration[::8]).max(axis=0)
    off = np.abs(found.peaks.values["floor_acceleration"] - exact)
    assert np.max(off / exact) > 0.01
    assert np.all(off < 2 * found.peaks.std["floor_acceleration"])
    assert any(remark.startswith("between its samples") for remark in found.remarks)
    smooth = predict(estimate, DrivenRecord((DrivenRun(excitation),), RATE).band_limited(), detrend=False)
    np.testing.assert_allclose(smooth.peaks.values["floor_acceleration"], exact, rtol=2e-3)
