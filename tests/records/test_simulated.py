"""Test modes of exactly integrated records of a known frame; expected values come from the issue."""

import itertools

import numpy as np
import pytest
from scipy import signal

import cvxshear
from cvxshear.records import Channel, Run, TimeRecord, identify_modes
from cvxshear.records.estimate import independent_std, jackknife
from cvxshear.records.picking import possible_changes, sign_changes
from cvxshear.records.prepare import only, source_of
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, ambient_record, base_record, hammer_record
from tests.records.shared import SEEDS, TWO_STORY_FREQUENCIES, TWO_STORY_RATIOS
from tests.response.common import integrated, matrices
from tests.studies.records import scatter

PAPER_FREQUENCIES = [1.0336, 2.2099, 3.2812]
"""Frequencies printed in the paper."""


def test_known_frame_has_the_papers_frequencies():
    np.testing.assert_allclose(PAPER_FRAME.modes()[0], PAPER_FREQUENCIES, atol=5e-5)


def test_integration_agrees_with_a_general_solver():
    force = np.interp(0.01 * np.arange(400), [0, 0.5, 1.2, 4], [0, 30, -20, 5])
    frequencies, shapes = PAPER_FRAME.modes()
    M = np.diag(PAPER_FRAME.masses)
    damper = M @ shapes.T @ np.diag(4 * np.pi * 0.01 * frequencies) @ shapes @ M
    low, top = (integrated(M, damper, PAPER_FRAME.stiffness, force, 0.01, floor)[0] for floor in (1, 3))
    found = PAPER_FRAME.accelerations(np.column_stack([force, 0 * force, -0.5 * force]), 0.01)
    np.testing.assert_allclose(found, low - 0.5 * top, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("hits", [2, 4])
def test_a_floor_that_loses_a_hit_counts_as_much_as_before(hits):
    """Without noise, the remaining hits give the same matrix except for the positions of blows between samples."""
    record = hammer_record(PAPER_FRAME, 2, noise=0.0, floors=(1, 3), hits=hits)
    source = source_of(record, "era")
    whole = source.factor()
    for left_out in range(len(record.runs)):
        part = source.factor(np.arange(len(record.runs)) != left_out)
        np.testing.assert_allclose(part @ part.T, whole @ whole.T, atol=0.02 * np.abs(whole @ whole.T).max())


@pytest.mark.parametrize("noise", [0.01, 0.05])
@pytest.mark.parametrize("kind", ["hammer", "base"])
def test_accuracy_with_measured_input(kind: str, noise: float):
    found = scatter(kind, noise=noise, seeds=SEEDS, **({"hits": 3} if kind == "hammer" else {}))
    assert found.frequency_errors.shape == (SEEDS, 3)
    assert np.abs(found.frequency_errors).max() < 0.0002
    assert np.abs(found.shape_errors).max() < 0.008


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_accuracy_of_twenty_ambient_minutes(noise: float):
    """Frequencies have a root mean square error of 0.2 %; single ones have the scatter of any estimator.

    The variance of a frequency from a long ambient record is at least f^2 zeta / (2 pi f T) (Au 2014,
    "Uncertainty law in ambient modal identification", MSSP 48): 0.11, 0.08, 0.06 % here.
    """
    found = scatter("ambient", noise=noise, seeds=SEEDS)
    least = np.sqrt(0.01 / (2 * np.pi * np.array(PAPER_FREQUENCIES) * 1200))
    assert np.sqrt(np.mean(found.frequency_errors**2)) < 0.002
    assert np.all(np.abs(found.frequency_errors) < 3.5 * least)
    assert np.abs(found.shape_errors).max() < 0.02


def test_stated_deviations_hold():
    # The deviation ratio of eight short records scatters by a quarter. The median of nine ratios scatters less.
    found = scatter("base", noise=0.05, seeds=8, duration=120.0)
    frequency, shape = found.stated_over_seen()
    ratios = np.concatenate([frequency, shape[np.isfinite(shape)]])
    assert len(ratios) == 9
    assert 0.7 < np.median(ratios) < 1.5


def test_damping_is_found():
    result = identify_modes(base_record(PAPER_FRAME, 3, noise=0.01, duration=600.0))
    np.testing.assert_allclose(result.damping_ratios, 0.01, rtol=0.03)
    assert np.all(np.abs(result.damping_ratios - 0.01) < 4 * result.damping_std)


@pytest.mark.parametrize(
    ("maker", "frame"),
    [(hammer_record, None), (base_record, {"total_mass": 22.5}), (ambient_record, {"total_mass": 22.5})],
)
def test_from_record_to_masses(maker, frame):
    result = identify_modes(maker(PAPER_FRAME, 11, noise=0.05))
    assert result.mass_normalized is (frame is None)
    experiment = cvxshear.Experiment.from_dict(result.to_experiment(frame))
    identified = cvxshear.identify(experiment, method="efficient").to_dict()["frame"]
    mass, stiffness = np.array(identified["floor_mass"]), np.array(identified["story_stiffness"])
    assert np.all(np.abs(mass - [10, 7.5, 5]) < 3 * np.array(identified["floor_mass_std"]))
    assert np.all(np.abs(stiffness - [1800, 1200, 600]) < 3 * np.array(identified["story_stiffness_std"]))
    np.testing.assert_allclose(mass, [10, 7.5, 5], rtol=0.02)


def two_story_decay(seed: int, noise: float, window: float | None = None) -> TimeRecord:
    """Return the two-story frame's free decay in both modes, with 0.5 % damping, in closed form."""
    time = np.arange(4000) / 100.0
    omega = 2 * np.pi * TWO_STORY_FREQUENCIES
    modal = np.exp(-0.005 * omega * time[:, None]) * np.cos(omega * np.sqrt(1 - 0.005**2) * time[:, None] + [0.3, 1.1])
    values = modal @ np.column_stack([TWO_STORY_RATIOS, [1.0, 1.0]])
    values = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    if window is not None:
        values = values * np.exp(-time / window)[:, None]
    channels = (Channel("a1", 1), Channel("a2", 2))
    return TimeRecord(channels, runs=(Run(values),), sampling_rate=100.0, input="free_decay", exponential_window=window)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_free_decay(noise: float):
    result = identify_modes(two_story_decay(5, noise))
    np.testing.assert_allclose(result.frequencies, TWO_STORY_FREQUENCIES, rtol=2e-4)
    np.testing.assert_allclose(result.mode_shapes[:, 0] / result.mode_shapes[:, 1], TWO_STORY_RATIOS, rtol=5e-3)
    np.testing.assert_allclose(result.damping_ratios, 0.005, rtol=0.02)
    assert not result.mass_normalized


def test_exponential_window_is_taken_out():
    result = identify_modes(two_story_decay(6, 0.002, window=4.0))
    np.testing.assert_allclose(result.damping_ratios, 0.005, rtol=0.05)
    np.testing.assert_allclose(result.frequencies, TWO_STORY_FREQUENCIES, rtol=3e-4)


@pytest.mark.parametrize("seed", range(SEEDS))
def test_modes_that_a_soft_hammer_hardly_reaches_are_not_bent(seed):
    """The blow's spectrum vanishes at 15 Hz and is 0.15 % of its maximum at the highest mode, 14.1 Hz."""
    frame = KnownFrame(np.full(5, 10.0), np.full(5, 21400.0), 0.01)
    frequencies, _ = frame.modes()
    assert 14.0 < frequencies[-1] < 14.2
    result = identify_modes(hammer_record(frame, seed, noise=0.02, floors=(1, 5), duration=40.0, sampling_rate=37.0))
    assert result.modes.tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(result.frequencies, frequencies, rtol=3e-4)
    np.testing.assert_allclose(result.damping_ratios, 0.01, atol=6e-4)


def test_pieces_that_tell_more_weigh_more_in_the_jackknife():
    """The weighted mean of values with variance 1 / weight has the variance 1 / (sum of the weights)."""
    random = np.random.default_rng(3)
    weights = np.array([1.0, 2.0, 4.0, 8.0, 3.0, 5.0])
    groups = np.array([0, 0, 0, 0, 1, 1])
    found = []
    for _ in range(2000):
        values = random.standard_normal(6) / np.sqrt(weights)

        def means(keep, values=values):
            parts = [keep & (groups == group) for group in (0, 1)]
            each = [np.average(values[part], weights=weights[part]) for part in parts]
            return np.array([each[0], each[1], each[0] + each[1]])

        covariance, freedom, lost = jackknife(means, groups, weights)
        found.append(np.diag(covariance))
        assert lost == 0
    expected = np.array([1 / 15, 1 / 8, 1 / 15 + 1 / 8])
    np.testing.assert_allclose(np.mean(found, axis=0), expected, rtol=0.1)
    # A chi-square with n degrees of freedom has the variance 2 n.
    np.testing.assert_allclose(freedom[:2], 2 * expected[:2] ** 2 / np.var(found, axis=0)[:2], rtol=0.2)
    assert 1 <= freedom[2] <= 4


@pytest.mark.parametrize(
    ("hits", "how"), [(3, "jackknife over 9 hits"), (1, "jackknife over 3 driving points, at least 20 surrogates'")]
)
def test_the_scatter_of_few_hits_does_not_stand_alone(hits, how):
    """There are three driving points; surrogates can only increase a deviation."""
    result = identify_modes(hammer_record(PAPER_FRAME, 4, noise=0.01, hits=hits, duration=40.0))
    assert result.to_dict()["uncertainty"] == how
    # The scale of a mode is the error of its largest entry; independent errors of n entries average to it.
    shapes = result.mode_shapes / np.abs(result.mode_shapes).max(axis=1, keepdims=True)
    blocks = [result.covariance[row : row + 3, row : row + 3] for row in (3, 6, 9)]
    places = np.arange(3, 12, 3) + np.abs(shapes).argmax(axis=1)
    scales = result.covariance[np.ix_(places, places)]
    common = np.outer(np.diag(scales), [3 * max(1.0, scales.sum() / np.trace(scales))]) * shapes**2
    own = [independent_std(block, shape) for block, shape in zip(blocks, shapes, strict=True)]
    np.testing.assert_allclose(result.entry_std, np.sqrt(np.square(own) + common))


def test_a_band_decimates_and_keeps_the_modes():
    record = base_record(PAPER_FRAME, 2, noise=0.01, duration=200.0, sampling_rate=60.0)
    wide = identify_modes(record)
    narrow = identify_modes(
        TimeRecord(record.channels, band=(0.2, 6.0), runs=record.runs, sampling_rate=60.0, input="base")
    )
    np.testing.assert_allclose(narrow.frequencies, PAPER_FREQUENCIES, rtol=5e-4)
    np.testing.assert_allclose(wide.frequencies, PAPER_FREQUENCIES, rtol=5e-4)


def test_a_tall_frame_has_all_its_modes_each_with_its_number():
    """Twelve modes require more than thirty states; some entries of the highest modes are hardly above the noise."""
    frame = KnownFrame(np.full(12, 10.0), np.linspace(40000.0, 25000.0, 12), 0.01)
    result = identify_modes(base_record(frame, 1, noise=0.02, duration=300.0, sampling_rate=50.0))
    assert result.modes.tolist() == list(range(1, 13))
    np.testing.assert_allclose(result.frequencies, frame.modes()[0], rtol=5e-4)


@pytest.mark.parametrize("seed", range(20))
def test_changes_of_sign_where_small_entries_can_have_either(seed):
    shape = np.random.default_rng(seed).standard_normal(7)
    unsure = np.abs(shape) <= 0.4 * np.abs(shape).max()
    counts = [
        sign_changes(np.where(unsure, np.abs(shape) * signs, shape)) for signs in itertools.product((-1, 1), repeat=7)
    ]
    assert possible_changes(shape, 0.4) == (min(counts), max(counts))


def test_few_sensors_on_a_tall_frame_bend_no_mode():
    """Block rows for few states would bias the high modes."""
    frame = KnownFrame(np.linspace(420e3, 300e3, 14), np.linspace(900e6, 350e6, 14), 0.015)
    record = base_record(frame, 1, noise=0.03, duration=600.0, sampling_rate=50.0)
    result = identify_modes(only(record, [0, 3, 6, 9, 13]))
    z = (result.frequencies / frame.modes()[0][result.modes - 1] - 1) / result.frequency_std
    assert len(z) > 10
    assert np.abs(z).max() < 4.0


def test_noise_of_the_sensors_bends_no_weak_mode():
    """Without weights, noise in the strong modes' singular vectors would bias the sixth mode low by 0.9 deviations."""
    frame = KnownFrame(np.full(7, 1000.0), np.full(7, 2.5e6), 0.01)
    truth, off = frame.modes()[0][5], []
    for seed in range(5):
        record = base_record(frame, seed, noise=0.06, duration=200.0, sampling_rate=41.0)
        found = identify_modes(only(record, [0, 3, 6]))
        row = int(np.argmin(np.abs(found.frequencies - truth)))
        off.append((found.frequencies[row] / truth - 1.0) / found.frequency_std[row])
    assert np.mean(off) > -0.65


def test_the_highest_of_six_modes_is_within_its_deviations():
    """The noise is 5 %."""
    frame = KnownFrame(np.full(6, 1000.0), np.full(6, 2.5e6), 0.03)
    found = identify_modes(base_record(frame, 1, noise=0.05, duration=300.0, sampling_rate=42.0))
    np.testing.assert_array_equal(found.modes, np.arange(1, 7))
    off = found.frequencies / frame.modes()[0] - 1.0
    assert np.all(np.abs(off) < 3.0 * found.frequency_std)
    assert np.all(np.abs(found.damping_ratios - frame.damping) < 3.0 * found.damping_std)
    assert np.all(found.frequency_std < 2e-3)


@pytest.mark.parametrize("seed", [5, 7])
def test_a_strong_dashpot_in_one_story_takes_no_mode_for_another(seed):
    """The dashpot causes the phases, not a clock; the second mode (9 % damping) is found with one sign change."""
    rng = np.random.default_rng(seed)
    stories, rate = 4, 100.0
    M, _, K = matrices(np.full(stories, 10.0), np.linspace(1.2, 0.8, stories) * 2e4, np.zeros(stories))
    C = 2e-4 * K + np.diag([300.0, 0.0, 0.0, 0.0])
    turning = -np.linalg.solve(M, np.hstack([K, C]))
    rates = np.vstack([np.eye(stories, 2 * stories, stories), turning])
    load = np.concatenate([np.zeros(stories), -np.ones(stories)])[:, None]
    ground = signal.lfilter(*signal.butter(4, 0.6), rng.standard_normal(12_000))
    times = np.arange(len(ground)) / rate
    _, floors, _ = signal.lsim((rates, load, turning, np.zeros((stories, 1))), ground, times)
    floors += 0.02 * floors.std(axis=0) * rng.standard_normal(floors.shape)
    channels = tuple(Channel(f"floor {floor}", floor) for floor in range(1, stories + 1))
    found = identify_modes(TimeRecord(channels, runs=(Run(floors, ground),), sampling_rate=rate, input="base"))
    exact = np.sort(np.abs(np.linalg.eigvals(rates)))[::2] / (2 * np.pi)
    assert found.modes[:2].tolist() == [1, 2]
    np.testing.assert_allclose(found.frequencies[:2], exact[:2], rtol=2e-3)
