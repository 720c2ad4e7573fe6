"""Steps between poles and findings, each by itself: against sums written out, closed forms and drawn numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, stats

from cvxshear.modal import amplitude, releases
from cvxshear.modal.assemble import assembled
from cvxshear.modal.clock_offsets import Offsets
from cvxshear.modal.deviations import DRAWN, frequency_std, independent_std
from cvxshear.modal.estimate import Details
from cvxshear.modal.picking import Values
from cvxshear.records.record import Channel, Finding

STARS = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.7]])
"""Real shapes of two modes at three floors."""


def details(scales):
    eigenvalues = 2 * np.pi * np.array([2.0, 7.0]) * np.exp(1j * np.pi * np.array([0.504, 0.51]))
    clocks = Offsets(np.array([0.0, 1e-3, -2e-3, 5e-4]), np.array([0.0, 3.0, 8.0, 1.0]), np.zeros(4), 0)
    return Details(eigenvalues, STARS + 0.01j, STARS, scales, clocks, None, np.zeros(0, dtype=int))


def result_of(scales, covariance, numbers=(0, 0), stories=3):
    channels = tuple(Channel(name, floor) for floor, name in enumerate("abc", 1))
    record = SimpleNamespace(channels=channels, name="r", stories=stories, floors=np.array([1, 2, 3]))
    sweep = SimpleNamespace(chosen=[SimpleNamespace(number=number) for number in numbers])
    full = details(scales)
    return full, assembled(record, SimpleNamespace(sweep=sweep), full, covariance, method="era", uncertainty="drawn")


@pytest.mark.parametrize("between", [None, -0.5, 0.7])
def test_the_result_has_the_deviations_of_all_parameters(between):
    """`between` is the correlation of the scales of two mass-normalized modes; None where shapes have no scale."""
    scales = None if between is None else np.array([0.2, 0.5])
    sizes = np.concatenate([[1e-3, 2e-3, 1e-4, 3e-4], np.full(6, 0.01), [] if scales is None else 0.04 * scales,
                            [1e-9, 1e-4, 2e-4, 3e-4]])  # fmt: skip
    correlation = 0.1 + 0.9 * np.eye(len(sizes))
    if between is not None:
        correlation[10, 11] = correlation[11, 10] = between
    covariance = correlation * np.outer(sizes, sizes)
    full, found = result_of(scales, covariance)
    q = np.ones(2) if scales is None else scales

    def shown(vector):
        own = np.ones(2) if scales is None else vector[10:12]
        return np.concatenate([vector[:2], (own[:, None] * vector[4:10].reshape(2, 3) / q[:, None]).ravel()])

    at = full.vector()
    J = np.array([(shown(at + step) - shown(at - step)) / 2e-6 for step in 1e-6 * np.eye(len(at))]).T
    joint = J @ covariance @ J.T
    np.testing.assert_allclose(found.covariance, joint, atol=1e-12)
    np.testing.assert_allclose(np.concatenate([found.frequency_std, found.damping_std]), sizes[:4])
    np.testing.assert_allclose(found.mode_shape_std, np.sqrt(np.diag(joint)[2:]).reshape(2, 3))
    np.testing.assert_allclose(found.mode_shapes, q[:, None] * STARS)
    assert (found.mass_normalized, found.modes.tolist()) == (scales is not None, [1, 2])
    own = np.array([independent_std(joint[2 + at : 5 + at, 2 + at : 5 + at], row) for at, row in zip((0, 3), STARS,
                    strict=True)])  # fmt: skip
    of_scale = found.entry_std**2 - own**2
    if scales is None:
        np.testing.assert_allclose(of_scale, 0.0, atol=1e-12)
    else:
        # The scale of a mode by least squares from its entries, of which each has such an error of its own.
        together = max(1.0, 1.0 + between)
        np.testing.assert_allclose(1 / np.sum(STARS**2 / of_scale, axis=1), together * 0.04**2)
    # An angle left over at the rms frequency is as much of an offset.
    left = np.radians([0.0, 3.0, 8.0, 1.0]) / (2 * np.pi * np.sqrt((2.0**2 + 7.0**2) / 2))
    assert list(found.clock_offsets) == ["a", "b", "c", "input"]
    offsets = np.array(list(found.clock_offsets.values()))
    np.testing.assert_allclose(offsets[:, 0], full.clocks.seconds)
    np.testing.assert_allclose(offsets[:, 1], np.hypot(sizes[-4:], left))


@pytest.mark.parametrize(
    ("numbers", "stories", "expected"), [((2, 3), 3, [2, 3]), ((0, 3), 3, [1, 2]), ((0, 0), 4, [1, 2])]
)
def test_modes_have_the_numbers_chosen_or_those_of_their_signs(numbers, stories, expected):
    assert result_of(None, 1e-6 * np.eye(14), numbers, stories)[1].modes.tolist() == expected


def test_entries_err_by_themselves_as_much_as_the_shape_does():
    """Least squares over variances that cannot be negative, drawn to equal ones; equal ones come back."""
    rng = np.random.default_rng(2)
    for n in (2, 3, 5):
        shape, root = rng.standard_normal(n), rng.standard_normal((n, 2))
        np.testing.assert_allclose(independent_std(0.09 * np.eye(n), shape), 0.3)
        off = np.eye(n) - np.outer(shape, shape) / np.sum(shape**2)
        seen = np.diag(off @ root @ root.T @ off)
        typical = seen.sum() / (n - 1)
        columns = [np.diag(off @ np.diag(one) @ off) for one in np.eye(n)]
        rows = np.vstack([np.transpose(columns), DRAWN * np.eye(n)])
        sides = np.append(seen / typical, np.full(n, DRAWN))
        expected = typical * np.maximum(0.1, optimize.lsq_linear(rows, sides, (0, np.inf), tol=1e-14).x)
        np.testing.assert_allclose(independent_std(root @ root.T, shape), np.sqrt(expected), rtol=1e-5)
    np.testing.assert_array_equal(independent_std(np.outer(shape, shape), shape), 0.0)


def test_a_frequency_that_changes_with_amplitude_is_known_to_the_spread_of_twice_its_change():
    said = [Finding("amplitude", "", {"mode": mode, "change": change}) for mode, change in ((2, -0.012), (3, 0.006))]
    said += [Finding("amplitude", "", {"mode": 1, "std": 0.1}), Finding("sign", "", {"mode": 1, "change": 1.0})]
    found = frequency_std(np.array([0.003, 0.0, 0.004]), np.array([1, 2, 3]), said)
    spread = [stats.uniform(0.0, 2 * change).std() for change in (0.006, 0.012, 0.006)]
    np.testing.assert_allclose(found, np.hypot([0.003, 0.0, 0.004], spread))


T = stats.t(5).ppf(stats.norm.cdf(2.5))
"""Two and a half deviations, of six blocks in each half."""


def halves(changes, strong, weak, frequency_std, ratio=2.0):
    """Findings of twelve blocks, of which every other one moves more; their frequencies scatter by so much a half.

    Of six values that are up and down by d in turn the mean has the deviation d / sqrt(5).
    """
    frequencies = np.array([3.0, 8.0])[: len(changes)]
    up_and_down = np.sqrt(5) * np.repeat([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], 2)[:, None]
    loud = np.arange(12) % 2 == 0
    logs = np.log(frequencies) + np.where(loud[:, None], changes + up_and_down * strong, up_and_down * weak)
    source = SimpleNamespace(
        unit="block", groups=np.zeros(12, dtype=int), energies=np.where(loud, ratio**2, 1.0) * 7.0, impulse=lambda: None
    )

    def values(keep):
        return Values(2 * np.pi * np.exp(logs[keep].mean(axis=0) + 1.6j) - 0.3, np.ones((len(changes), 1)))

    result = SimpleNamespace(frequency_std=np.full(len(changes), frequency_std), modes=np.arange(1, len(changes) + 1))
    setting = SimpleNamespace(source=source, values=values, shift=0.3)
    return list(amplitude.amplitude_findings(setting, result))


@pytest.mark.parametrize(
    ("changes", "std", "frequency_std", "told"),
    [
        ([0.003], 0.003 / T / 1.02, 4.9e-4, [1]),
        ([0.003], 0.003 / T / 0.98, 4.9e-4, []),
        ([0.003], 1e-5, 5.1e-4, []),
        ([-0.00102], 1e-5, 1e-4, [1]),
        ([0.00098], 1e-5, 1e-4, []),
        ([0.003, 0.006], np.array([0.001, 0.002]), 4e-4, [1, 2]),
        ([0.003, -0.006], np.array([0.001, 0.002]), 4e-4, []),
        ([-0.0028, -0.0056], np.array([0.001, 0.002]), 4e-4, []),
        ([0.012, 0.0006], np.array([0.001, 0.001]), 4e-4, [1]),
    ],
)
def test_a_frequency_changes_with_amplitude_where_the_halves_differ_by_more_than_they_scatter(
    changes, std, frequency_std, told
):
    changes = np.array(changes)
    found = halves(changes, std / np.sqrt(2), std / np.sqrt(2), frequency_std)
    assert [each.numbers["mode"] for each in found] == told
    for each in found:
        at = each.numbers["mode"] - 1
        assert each.numbers["change"] == pytest.approx(changes[at])
        assert each.numbers["std"] == pytest.approx(np.broadcast_to(std, len(changes))[at])
        assert each.numbers["amplitude_ratio"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("strong", "weak", "frequency_std", "ratio", "told"),
    [
        (0.002, 3.5e-4, 1.1e-3, 1.6, True), (0.002, 3.8e-4, 1.1e-3, 1.6, False), (0.002, 3.5e-4, 1.1e-3, 1.4, False),
        (0.002, 1e-5, 9e-4, 1.6, False), (0.0011, 3e-4, 1.1e-3, 2.0, True), (0.00098, 3e-4, 1.1e-3, 2.0, False),
    ],
)  # fmt: skip
def test_a_frequency_that_scatters_where_the_motion_is_strong_is_suspected(strong, weak, frequency_std, ratio, told):
    found = halves(np.zeros(1), strong, weak, frequency_std, ratio)
    assert [(each.kind, "change" in each.numbers) for each in found] == ([("amplitude", False)] if told else [])


def test_a_decay_is_weak_once_a_ninth_of_its_energy_is_left():
    """exp(-2 a t) is a ninth at t = ln(9) / (2 a); the frequency's deviation grows with what the mode has lost."""
    decay = np.exp(-0.004 * np.arange(2000))
    impulse = SimpleNamespace(sequence=decay[:, None, None] * np.ones((1, 2, 3)), start=100)
    begun = amplitude._weak_from(impulse)
    assert begun == 100 + int(np.ceil(np.log(9) / 0.008))
    source = SimpleNamespace(impulse=lambda: impulse, sampling_rate=50.0)
    result = SimpleNamespace(frequencies=np.array([1.0, 2.0]), damping_ratios=np.array([0.01, 0.02]), modes=[1, 2])
    seconds = (begun - 100) / 50.0
    expected = np.exp(2 * np.pi * np.array([0.01, 0.04]) * seconds)
    np.testing.assert_allclose(amplitude._grown(SimpleNamespace(source=source), result), expected)
    # Of a response that is cut off the sums are geometric; what follows must be two fifths of it at least.
    for samples, told in ((620, True), (590, False)):
        x = np.exp(-0.008)
        begun = int(np.ceil(np.log((x**100 + 8 * x**samples) / 9) / np.log(x)))
        found = amplitude._weak_from(SimpleNamespace(sequence=impulse.sequence[:samples], start=100))
        assert found == (begun if told else None)
        assert told == (begun <= 0.6 * samples)


@pytest.mark.parametrize(("count", "counted"), [(4, True), (3, False)])
@pytest.mark.parametrize(("change", "told"), [(0.004, True), (0.0009, False), (-0.002, False), (0.0026, False)])
def test_a_decay_whose_end_has_another_frequency_is_told(monkeypatch, count, counted, change, told):
    """Frequencies are means over releases; the change scatters by 2 a third of 1e-3 each, the whole by 1e-4."""
    whole, scatter = np.full(count, np.log(5.0)), 2e-3 * np.array([1.0, -1.0, 1.0, -1.0])[:count]

    def values(keep):
        return Values(2 * np.pi * np.exp(np.array([whole[keep].mean() + 1.6j])), np.ones((1, 1)))

    def later(setting, keep):
        return np.atleast_1d((whole - change - scatter * (keep is not None))[... if keep is None else keep].mean())

    monkeypatch.setattr(amplitude, "_later", later)
    monkeypatch.setattr(amplitude, "_grown", lambda setting, result: 2.0)
    source = SimpleNamespace(unit="release", groups=np.zeros(count, dtype=int), impulse=lambda keep=None: 1)
    setting = SimpleNamespace(source=source, values=values, shift=0.0)
    of_pieces = 2e-3 * np.sqrt(4 / 3) / np.sqrt(4) if counted else 0.0
    assert np.squeeze(amplitude._std_of_change(setting)) == pytest.approx(of_pieces)
    result = SimpleNamespace(frequencies=np.array([5.0]), frequency_std=np.array([4.5e-4]), modes=np.array([1]))
    found = list(amplitude.amplitude_findings(setting, result))
    bound = 3 * max(9e-4, of_pieces)
    assert bool(found) == (abs(change) > max(bound, 1e-3)) == (told and (not counted or abs(change) > bound))
    for each in found:
        assert each.numbers["change"] == pytest.approx(change)
        assert each.numbers["chance"] == pytest.approx(bound)


def test_slopes_of_clocks_are_those_of_weighted_least_squares():
    """Each mode has a line of its own through the phases between two channels, and all lines one slope."""
    rng = np.random.default_rng(4)
    times, omega = np.array([0.0, 10.0, 25.0, 31.0, 50.0]), np.array([[12.0], [40.0]])
    size = rng.uniform(0.5, 2.0, (2, 2, 5))
    late = 1e-3 * rng.standard_normal((2, 5)) + 2e-5 * times
    amplitudes = size * np.exp(1j * rng.uniform(0, 6, (2, 1, 5)))
    amplitudes[:, 0] *= np.exp(-1j * omega * late) * np.exp([[0.5j], [2.0j]])
    slope, scatter, freedom, information = releases._line(amplitudes, omega, times, 0, [1])
    # Seen from the mean phasor of each mode, the phase between the channels.
    between = amplitudes[:, 0] * np.conj(amplitudes[:, 1])
    seen = -np.angle(between / np.sum(between, axis=1, keepdims=True)) / omega
    weights = np.minimum(size[:, 0], size[:, 1]) ** 2 * omega**2
    design = np.column_stack([np.tile(times, 2), np.repeat(np.eye(2), 5, axis=0)])
    root = np.sqrt(weights.ravel())
    expected, left, *_ = np.linalg.lstsq(design * root[:, None], seen.ravel() * root, rcond=None)
    assert slope == pytest.approx(expected[0])
    assert scatter == pytest.approx(left[0])
    normal = design.T @ (design * weights.ravel()[:, None])
    assert 1 / information == pytest.approx(np.linalg.inv(normal)[0, 0])
    assert freedom == pytest.approx(np.sum(weights.sum(axis=1) ** 2 / np.sum(weights**2, axis=1)) - 3)
    assert releases._line(np.ones((1, 2, 2), dtype=complex), omega[:1], times[:2], 0, [1])[2] == 0.1


def test_a_slope_has_the_deviation_that_draws_of_all_channels_have():
    rng = np.random.default_rng(5)
    times, omega, shape = np.arange(6.0), np.array([[10.0], [25.0]]), np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
    found = []
    for _ in range(300):
        noise = 0.02 * (rng.standard_normal((2, 3, 6)) + 1j * rng.standard_normal((2, 3, 6)))
        found.append(releases._drift(shape[:, :, None] + noise, omega, times, 1))
    slopes, std, freedom = np.transpose(found)
    # Ten equal weights a line but for its two means and its slope, of one line and two more.
    np.testing.assert_allclose(freedom, 3 * (2 * 5 - 1), rtol=0.02)
    # Against two others noise has 3/2 of its variance, against one twice; one line is of the first kind, two the other.
    expected = np.std(slopes) * np.sqrt((3 / 2 + 2 + 2) / 3 / (3 / 2))
    assert np.sqrt(np.mean(std**2)) == pytest.approx(expected, rel=0.08)
