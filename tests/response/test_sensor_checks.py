"""Test statements on sensors and record strength against plain sums, and substitutes for missing inputs."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from cvxshear.records.data_frames import FEWEST_SAMPLES
from cvxshear.records.motion import DrivenRecord, DrivenRun, band_limited
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.response.recording import RecordedRun, Recording, SensorRecord, earlier, recording_of, sensor_line
from cvxshear.response.sensor_checks import widening
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.util.errors import InputError


def test_bands_are_widened_by_what_sensors_missed():
    def check(error):
        return SimpleNamespace(error=error, stated=2.0)

    assert widening([]) == widening([check(1.0), check(1.5)]) == 1.0
    assert widening([check(6.0), check(2.0)]) == pytest.approx(np.sqrt(5.0))


def test_the_envelope_is_the_strength_around_a_sample_in_powers_of_two():
    """The motion is four times stronger in its second half; a gap takes the strength of its neighbors."""
    period, rate = 0.5, 100.0
    half = 10 * round(4.0 * period * rate)
    motion = np.repeat([1.0, 4.0], half) * np.tile([1.0, -1.0], half)
    measured = np.column_stack([motion, 3.0 * motion])
    measured[half // 2 : half // 2 + 5] = np.nan
    quiet = np.column_stack([np.tile([1e-9, -1e-9], 500)] * 2)
    recording = Recording(
        (RecordedRun(measured, np.zeros(2 * half), "a"), RecordedRun(quiet, np.zeros(1000), "b")),
        rate,
        np.array([1, 3]),
        "base",
    )
    strong, weak = recording.envelopes(period)
    # Mean squares of each run, and of all samples together.
    whole = (half + 16 * half) / (2 * half + 1000)
    for place, level in ((half // 2, 1.0), (half // 4, 1.0), (half + half // 2, 4.0)):
        assert strong[place] == 2.0 ** np.round(np.log2(level / np.sqrt(whole)))
    assert np.all(weak == 1 / 16)


@pytest.fixture
def uncertain():
    """Return three masses, three stiffnesses and an effect with a full joint covariance."""
    root = np.random.default_rng(1).standard_normal((7, 7)) * [1, 1, 1, 50, 60, 70, 0.1]
    theta = np.array([10.0, 9.0, 8.0, 2e3, 3e3, 2.5e3, 0.4])
    fitted = SimpleNamespace(
        experiment=SimpleNamespace(stories=3), covariance=root.T @ root, theta=theta, misfit=1.7, root=None
    )
    return SimpleNamespace(fitted=fitted)


def test_stiffnesses_given_the_rest_have_the_inverse_of_their_block_of_the_precision(uncertain):
    found = UncertainFrame.conditional_stiffness(uncertain)
    k = uncertain.fitted.theta[3:6]
    given = np.linalg.inv(np.linalg.inv(uncertain.fitted.covariance)[3:6, 3:6])
    np.testing.assert_allclose(found, 1.7 * given / np.outer(k, k), rtol=1e-6)
    uncertain.fitted.covariance = None
    np.testing.assert_array_equal(UncertainFrame.conditional_stiffness(uncertain), np.zeros((3, 3)))
    assert UncertainFrame.nuisance_root(uncertain).shape == (7, 0)


def test_masses_and_effects_take_the_stiffnesses_along(uncertain):
    """L L' is the covariance of masses and effects; each column carries the regression of the stiffnesses."""
    L = UncertainFrame.nuisance_root(uncertain)
    C, rest = uncertain.fitted.covariance, [0, 1, 2, 6]
    np.testing.assert_allclose(L[rest] @ L[rest].T, 1.7 * C[np.ix_(rest, rest)], rtol=1e-9)
    regression = np.linalg.solve(C[np.ix_(rest, rest)], C[rest][:, 3:6]).T
    np.testing.assert_allclose(L[3:6], regression @ L[rest], rtol=1e-7)


def test_a_known_total_takes_a_direction_of_the_masses_away(uncertain):
    keep = np.eye(7)
    keep[:3, :3] -= 1 / 3
    uncertain.fitted.covariance = keep @ uncertain.fitted.covariance @ keep
    L = UncertainFrame.nuisance_root(uncertain)
    assert L.shape == (7, 3)
    np.testing.assert_allclose(L[:3].sum(axis=0), 0.0, atol=1e-9)


def test_a_record_is_as_long_as_its_runs_together():
    runs = [RecordedRun(np.random.default_rng(n).standard_normal((n, 1)), np.zeros(n), f"{n}") for n in (300, 500)]
    assert Recording(tuple(runs), 200.0, np.array([2]), "base").seconds == pytest.approx(4.0)


def sensors(samples=600, **more):
    """Return three channels of slow sines at 100 Hz: a run and a shorter one."""
    time = np.arange(samples) / 100
    runs = [np.column_stack([np.sin(7 * time + k) for k in range(3)]) for k in (0.0, 1.0)]
    channels = Channel("a", 1), Channel("b", 2), Channel("d", 3)
    return SensorRecord(channels, (runs[0], runs[1][:300]), (np.ones(samples), 2 * np.ones(300)), 100.0, "base", **more)


def told(kind, message, **numbers):
    return Finding(kind, message, numbers)


def test_what_is_found_for_sure_is_taken_out_and_all_of_it_is_said():
    record = sensors(remarks=("before",))
    pieces = [(0, slice(0, 600)), (1, slice(0, 300))]
    found = record.corrected(
        [
            told("dead channel", "a is dead", channel="a"),
            told("sign", "b is reversed", channel="b + c", corrected=True),
            told("unit", "d in g", channel="d", factor=9.8, corrected=True),
            told("unit", "perhaps", channel="d", factor=3.0, corrected=False),
            told("sign", "the ground is reversed", channel="input", corrected=True),
            told("direction", "askew", channels=["d"]),
            told("spikes", "never said", channel="d"),
        ],
        pieces,
    )
    assert [each.name for each in found.channels] == ["b", "d"]
    said = "before", "a is dead", "b is reversed", "d in g", "perhaps", "the ground is reversed", "askew"
    assert found.remarks == said
    for before, after in zip(record.measured, found.measured, strict=True):
        np.testing.assert_allclose(after, before[:, 1:] * [-1.0, 9.8])
    np.testing.assert_allclose(found.excitations[1], -2.0)
    np.testing.assert_array_equal(found.late, np.zeros((2, 2)))
    assert found.late_remarks == ("", "")


@pytest.mark.parametrize(("seconds", "taken"), [(0.0026, True), (0.0024, False), (-0.0026, True)])
def test_a_delay_of_a_quarter_of_a_sample_is_taken_out(seconds, taken):
    found = sensors().corrected([told("clock offset", "d is late; taken out", channel="d", seconds=seconds)], [])
    assert found.late.tolist() == [[0.0, 0.0], [0.0, 0.0], [seconds * taken, 0.0]]
    assert found.late_remarks == ("", "", "d is late; taken out" if taken else "")
    assert found.remarks[0].endswith("; taken out" if taken else "so short a delay may be chance and is left in")
    time = np.arange(600) / 100
    inner = slice(100, 500)
    np.testing.assert_allclose(found.measured[0][inner, 2], np.sin(7 * (time + taken * seconds) + 2)[inner], atol=1e-4)


def test_clocks_that_drift_do_so_over_all_runs_and_a_late_input_is_early_sensors():
    record = sensors()
    drift = told("clock drift", "a drifts", channel="a", seconds=0.01, drift=0.002)
    late = told("clock offset", "the ground is late", channel="input", seconds=0.02, corrected=True)
    not_sure = told("clock drift", "perhaps", channel="b", seconds=0.5, drift=1.0, corrected=False)
    found = record.corrected([drift, late, not_sure], [])
    np.testing.assert_allclose(found.late, [[-0.01, 0.002], [-0.02, 0.0], [-0.02, 0.0]])
    assert found.late_remarks == ("a drifts; taken out", *["the ground is late; taken out"] * 2)
    assert found.remarks[2] == "perhaps"
    # The second run begins six seconds after the first.
    time = np.arange(300) / 100
    inner = slice(100, 200)
    moved = np.sin(7 * (time - 0.01 + 0.002 * (6.0 + time)))
    np.testing.assert_allclose(found.measured[1][inner, 0], moved[inner], atol=1e-4)
    same = earlier(record.measured[0][:, 0], np.zeros(2), 100.0, 0)
    assert np.isnan(same).sum() == 48
    np.testing.assert_allclose(same[inner], record.measured[0][inner, 0], atol=1e-9)


def test_floors_have_the_motion_of_their_sensors_along_the_test():
    """Floor 2 has two sensors, one at 30 degrees; their projections are averaged, and a sensor across is omitted."""
    channels = Channel("a", 1, direction=90.0), Channel("b", 2), Channel("c", 2, direction=30.0), Channel("d", 5)
    measured = np.array([[9.0, 2.0, 3.0, 7.0], [9.0, np.nan, 3.0, 7.0]])
    record = SensorRecord(channels, (measured,), (np.zeros(2),), 100.0, "base")
    floors, motions, late, said = record.by_floor()
    assert floors.tolist() == [2, 5]
    np.testing.assert_allclose(motions[0], [[1.0 + 1.5 / np.cos(np.pi / 6), 7.0], [np.nan, 7.0]])
    assert (late.tolist(), said) == ([[0.0, 0.0], [0.0, 0.0]], ("", ""))
    delays = np.arange(8.0).reshape(4, 2)
    record = SensorRecord(channels, (measured,), (np.zeros(2),), 100.0, "base", late=delays, late_remarks=tuple("wxyz"))
    assert (record.by_floor()[2].tolist(), record.by_floor()[3]) == ([[2.0, 3.0], [6.0, 7.0]], ("x", "z"))


def test_pieces_are_stretches_in_which_all_recorded_that_are_long_enough():
    samples = 4 * FEWEST_SAMPLES
    values = np.random.default_rng(1).standard_normal((samples, 2))
    values[FEWEST_SAMPLES, 0] = np.nan
    values[2 * FEWEST_SAMPLES + 5, 1] = np.nan
    excitation = np.ones(samples)
    channels = Channel("a", 1), Channel("b", 2)

    def pieces(driven, excitation):
        found = SensorRecord(channels, (values, values[:5]), (excitation, excitation[:5]), 100.0, driven).pieces()
        return [(place, part.start, part.stop) for place, part in found]

    expected = [(0, 0, FEWEST_SAMPLES), (0, FEWEST_SAMPLES + 1, 2 * FEWEST_SAMPLES + 5),
                (0, 2 * FEWEST_SAMPLES + 6, samples)]  # fmt: skip
    assert pieces("base", excitation) == expected
    still = np.where(np.arange(samples) < FEWEST_SAMPLES, 0.0, 1.0)
    assert pieces("base", still) == expected[1:]
    assert pieces("none", still) == expected


def test_every_channel_counts_as_much_for_the_envelope_however_large_it_is():
    """Three channels grow sixteenfold, a larger one is steady: mean squares of 0.26 and 1.74 of the rms."""
    half = 2000
    sign = np.tile([1.0, -1.0], half)
    growing = np.repeat([1.0, 16.0], half) * sign
    measured = np.column_stack([growing, growing, 0.1 * growing, 300.0 * sign])
    recording = Recording((RecordedRun(measured, np.zeros(2 * half), "a"),), 100.0, np.array([1, 2, 3, 4]), "base")
    (found,) = recording.envelopes(0.5)
    assert (found[half // 2], found[half + half // 2]) == (0.5, 1.0)


def test_a_run_is_parted_at_its_long_gaps():
    """Each part has a constant set of recorded channels."""
    measured = np.ones((200, 2))
    gaps = [(5 + 20 * k, 5 + 20 * k + 3 + k, k % 2) for k in range(9)] + [(190, 200, 0)]
    for first, last, column in gaps:
        measured[first:last, column] = np.nan
    for least, left_out in ((7, gaps[4:]), (1, gaps), (12, [])):
        recorded = np.ones((200, 2), dtype=bool)
        for first, last, column in left_out:
            recorded[first:last, column] = False
        pieces = RecordedRun(measured, np.zeros(200), "").pieces(least)
        assert [part.start for part, _ in pieces[1:]] == [part.stop for part, _ in pieces[:-1]]
        found = np.concatenate([np.tile(seen, (part.stop - part.start, 1)) for part, seen in pieces])
        np.testing.assert_array_equal(found, recorded)
        assert all((before != after).any() for (_, before), (_, after) in itertools.pairwise(pieces))


def recorded(**more):
    rng = np.random.default_rng(5)
    runs = [RecordedRun(rng.standard_normal((count, 2)), rng.standard_normal(count), name, 2) for count, name in
            ((40, "a"), (30, "b"))]  # fmt: skip
    return Recording(tuple(runs), 50.0, np.array([1, 3]), "force", **more)


def test_a_recording_is_cut_and_does_without_channels():
    whole = recorded()
    assert (whole.force_floor, whole.step) == (2, 0.02)
    assert whole.without_base_line() is whole
    run = whole.runs[0]
    np.testing.assert_array_equal(run.drive, np.column_stack([run.excitation, run.excitation]))
    limited = whole.band_limited()
    np.testing.assert_allclose(limited.runs[1].drive[:, 0], band_limited(whole.runs[1].excitation))
    np.testing.assert_array_equal(limited.runs[1].drive[:, 1], whole.runs[1].excitation)
    parts = [slice(3, 20), slice(0, 30)]
    cut = limited.without(0).cut(parts)
    assert cut.floors.tolist() == [3]
    for own, before, part in zip(cut.runs, limited.runs, parts, strict=True):
        np.testing.assert_array_equal(own.measured, before.measured[part, 1:])
        np.testing.assert_array_equal(own.drive, before.drive[part])
        assert own.name == before.name
    np.testing.assert_allclose(
        whole.rms(), np.sqrt(np.mean(np.concatenate([run.measured for run in whole.runs]) ** 2, axis=0))
    )


def blocks_of(motion):
    """Count samples of four periods; the rms change between samples is 2 pi over a period times the rms."""
    return round(4 * 2 * np.pi * np.sqrt(np.mean(motion**2) / np.mean(np.diff(motion) ** 2)))


@pytest.mark.parametrize(("times", "kept"), [(3.9, False), (4.1, True)])
def test_a_line_is_the_sensors_beyond_four_deviations_of_the_mean(times, kept):
    """The deviation of the mean comes from sums over blocks of four periods."""
    time = np.linspace(-1.0, 1.0, 3000)
    motion = np.sin(0.3 * np.arange(3000)) * (1.5 + time)
    run = RecordedRun(np.column_stack([motion, motion + 1.0]), motion, "a")
    recording = Recording((run,), 100.0, np.array([1, 2]), "base")
    left = motion - np.polyval(np.polyfit(time, motion, 1), time)
    sums = np.add.reduceat(left, np.arange(0, 3000, blocks_of(left)))
    chance = np.linalg.norm(sums) / 3000
    size = slope_for(motion, time, times * chance)
    (found,) = recording.less([np.column_stack([-size * time, 0.0 * time])]).lines([np.zeros((3000, 2))])
    assert np.any(found[:, 0]) == kept
    np.testing.assert_allclose(found[:, 1].mean(), 1.0 + motion.mean(), atol=1e-6)


def slope_for(motion, time, largest):
    """Return the slope of an added line that gives the line through the motion this largest value."""
    slope, level = np.polyfit(time, motion, 1)
    return largest - abs(level) - slope


@pytest.mark.parametrize(("start", "weighed"), [(0.45, False), (0.55, True)])
def test_a_line_through_a_motion_that_begins_amid_is_weighed_by_what_is_quiet(start, weighed):
    """If the first sample has half of the rms or more, each sample is weighted by its inverse squared strength."""
    samples = 6000
    time = np.linspace(-1.0, 1.0, samples)
    strong = np.where(time < 0, start, np.sqrt(2 - start**2))
    motion = np.sqrt(2) * strong * np.sin(0.5 * np.arange(samples) + np.pi / 4) + 0.3 + 0.1 * time
    line = sensor_line(motion)
    plain = np.polyval(np.polyfit(time, motion, 1), time)
    width = blocks_of(motion - plain)
    sizes = np.sqrt(ndimage.uniform_filter1d((motion - plain) ** 2, width, mode="nearest"))
    weights = 1.0 / np.maximum(sizes, np.sqrt(np.mean((motion - plain) ** 2)) / 16)
    own = np.polyval(np.polyfit(time, motion, 1, w=weights), time)
    np.testing.assert_allclose(line, own if weighed else plain, atol=1e-9)
    assert np.max(np.abs(own - plain)) > 1e-5
    np.testing.assert_array_equal(sensor_line(np.zeros(50)), 0.0)


@pytest.mark.parametrize("driven", ["base", "force", "none"])
def test_records_and_motions_are_read_alike(monkeypatch, driven):
    """This test takes the sensors for sound; other tests cover their faults."""
    monkeypatch.setattr(SensorRecord, "set_right", lambda self, stories: self)
    rng = np.random.default_rng(6)
    y, drive = rng.standard_normal((200, 2)), rng.standard_normal(200)
    floor = 2 if driven == "force" else 0
    channels = Channel("a", 1), Channel("b", 3)
    own = None if driven == "none" else drive
    record = TimeRecord(channels, runs=(Run(y, own, floor, "r"),), sampling_rate=50.0, input=driven)
    found = [recording_of(record)]
    if driven != "none":
        found.append(recording_of(DrivenRecord((DrivenRun(drive, floor, y, "r"),), 50.0, driven, np.array([1, 3]))))
    for each in found:
        (run,) = each.runs
        assert (each.input, each.floors.tolist(), each.sampling_rate) == (driven, [1, 3], 50.0)
        assert (run.floor, run.name, each.force_floor) == (floor, "r", floor)
        np.testing.assert_array_equal(run.measured, y)
        np.testing.assert_array_equal(run.excitation, np.zeros(200) if driven == "none" else drive)
    if driven == "force":
        several = dataclasses.replace(record, runs=(Run(y, drive, 1, "r"), Run(y, drive, 2, "s")))
        with pytest.raises(InputError, match="the force acts on several floors"):
            recording_of(several)
        with pytest.raises(InputError, match="the floors' velocitys were recorded"):
            recording_of(dataclasses.replace(record, quantity="velocity"))
