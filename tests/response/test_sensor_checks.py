"""Test statements on sensors and record strength against plain sums, and substitutes for missing inputs."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from cvxshear.records.data_frames import FEWEST_SAMPLES
from cvxshear.records.motion import DrivenRecord, DrivenRun, band_limited
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.response.frame_motion import widening
from cvxshear.response.recording import RecordedRun, Recording, SensorRecord, earlier, recording_of
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.util.errors import InputError


def test_bands_are_widened_by_what_sensors_missed():
    def check(error):
        return SimpleNamespace(error=error, stated=2.0)

    assert widening([]) == widening([check(1.0), check(1.5)]) == 1.0
    assert widening([check(6.0), check(2.0)]) == pytest.approx(np.sqrt(5.0))


@pytest.fixture
def uncertain():
    """Return three masses, three stiffnesses and an effect with a full joint covariance."""
    root = np.random.default_rng(1).standard_normal((7, 7)) * [1, 1, 1, 50, 60, 70, 0.1]
    theta = np.array([10.0, 9.0, 8.0, 2e3, 3e3, 2.5e3, 0.4])
    fitted = SimpleNamespace(
        experiment=SimpleNamespace(stories=3), covariance=root.T @ root, theta=theta, misfit=1.7, root=None
    )
    return UncertainFrame(fitted, None, None, "modal", None)


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
    both = RecordedRun(runs[0], np.ones(samples), "r"), RecordedRun(runs[1][:300], 2 * np.ones(300), "s")
    return SensorRecord(channels, both, 100.0, "base", **more)


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
    for before, after in zip(record.runs, found.runs, strict=True):
        np.testing.assert_allclose(after.measured, before.measured[:, 1:] * [-1.0, 9.8])
    np.testing.assert_allclose(found.runs[1].excitation, -2.0)


def test_clocks_that_drift_do_so_over_all_runs_and_a_late_input_is_early_sensors():
    record = sensors()
    drift = told("clock drift", "a drifts", channel="a", seconds=0.01, drift=0.002)
    late = told("clock offset", "the ground is late", channel="input", seconds=0.02, corrected=True)
    not_sure = told("clock drift", "perhaps", channel="b", seconds=0.5, drift=1.0, corrected=False)
    found = record.corrected([drift, late, not_sure], [])
    assert found.remarks == ("a drifts; taken out", "the ground is late; taken out", "perhaps")
    # The second run begins six seconds after the first.
    time = np.arange(300) / 100
    inner = slice(100, 200)
    moved = np.sin(7 * (time - 0.01 + 0.002 * (6.0 + time)))
    np.testing.assert_allclose(found.runs[1].measured[inner, 0], moved[inner], atol=1e-4)
    np.testing.assert_allclose(found.runs[1].measured[inner, 1], np.sin(7 * (time - 0.02) + 1.0)[inner], atol=1e-4)
    same = earlier(record.runs[0].measured[:, 0], np.zeros(2), 100.0, 0)
    assert np.isnan(same).sum() == 48
    np.testing.assert_allclose(same[inner], record.runs[0].measured[inner, 0], atol=1e-9)


def test_floors_have_the_motion_of_their_sensors_along_the_test():
    """Floor 2 has two sensors, one at 30 degrees; their projections are averaged, and a sensor across is omitted."""
    channels = Channel("a", 1, direction=90.0), Channel("b", 2), Channel("c", 2, direction=30.0), Channel("d", 5)
    measured = np.array([[9.0, 2.0, 3.0, 7.0], [9.0, np.nan, 3.0, 7.0]])
    floors, (run,), firsts = SensorRecord(
        channels, (RecordedRun(measured, np.zeros(2), "r"),), 100.0, "base"
    ).by_floor()
    assert (floors.tolist(), firsts) == ([2, 5], [1, 3])
    np.testing.assert_allclose(run.measured, [[1.0 + 1.5 / np.cos(np.pi / 6), 7.0], [np.nan, 7.0]])


def test_pieces_are_stretches_in_which_all_recorded_that_are_long_enough():
    samples = 4 * FEWEST_SAMPLES
    values = np.random.default_rng(1).standard_normal((samples, 2))
    values[FEWEST_SAMPLES, 0] = np.nan
    values[2 * FEWEST_SAMPLES + 5, 1] = np.nan
    excitation = np.ones(samples)
    channels = Channel("a", 1), Channel("b", 2)

    def pieces(excitation):
        runs = RecordedRun(values, excitation, "r"), RecordedRun(values[:5], excitation[:5], "s")
        return [(place, part.start, part.stop) for place, part in SensorRecord(channels, runs, 100.0, "base").pieces()]

    expected = [(0, 0, FEWEST_SAMPLES), (0, FEWEST_SAMPLES + 1, 2 * FEWEST_SAMPLES + 5),
                (0, 2 * FEWEST_SAMPLES + 6, samples)]  # fmt: skip
    assert pieces(excitation) == expected
    still = np.where(np.arange(samples) < FEWEST_SAMPLES, 0.0, 1.0)
    assert pieces(still) == expected[1:]


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
    run = whole.runs[0]
    np.testing.assert_array_equal(run.drive, np.column_stack([run.excitation, run.excitation]))
    limited = whole.band_limited()
    np.testing.assert_allclose(limited.runs[1].drive[:, 0], band_limited(whole.runs[1].excitation))
    np.testing.assert_array_equal(limited.runs[1].drive[:, 1], whole.runs[1].excitation)
    parts = [slice(3, 20), slice(0, 30)]
    cut = limited.only(np.array([False, True])).cut(parts)
    assert cut.floors.tolist() == [1, 3]
    for own, before, part in zip(cut.runs, limited.runs, parts, strict=True):
        np.testing.assert_array_equal(own.measured[:, 1], before.measured[part, 1])
        assert np.isnan(own.measured[:, 0]).all()
        np.testing.assert_array_equal(own.drive, before.drive[part])
        assert own.name == before.name
    np.testing.assert_allclose(
        whole.rms(), np.sqrt(np.mean(np.concatenate([run.measured for run in whole.runs]) ** 2, axis=0))
    )


@pytest.mark.parametrize("driven", ["base", "force"])
def test_records_and_motions_are_read_alike(monkeypatch, driven):
    """This test takes the sensors for sound; other tests cover their faults."""
    monkeypatch.setattr(SensorRecord, "set_right", lambda self, stories: self)
    rng = np.random.default_rng(6)
    y, drive = rng.standard_normal((200, 2)), rng.standard_normal(200)
    floor = 2 if driven == "force" else 0
    channels = Channel("a", 1), Channel("b", 3)
    record = TimeRecord(channels, runs=(Run(y, drive, floor, "r"),), sampling_rate=50.0, input=driven)
    motion = DrivenRecord((DrivenRun(drive, floor, y, "r"),), 50.0, driven, np.array([1, 3]))
    for each in (recording_of(record), recording_of(motion)):
        (run,) = each.runs
        assert (each.input, each.floors.tolist(), each.sampling_rate) == (driven, [1, 3], 50.0)
        assert (run.floor, run.name, each.force_floor) == (floor, "r", floor)
        np.testing.assert_array_equal(run.measured, y)
        np.testing.assert_array_equal(run.excitation, drive)
    if driven == "force":
        several = dataclasses.replace(record, runs=(Run(y, drive, 1, "r"), Run(y, drive, 2, "s")))
        with pytest.raises(InputError, match="the force acts on several floors"):
            recording_of(several)
        with pytest.raises(InputError, match="the floors' velocitys were recorded"):
            recording_of(dataclasses.replace(record, quantity="velocity"))
