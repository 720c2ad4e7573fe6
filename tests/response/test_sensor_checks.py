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
from cvxshear.response.recording import corrected, cut, on_time, parted, recording_of, whole_pieces
from cvxshear.response.uncertain import UncertainFrame


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


CHANNELS = Channel("a", 1), Channel("b", 2), Channel("d", 3)


def sensors(**more):
    """Return slow sines of three channels at 100 Hz: a run and a shorter one."""
    time = np.arange(600) / 100
    runs = [np.column_stack([np.sin(7 * time + k) for k in range(3)]) for k in (0.0, 1.0)]
    both = DrivenRun(np.ones(600), 0, runs[0], "r"), DrivenRun(2 * np.ones(300), 0, runs[1][:300], "s")
    return DrivenRecord(both, 100.0, "base", np.array([1, 2, 3]), **more)


def told(kind, message, **numbers):
    return Finding(kind, message, numbers)


def test_what_is_found_for_sure_is_taken_out_and_all_of_it_is_said():
    record = sensors(remarks=("before",))
    pieces = [(0, slice(0, 600)), (1, slice(0, 300))]
    findings = [
        told("dead channel", "a is dead", channel="a"),
        told("sign", "d is reversed", channel="c + d", corrected=True),
        told("unit", "b in g", channel="b", factor=9.8, corrected=True),
        told("unit", "perhaps", channel="d", factor=3.0, corrected=False),
        told("sign", "the ground is reversed", channel="input", corrected=True),
        told("direction", "askew", channels=["d"]),
        told("spikes", "never said", channel="d"),
    ]
    channels, found = corrected(CHANNELS, record, findings, pieces)
    assert [each.name for each in channels] == ["b", "d"]
    said = "before", "a is dead", "d is reversed", "b in g", "perhaps", "the ground is reversed", "askew"
    assert found.remarks == said
    for before, after in zip(record.runs, found.runs, strict=True):
        np.testing.assert_allclose(after.measured, before.measured[:, 1:] * [9.8, -1.0])
    np.testing.assert_allclose(found.runs[1].excitation, -2.0)


def test_exchanged_channels_change_their_floors():
    exchanged = told("swapped channels", "a and d are exchanged", channels=["a", "d"], corrected=True)
    perhaps = told("swapped channels", "perhaps", channels=["a", "b"], corrected=False)
    _, found = corrected(CHANNELS, sensors(), [exchanged, perhaps], [])
    assert found.floors.tolist() == [3, 2, 1]
    assert found.remarks == ("a and d are exchanged", "perhaps")


def test_clocks_that_drift_do_so_over_all_runs_and_a_late_input_is_early_sensors():
    record = sensors()
    drift = told("clock drift", "a drifts", channel="a", seconds=0.01, drift=0.002)
    late = told("clock offset", "the ground is late", channel="input", seconds=0.02, corrected=True)
    not_sure = told("clock drift", "perhaps", channel="b", seconds=0.5, drift=1.0, corrected=False)
    _, found = corrected(CHANNELS, record, [drift, late, not_sure], [])
    assert found.remarks == ("a drifts; taken out", "the ground is late; taken out", "perhaps")
    # The second run begins six seconds after the first.
    time = np.arange(300) / 100
    inner = slice(100, 200)
    moved = np.sin(7 * (time - 0.01 + 0.002 * (6.0 + time)))
    np.testing.assert_allclose(found.runs[1].measured[inner, 0], moved[inner], atol=1e-4)
    np.testing.assert_allclose(found.runs[1].measured[inner, 1], np.sin(7 * (time - 0.02) + 1.0)[inner], atol=1e-4)
    # Samples whose interpolation needs samples beyond the ends are missing.
    same = on_time(record, np.array([[1e-12, 0.0], [0.0, 0.0], [0.0, 0.0]])).runs[0].measured
    assert np.isnan(same).sum(axis=0).tolist() == [48, 0, 0]
    np.testing.assert_allclose(same[inner], record.runs[0].measured[inner], atol=1e-9)


def test_pieces_are_stretches_in_which_all_recorded_that_are_long_enough():
    samples = 4 * FEWEST_SAMPLES
    values = np.random.default_rng(1).standard_normal((samples, 2))
    values[FEWEST_SAMPLES, 0] = np.nan
    values[[2 * FEWEST_SAMPLES + 5, samples - 10], 1] = np.nan
    excitation = np.ones(samples)

    def pieces(excitation):
        runs = DrivenRun(excitation, 0, values), DrivenRun(excitation[:5], 0, values[:5])
        record = DrivenRecord(runs, 100.0, "base", np.array([1, 2]))
        return [(place, part.start, part.stop) for place, part in whole_pieces(record)]

    expected = [(0, 0, FEWEST_SAMPLES), (0, FEWEST_SAMPLES + 1, 2 * FEWEST_SAMPLES + 5),
                (0, 2 * FEWEST_SAMPLES + 6, samples - 10)]  # fmt: skip
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
        pieces = parted(DrivenRun(np.zeros(200), 0, measured), least)
        assert [part.start for part, _ in pieces[1:]] == [part.stop for part, _ in pieces[:-1]]
        found = np.concatenate([np.tile(seen, (part.stop - part.start, 1)) for part, seen in pieces])
        np.testing.assert_array_equal(found, recorded)
        assert all((before != after).any() for (_, before), (_, after) in itertools.pairwise(pieces))


def test_a_record_is_cut_and_does_without_channels():
    rng = np.random.default_rng(5)
    runs = [DrivenRun(rng.standard_normal(count), 2, rng.standard_normal((count, 2)), name) for count, name in
            ((40, "a"), (30, "b"))]  # fmt: skip
    whole = DrivenRecord(tuple(runs), 50.0, "force", np.array([1, 3]))
    assert (whole.step, whole.seconds) == (0.02, pytest.approx(1.4))
    run = whole.runs[0]
    np.testing.assert_array_equal(run.drive, np.column_stack([run.excitation, run.excitation]))
    limited = whole.band_limited()
    np.testing.assert_allclose(limited.runs[1].drive[:, 0], band_limited(whole.runs[1].excitation))
    np.testing.assert_array_equal(limited.runs[1].drive[:, 1], whole.runs[1].excitation)
    parts = [slice(3, 20), slice(0, 30)]
    found = cut(limited, np.array([False, True]), parts)
    assert found.floors.tolist() == [1, 3]
    for own, before, part in zip(found.runs, limited.runs, parts, strict=True):
        np.testing.assert_array_equal(own.measured[:, 1], before.measured[part, 1])
        assert np.isnan(own.measured[:, 0]).all()
        np.testing.assert_array_equal(own.drive, before.drive[part])
        assert own.name == before.name
    np.testing.assert_allclose(
        whole.rms()[1:], np.sqrt(np.mean(np.concatenate([run.measured for run in whole.runs]) ** 2, axis=0))
    )


@pytest.mark.parametrize("driven", ["base", "force"])
def test_records_and_motions_are_read_alike(monkeypatch, driven):
    """A record without a long stretch has sensors that were not examined, and a remark."""
    monkeypatch.setattr("cvxshear.response.recording.whole_pieces", lambda record: [])
    rng = np.random.default_rng(6)
    y, drive = rng.standard_normal((200, 2)), rng.standard_normal(200)
    floor = 2 if driven == "force" else 0
    channels = Channel("a", 1), Channel("b", 3)
    record = TimeRecord(channels, runs=(Run(y, drive, floor, "r"),), sampling_rate=50.0, input=driven)
    motion = DrivenRecord((DrivenRun(drive, floor, y, "r"),), 50.0, driven, np.array([1, 3]))
    for each in (recording_of(record), recording_of(motion)):
        (run,) = each.runs
        assert (each.input, each.floors.tolist(), each.sampling_rate) == (driven, [1, 3], 50.0)
        assert (run.floor, run.name) == (floor, "r")
        np.testing.assert_array_equal(run.measured, y)
        np.testing.assert_array_equal(run.excitation, drive)
        assert each.remarks[0].startswith("signs and clocks of the sensors were not checked")
    assert recording_of(dataclasses.replace(record, quantity="velocity")).floors.size == 0
