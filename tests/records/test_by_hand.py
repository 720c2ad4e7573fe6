"""Steps between poles and findings, each by itself: against sums written out, closed forms and drawn numbers."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, stats

from cvxshear.records import agreement, amplitude, estimate, from_arrays, picking, prepare, releases
from cvxshear.records.assemble import assembled
from cvxshear.records.clock_offsets import Offsets
from cvxshear.records.deviations import frequency_std, independent_std
from cvxshear.records.diagnostics import (
    _mode_findings,
    cables_changed,
    clock_findings,
    driving_point_findings,
    hit_findings,
    reciprocity_findings,
    resolution_findings,
)
from cvxshear.records.estimate import Details
from cvxshear.records.frf import (
    FrfSource,
    Spectra,
    _quiet_after_blow,
    hit_start,
    hit_times,
    reach,
    residues,
    table_spectra,
)
from cvxshear.records.functions import _segment
from cvxshear.records.identify import Options, _about_unknown_centers, _out_of_reach, _wanted
from cvxshear.records.mode_shapes import possible_changes, sign_changes
from cvxshear.records.picking import PoleCandidate, Sweep, Values
from cvxshear.records.realization import Impulse, Poles
from cvxshear.records.record import Channel, Finding, FrfRecord
from cvxshear.records.stabilization import Criteria, center, clusters, energies, stable_poles, undivided
from cvxshear.util.errors import InputError

STARS = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.7]])
"""Real shapes of two modes at three floors."""


def details(scales):
    eigenvalues = 2 * np.pi * np.array([2.0, 7.0]) * np.exp(1j * np.pi * np.array([0.504, 0.51]))
    clocks = Offsets(np.array([0.0, 1e-3, -2e-3, 5e-4]), np.array([0.0, 3.0, 8.0, 1.0]), np.zeros(4), 0)
    return Details(eigenvalues, STARS + 0.01j, STARS, scales, clocks, None, np.zeros(0, dtype=int))


def result_of(scales, covariance, numbers=(0, 0), stories=3, real=STARS):
    channels = tuple(Channel(name, floor) for floor, name in enumerate("abc", 1))
    record = SimpleNamespace(channels=channels, name="r", stories=stories, floors=np.array([1, 2, 3]))
    sweep = SimpleNamespace(chosen=[SimpleNamespace(number=number) for number in numbers])
    full = dataclasses.replace(details(scales), real=real)
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
    ("numbers", "stories", "order", "expected"),
    [((2, 3), 3, (0, 1), [2, 3]), ((0, 3), 3, (0, 1), [2, 3]), ((0, 0), 4, (0, 1), [1, 2]), ((0, 0), 3, (1, 0), [1, 2]),
     ((0, 0), 3, (0, 0), [1, 2])],
)  # fmt: skip
def test_modes_have_the_numbers_chosen_or_those_of_their_signs(numbers, stories, order, expected):
    """Shapes that change sign once and twice are those of modes 2 and 3, where all floors are measured."""
    real = np.array([[-0.5, -0.3, 1.0], [0.7, -1.0, 0.4]])[list(order)]
    assert result_of(None, 1e-6 * np.eye(14), numbers, stories, real)[1].modes.tolist() == expected


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
        rows = np.vstack([np.transpose(columns), 0.3 * np.eye(n)])
        sides = np.append(seen / typical, np.full(n, 0.3))
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
    amplitudes[:, 0] *= np.exp(-1j * omega * late) * np.exp([[0.5j], [0.5j * np.pi]])
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


@pytest.mark.parametrize("lost", [0, 1])
def test_deviations_of_few_pieces_are_those_of_students_t(monkeypatch, lost):
    """Modes that are means over pieces scatter as means do; what is not found without a piece is made up for."""
    data = np.random.default_rng(6).standard_normal((9, 3)) * [1.0, 2.0, 3.0] + 5.0

    def values(keep):
        return None if lost and not keep[4] else data[keep].mean(axis=0)

    def details_of(setting, values, keep, full):
        return SimpleNamespace(scales=None, vector=lambda: values)

    monkeypatch.setattr(estimate, "details", details_of)
    source = SimpleNamespace(
        groups=np.zeros(9, dtype=int), weights=np.ones(9), unit="block", impulse=lambda: None, rougher=lambda: None
    )
    full = SimpleNamespace(scales=None, clocks=SimpleNamespace(seconds=np.zeros(1)))
    setting = SimpleNamespace(source=source, values=values)
    found, how, passed = estimate.covariance(setting, full, 0)
    used = np.delete(data, 4, axis=0) if lost else data
    # Leaving piece j out moves the mean by the (n - 1)th part of its distance from the mean.
    expected = np.cov(used, rowvar=False) * (len(used) - 1) / 8 * (8 / 9) * 9 / len(used) / 8
    factor = stats.t.ppf(0.025, 8 * (1 if not lost else 7 / 8)) / stats.norm.ppf(0.025)
    np.testing.assert_allclose(found, factor**2 * expected)
    assert (how, passed) == ("jackknife over 9 blocks", lost)
    bias = np.array([0.1, -0.2, 0.3])
    monkeypatch.setattr(estimate, "_bias", lambda setting, full: bias)
    found, how, _ = estimate.covariance(setting, full, 0)
    np.testing.assert_allclose(found, factor**2 * expected + np.outer(bias, bias))
    assert how.endswith("and a third of what half the observer's lags change")
    # A bias of the clocks alone, the last parameters, is nobody's concern.
    bias = np.array([0.0, 0.0, 0.3])
    assert estimate.covariance(setting, full, 0)[1] == "jackknife over 9 blocks"
    monkeypatch.setattr(estimate, "disturbed", lambda *_: np.diag([100.0, 0.0, 0.0]))
    source.groups, source.weights, source.impulse = np.zeros(5, dtype=int), np.ones(5), lambda: True
    bias = np.zeros(3)
    setting = SimpleNamespace(source=source, values=lambda keep: data[:5][keep].mean(axis=0))
    found, how, _ = estimate.covariance(setting, full, 0)
    expected = np.cov(data[:5], rowvar=False) / 5
    scale = np.diag([10 / np.sqrt(expected[0, 0]), 1.0, 1.0])
    np.testing.assert_allclose(found, scale @ expected @ scale)
    assert how == "jackknife over 5 blocks, at least 20 surrogates'"


def test_a_deviation_that_chance_makes_small_is_raised_to_the_other():
    spread = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    found = estimate._widened(spread, np.diag([1.0, 9.0, 25.0]))
    np.testing.assert_allclose(found, [[4.0, 3.0, 0.0], [3.0, 9.0, 0.0], [0.0, 0.0, 25.0]])


@pytest.mark.parametrize("samples", [40, 41])
def test_surrogates_have_the_spectra_of_what_they_are_made_of(samples):
    residual = np.random.default_rng(7).standard_normal((samples, 2)).cumsum(axis=0)
    noise = estimate.surrogate(residual, np.random.default_rng(8))
    before, after = (np.fft.rfft(each, axis=0) for each in (residual, noise))
    np.testing.assert_allclose(np.abs(after), np.abs(before))
    np.testing.assert_allclose(after[:, 0] * after[:, 1].conj(), before[:, 0] * before[:, 1].conj())
    assert np.std(np.angle(after[1:-1] / before[1:-1])) > 1.0
    np.testing.assert_allclose(noise.mean(axis=0), residual.mean(axis=0))


def test_phases_of_products_count_by_their_size_and_by_what_is_left(monkeypatch):
    """Two modes off by 10 and 20 degrees: their squares by the squares of what is left, sizes within a mode alone."""
    products = np.array([[[2.0], [0.0]], [[3.0], [4.0]]]) * np.exp(1j * np.radians([10.0, 20.0]))[:, None, None]
    monkeypatch.setattr(estimate, "details", lambda *_: SimpleNamespace(products=products))
    found = estimate._phase_off(None, None, np.array([0.5, 0.1]))
    assert found == pytest.approx(np.sqrt((0.25 * 10**2 + 0.01 * 20**2) / 0.26))
    monkeypatch.setattr(estimate, "details", lambda *_: SimpleNamespace(products=None))
    assert estimate._phase_off(None, None, np.array([0.5, 0.1])) == 0.0


def candidate(frequency, shape, energy=0.1, place=None, **more):
    shape = np.asarray(shape, dtype=complex)
    place = round(1000 * frequency) if place is None else place
    members = (place, 0), (place + 1, 0)
    return PoleCandidate(members, 2 * np.pi * frequency * np.exp(1.59j), shape, 1.0, energy, **more)


def test_of_candidates_the_most_whose_signs_make_a_frame_are_chosen():
    """Against all subsets: most modes, then signs that fit as they stand, then the largest product of energies."""
    rng = np.random.default_rng(9)
    for trial in range(12):
        shapes = rng.standard_normal((5, 4)) * rng.choice([1.0, 0.03], (5, 4))
        items = [candidate(2.0 + k, shape, energy) for k, (shape, energy) in enumerate(zip(shapes, rng.random(5),
                 strict=True))]  # fmt: skip
        best = (0, 0, 0.0), ()
        for size in range(1, 4):
            for chosen in itertools.combinations(range(5), size):
                for numbers in itertools.combinations(range(1, 4), size):
                    ranges = [possible_changes(shapes[at], 0.05) for at in chosen]
                    if all(low < number <= high + 1 for number, (low, high) in zip(numbers, ranges, strict=True)):
                        fits = sum(sign_changes(shapes[at]) == number - 1 for at, number in zip(chosen, numbers,
                                   strict=True))  # fmt: skip
                        rank = size, fits, float(sum(np.log(items[at].energy) for at in chosen))
                        best = max(best, (rank, tuple(zip(chosen, numbers, strict=True))))
        found = picking._by_signs(items, 3)
        assert tuple((round(item.frequency - 2.0), item.number) for item in found) == best[1], trial
    assert picking._by_signs([], 3) == []


def test_numbers_are_as_low_as_signs_allow_and_the_weakest_gives_way():
    """At two of four floors: a shape of one change cannot be the first mode."""
    items = [candidate(2.0, [0.5, 1.0], 0.3), candidate(3.0, [1.0, 0.8], 0.01), candidate(7.0, [1.0, -0.6], 0.2),
             candidate(9.0, [-1.0, 0.9], 0.1), candidate(11.0, [1.0, 1.0], 0.05)]  # fmt: skip
    assert [item.number for item in picking._as_low(items[2:4], 4)] == [2, 3]
    assert [(item.frequency, item.number) for item in picking._as_low(items, 4)] == [
        (pytest.approx(frequency), number) for frequency, number in ((2.0, 1), (7.0, 2), (9.0, 3), (11.0, 4))
    ]
    assert picking._as_low(items[2:3], 1) == []


def test_a_mode_found_twice_keeps_the_one_that_lasts_or_came_first():
    same, other = [1.0, 0.5], [0.5, -1.0]
    items = [
        candidate(5.0, same, place=7), candidate(5.2, same, place=3), candidate(5.1, other, place=9),
        candidate(5.5, same, place=1), candidate(5.15, same, place=0, physical=False),
    ]  # fmt: skip
    found = picking._distinct(items, Criteria())
    assert [(round(item.frequency, 2), item.physical) for item in found] == [
        (5.0, False), (5.1, True), (5.2, True), (5.5, True)
    ]  # fmt: skip
    assert found[0].twin == items[1].members
    assert found[0].reason == "a mode found twice: it has the shape of 5.2000 Hz, MAC 1.000"


def test_poles_picked_by_hand_are_the_nearest_and_each_is_taken_once():
    items = [candidate(frequency, [1.0]) for frequency in (4.0, 4.1, 7.0)]
    found = picking._by_hand(items, (7.2, 4.04, 4.03, 9.0))
    assert [round(item.frequency, 3) for item in found] == [4.0, 4.1, 7.0]
    assert [round(item.frequency, 3) for item in picking._by_hand(items, (7.23, 3.89))] == [4.0]


def test_the_loudest_resonances_come_without_what_is_faint_or_beside_them():
    given = (1.0, 9e-4), (2.0, 0.3), (2.15, 1.0), (2.45, 0.2), (3.0, 0.5), (4.0, 0.0011)
    items = [candidate(at, [1.0, k], energy, physical=at != 3.0) for k, (at, energy) in enumerate(given)]
    sweep = Sweep([], [], tuple(items), (), None)
    frequencies, shapes = picking.strongest(sweep, 2)
    np.testing.assert_allclose(frequencies, [2.15, 2.45])
    np.testing.assert_allclose(np.abs(shapes[:, 1] / shapes[:, 0]), [2.0, 3.0])
    assert picking.strongest(sweep, 9)[0][-1] == pytest.approx(4.0)
    assert len(picking.strongest(Sweep([], [], (items[4],), (), None), 2)[0]) == 0


def poles(order, *modes):
    values = [2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2)) for f, z, _ in modes]
    return Poles(order, np.array(values), np.array([shape for *_, shape in modes], dtype=complex))


def test_poles_are_stable_that_come_back_and_chains_follow_the_nearest():
    """One order after the other: within 1 % of frequency, half of the damping or of 0.01, MAC 0.95."""
    up, turned, off = [1.0, 1.0], [1.0, 0.7], [1.0, 0.5]
    sweep = [
        poles(2, (5.0, 0.02, up), (9.0, 0.004, up), (20.0, 0.01, up), (49.5, 0.01, up), (30.0, 0.11, up)),
        poles(4, (5.049, 0.029, turned), (9.0, 0.0088, up), (20.0, 0.01, off), (49.5, 0.01, up), (30.0, 0.11, up)),
        poles(6, (5.098, 0.029, turned), (9.0, 0.0142, up), (20.3, 0.01, off), (5.02, 0.028, turned), (30.0, -0.1, up)),
    ]
    stable = stable_poles(sweep, 100.0, Criteria())
    assert stable == [[], [0, 1], [0, 3]]
    assert clusters(sweep, stable, Criteria()) == [[(1, 0), (2, 3)], [(1, 1)], [(2, 0)]]
    # The second pole of one shape nearby divides the mode in the third order, not in the second.
    assert undivided([(1, 0), (2, 3)], sweep, Criteria()) == [(1, 0)]
    assert undivided([(2, 3)], sweep, Criteria()) == [(2, 3)]
    # An exponential window's decay of 0.4 /s is taken from the ratios: 0.013 at 5 Hz, and too much at 9 Hz.
    assert stable_poles(sweep[:2], 100.0, Criteria(highest_damping=0.02), shift=0.4) == [[], [0]]
    assert stable_poles(sweep[:2], 100.0, Criteria(highest_damping=0.008))[1] == []


def test_a_mode_has_the_energy_of_its_own_decay():
    """Of two modes that hardly overlap, each has its share of the squares; what none of them makes is nobody's."""
    rate, time = 50.0, np.arange(400) / 50.0
    values = 2 * np.pi * np.array([3.0, 11.0, 20.0]) * np.exp(1.6j)
    shapes = np.array([[1.0, 2.0], [1.0, -1.0], [0.5, 1.0]])
    sizes = 3.0, 1.0, 2.0
    parts = [size * np.real(np.exp(value * time)[:, None] * shape) for size, value, shape in zip(sizes, values, shapes,
             strict=True)]  # fmt: skip
    factor = np.sum(parts, axis=0).reshape(-1, 1)
    found = energies(factor, list(zip(values[:2], shapes[:2] + 0j, strict=True)), rate)
    np.testing.assert_allclose(found, [np.sum(part**2) / np.sum(factor**2) for part in parts[:2]], rtol=0.1)
    assert energies(factor, [], rate).shape == (0,)


def test_another_opinion_is_of_the_nearest_mode_of_that_shape():
    own = from_arrays([2.0, 5.0, 9.0], [[0.5, 1.0], [1.0, -0.5], [1.0, 0.1]], floors=[1, 2], stories=3, name="own")
    shapes = [[0.45, 1.0], [0.5, 1.0], [1.0, -0.5], [0.1, -1.0]]
    other = from_arrays([1.98, 2.05, 5.26, 9.1], shapes, floors=[1, 2], stories=4, name="other")
    first, second, third, *more = agreement.second_opinion(own, other)
    mac = (0.5 * 0.45 + 1.0) ** 2 / (0.5**2 + 1.0) / (0.45**2 + 1.0)
    assert first.numbers == {
        "mode": 1, "method": "other", "agrees": True, "frequency": pytest.approx(1.98), "change": pytest.approx(-0.01),
        "mac": pytest.approx(mac),
    }  # fmt: skip
    # One is 5.2 % away, the other of another shape.
    assert [(each.numbers["mode"], each.numbers["agrees"]) for each in (second, third)] == [(2, False), (3, False)]
    assert [each.numbers["frequency"] for each in more] == [2.05, 5.26, 9.1]


def attempt_of(found):
    """Attempts that find, at each sampling rate, modes up to a frequency, so many of them."""

    def attempt(record):
        rate = 100.0 if record.band is None else 2.5 * record.band[1]
        if rate not in found:
            raise InputError("too short")
        highest, count = found[rate]
        chosen = [SimpleNamespace(frequency=highest * (k + 1) / count) for k in range(count)]
        return SimpleNamespace(sampling_rate=rate), SimpleNamespace(chosen=chosen)

    return attempt


@dataclasses.dataclass
class Band:
    band: tuple | None = None
    sampling_rate: float = 100.0


@pytest.mark.parametrize(
    ("found", "wanted", "highest", "rate"),
    [
        ({100.0: (10.1, 3), 50.0: (10.1, 3)}, 3, 0.0, 100.0),
        ({100.0: (9.9, 3), 50.0: (9.9, 3), 25.0: (9.9, 3)}, 3, 0.0, 50.0),
        ({100.0: (10.1, 2), 50.0: (10.1, 3), 25.0: (10.1, 4)}, 3, 0.0, 50.0),
        ({100.0: (10.1, 2), 50.0: (10.1, 2), 25.0: (10.1, 3)}, 3, 0.0, 25.0),
        ({100.0: (3.0, 2), 50.0: (3.0, 1), 25.0: (3.0, 3)}, 3, 0.0, 100.0),
        ({100.0: (3.0, 2), 50.0: (3.0, 2)}, 3, 0.0, 50.0),
        ({100.0: (3.0, 3), 50.0: (3.0, 3), 25.0: (3.0, 3)}, 3, 19.0, 50.0),
        ({100.0: (3.0, 3), 50.0: (3.0, 3), 25.0: (3.0, 3)}, 3, 21.0, 100.0),
        ({100.0: (10.1, 0), 50.0: (10.1, 0), 25.0: (10.1, 0)}, 3, 0.0, 25.0),
        ({100.0 / 2**k: (0.01, 3) for k in range(9)}, 3, 0.0, 1.5625),
    ],
)
def test_the_rate_is_lowered_until_the_highest_mode_is_a_tenth_of_it(found, wanted, highest, rate):
    """As long as no mode is lost, and the modes picked by hand stay in sight."""
    source, _ = prepare.settled(Band(), wanted, attempt_of(found), highest)
    assert source.sampling_rate == rate
    narrow = attempt_of({50.0: (1.0, 1), 25.0: (1.0, 1)})
    assert prepare.settled(Band((0.0, 20.0)), 3, narrow)[0].sampling_rate == 50.0


def test_blocks_share_the_runs_by_their_length_behind_what_the_lags_need():
    runs = [SimpleNamespace(samples=samples) for samples in (520, 1020, 11, 30)]
    record = SimpleNamespace(runs=runs, sampling_rate=10.0)
    found = [(runs.index(run), start, stop) for run, start, stop in prepare._cuts(record, 15, 6, 4)]
    assert [place for place, *_ in found] == [0] * 5 + [1] * 10 + [3]
    assert [each[1:] for each in found[:5]] == [(6 + 102 * k, 6 + 102 * (k + 1)) for k in range(5)]
    assert found[-1] == (3, 6, 26)
    assert len(list(prepare._cuts(SimpleNamespace(runs=[SimpleNamespace(samples=50)]), 4, 6, 4))) == 4
    with pytest.raises(InputError, match="has 49 samples at 10 Hz; the method needs at least 50"):
        list(prepare._cuts(SimpleNamespace(runs=[SimpleNamespace(samples=49)], sampling_rate=10.0), 4, 6, 4))


def test_decays_begin_at_the_last_large_response_and_are_as_long_as_the_shortest():
    """Each channel counts by its own deviation."""
    time = np.arange(300)
    runs = []
    for begun in (40, 90):
        decay = np.where(time < begun, 0.0, np.exp(-0.02 * (time - begun)))
        runs.append(SimpleNamespace(responses=np.column_stack([decay, 1e3 * decay]), samples=300))
    record = SimpleNamespace(runs=runs)
    plain = prepare.without_offset
    try:
        prepare.without_offset = lambda record: record
        decays, starts = prepare.releases_of(record)
    finally:
        prepare.without_offset = plain
    # exp(-0.02 n) > 0.9 up to n = 5.
    assert starts.tolist() == [45, 95]
    assert decays.shape == (205, 2, 2)
    np.testing.assert_allclose(decays[:, 0, 1], np.exp(-0.02 * np.arange(5, 210)))


@pytest.mark.parametrize(
    ("late", "std", "left", "frequencies", "told"),
    [
        (2e-3, 4e-4, 4.9, [2.0, 8.0], True), (2e-3, 4.5e-4, 4.9, [2.0, 8.0], False),
        (-2e-3, 4e-4, 5.1, [2.0, 8.0], False), (3.4e-4, 1e-5, 1.0, [2.0, 8.0], False),
        (-3.5e-4, 1e-5, 1.0, [2.0, 8.0], True), (2e-3, 4e-4, 1.0, [8.0], False),
    ],
)  # fmt: skip
def test_a_clock_is_said_that_turns_modes_along_a_line_by_more_than_chance(late, std, left, frequencies, told):
    clocks = SimpleNamespace(unexplained=[0.0, left], before=[0.0, 10.0], reference=0)
    full = SimpleNamespace(frequencies=np.array(frequencies), clocks=clocks)
    result = SimpleNamespace(clock_offsets={"a": (0.0, 0.0), "b": (late, std)})
    found = list(clock_findings(None, result, full))
    assert [each.numbers["channel"] for each in found] == ["b"] * told
    for each in found:
        assert each.numbers["turn_degrees"] == pytest.approx(360 * 8.0 * abs(late))
        assert (" late" in each.message, " early" in each.message) == (late > 0, late < 0)


def test_a_resonance_narrower_than_a_line_is_said_and_so_is_a_short_ambient_record():
    runs = [SimpleNamespace(samples=samples) for samples in (400, 1000)]
    record = SimpleNamespace(runs=runs, sampling_rate=50.0, duration=28.0, input="none")
    result = SimpleNamespace(
        modes=np.array([1, 2]), frequencies=np.array([2.0, 6.0]), damping_ratios=np.array([0.012, 0.0045])
    )
    first, ambient = resolution_findings(record, result)
    assert (first.numbers["mode"], first.numbers["resolution"]) == (1, pytest.approx(0.05))
    assert first.numbers["bandwidth"] == pytest.approx(0.048)
    assert ambient.numbers["periods"] == pytest.approx(56.0)
    assert not list(resolution_findings(SimpleNamespace(**vars(record) | {"duration": 251.0}), result))[1:]


def driven(products, real, floors, at, base=False, scales=None):
    setting = SimpleNamespace(base=base, floors=np.array(floors))
    products = np.array(products, dtype=complex)
    return SimpleNamespace(products=products, driven=np.array(at), real=np.array(real), scales=scales), setting


def test_transfers_that_differ_with_their_direction_are_told_off_the_nodes():
    """Two modes of three floors, floors 1 and 3 driven; at its node the second mode says nothing."""
    real = np.array([[0.5, 0.8, 1.0], [1.0, 0.2, -0.004]])
    products = np.einsum("ri,rj->rij", real, real[:, [0, 2]])
    full, setting = driven(products, real, [1, 2, 3], [1, 3])
    assert list(reciprocity_findings(full, setting)) == []
    full.products[0, 2, 0] *= 1.05
    full.products[1, 2, 0] *= 3.0
    (found,) = reciprocity_findings(full, setting)
    up, down = np.array([0.525, -0.012]), np.array([0.5, -0.004])
    difference = np.linalg.norm(up - down) / np.mean([np.linalg.norm(up), np.linalg.norm(down)])
    assert (found.numbers["floors"], found.numbers["largest"]) == ([1, 3], pytest.approx(0.025 / 0.5125))
    assert found.numbers["over_all"] == pytest.approx(difference)
    np.testing.assert_allclose(found.numbers["by_mode"], [0.025 / 0.5125, 1.0])
    full.products[0, 2, 0] = 0.509
    assert list(reciprocity_findings(full, setting)) == []
    full.products[0, 2, 0] = 0.511
    assert len(list(reciprocity_findings(full, setting))) == 1
    setting.base = True
    assert list(reciprocity_findings(full, setting)) == []


@pytest.mark.parametrize(
    ("hit", "sign", "declared", "positive", "said"),
    [
        (2, 1.0, 3, [2], "only it fits"), (2, 1.0, 2, None, None), (3, -1.0, 3, [], "give that channel sign = -1"),
        (2, 1.0, 5, None, None),
    ],
)  # fmt: skip
def test_a_force_that_acts_elsewhere_is_told_by_the_signs_of_residues(hit, sign, declared, positive, said):
    real = np.array([[0.5, 0.8, 1.0], [1.0, 0.6, -0.7], [-0.8, 1.0, -0.5]])
    products = sign * np.einsum("ri,r->ri", real, real[:, hit - 1])[:, :, None]
    found = list(driving_point_findings(*driven(products, real, [1, 2, 3], [declared])))
    assert [each.numbers["positive_at"] for each in found] == ([] if positive is None else [positive])
    assert all(said in each.message for each in found)
    full, setting = driven(products, real, [1, 2, 3], [declared], scales=np.ones(3))
    assert list(driving_point_findings(full, setting)) == []


def test_a_force_at_no_floor_with_a_sensor_is_told():
    real = np.array([[0.5, 0.8], [1.0, 0.6], [-0.8, 1.0]])
    signs = np.array([1.0, -1.0, -1.0])
    products = (real * signs[:, None])[:, :, None]
    (found,) = driving_point_findings(*driven(products, real, [1, 2], [2]))
    assert found.numbers["positive_at"] == []
    assert "at no other floor with a sensor" in found.message


def test_what_modes_are_missing_or_more_is_said():
    def said(channels, stories, chosen, candidates=(), wanted=None, lost=()):
        sweep = SimpleNamespace(chosen=chosen, candidates=[*chosen, *candidates])
        record = SimpleNamespace(channels=[None] * channels, stories=stories)
        modes = np.array([item.number for item in chosen])
        result = SimpleNamespace(modes=modes, lost_phase=np.array(lost or [0.0] * len(chosen)))
        wanted = stories if wanted is None else wanted
        return list(_mode_findings(record, result, SimpleNamespace(sweep=sweep), wanted))

    items = [candidate(frequency, [1.0], 0.5, number=number) for frequency, number in ((2.0, 1), (5.0, 3))]
    (found,) = said(3, 3, items)
    assert (found.kind, found.numbers["modes"]) == ("missing mode", [2])
    assert "not found in the record" in found.message
    assert "not asked for" in said(3, 3, items, wanted=2)[0].message
    assert said(2, 2, items) == []
    (found,) = said(2, 3, items)
    assert (found.numbers["measured"], found.numbers["stories"]) == (2, 3)
    assert "2 were found" in found.message or "were found" in found.message
    more = candidate(9.0, [1.0], 0.1)
    found = said(2, 2, items, [more])
    assert (found[0].numbers["frequency"], found[0].numbers["energy"]) == (pytest.approx(9.0), 0.1)
    assert "the frame has more" in found[0].message
    assert "not among the modes asked for" in said(3, 3, items, [more], wanted=2)[-1].message
    assert "a floor or a sign is not as declared" in said(3, 3, items, [more])[-1].message
    turning = [candidate(8.0, [1.0], energy, physical=False, reason="mostly rotation: 60 %") for energy in (6e-4, 4e-4)]
    assert [each.kind for each in said(2, 2, items, turning)] == ["rotation"]
    lost = said(2, 2, items, lost=[5.1, 4.9])
    assert [(each.kind, each.numbers["mode"]) for each in lost] == [("complex mode", 1)]


def test_hits_that_are_answered_otherwise_than_most_are_named():
    rng = np.random.default_rng(2)
    first, second = (rng.standard_normal(40) + 1j * rng.standard_normal(40) for _ in range(2))
    both = [first, 2.0 * first, second, first + 0.7 * second, first + 0.8 * second, second]
    source = object.__new__(FrfSource)
    source.floors = np.array([1, 3])
    source.spectra = [SimpleNamespace(floor=floor, response_force=each[:, None]) for floor, each in
                      zip([1, 1, 1, 1, 1, 3], both, strict=True)]  # fmt: skip
    record = SimpleNamespace(runs=[SimpleNamespace(name=f"hit {k}") for k in range(6)])
    unit = [each / np.linalg.norm(each) for each in both]
    alike = np.array([[np.vdot(a, b).real for b in unit[:5]] for a in unit[:5]]) > 0.8
    expected = [f"hit {k}" for k in np.flatnonzero(~alike[np.argmax(alike.sum(axis=1))])]
    (found,) = hit_findings(record, SimpleNamespace(source=source))
    assert (found.numbers["floor"], found.numbers["runs"]) == (1, expected)
    assert 0 < len(expected) < 4


@pytest.mark.parametrize(("left", "told"), [(0.99, True), (1.01, False)])
def test_a_cable_explains_what_one_gain_leaves_by_chance(left, told):
    """Two modes at three floors: chi-square of three degrees of freedom, which chance passes once in a thousand."""
    shapes = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.7]])
    std = np.full((2, 3), 0.01)
    off = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def result(shapes):
        modes, floors = np.array([1, 2]), np.array([1, 2, 3])
        return SimpleNamespace(floors=floors, modes=modes, mode_shapes=shapes, mode_shape_std=std, name="r")

    gain = np.array([1.0, 1.0, 1.3])
    weight = 1 / (2 * 0.01**2 + 2 * 0.003**2)

    def misfit(size):
        changed = shapes * gain + size * off
        scaled = changed / np.abs(changed).max(axis=1, keepdims=True)

        def chi2(unknown):
            expected = shapes * [1.0, 1.0, unknown[0]] * np.array(unknown[1:])[:, None]
            return weight * np.sum((scaled - expected) ** 2)

        return optimize.minimize(chi2, [1.3, 0.8, 1.0], method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-8,
                                 "maxiter": 4000}).fun  # fmt: skip

    limit = stats.chi2.isf(1e-3, 3)
    size = optimize.brentq(lambda size: misfit(size) - left * limit, 0.0, 0.3, xtol=1e-6)
    found = cables_changed(result(shapes), result(shapes * gain + size * off))
    assert bool(found) is told


def test_residues_are_the_amplitudes_of_decays_and_unit_forces():
    values = np.array([-0.5 + 20j, -1.0 + 55j])
    amplitudes = np.random.default_rng(3).standard_normal((2, 3, 2)) + 1j
    k = np.arange(5, 80)
    sequence = np.zeros((80, 3, 2))
    for value, size in zip(values, amplitudes, strict=True):
        sequence[5:] += 2 * np.real(np.exp(value * k / 50.0)[:, None, None] * size)
    np.testing.assert_allclose(residues(sequence, values, 50.0, 5), amplitudes)


def struck_run(at=(50, 52), samples=400, noise=0.0):
    force = noise * np.ones(samples)
    force[at[0] : at[1]] = 10.0
    return SimpleNamespace(excitation=force, samples=samples, responses=np.zeros((samples, 1)), name="r", floor=1)


def test_a_blow_begins_with_what_leads_to_it():
    run = struck_run()
    assert hit_start(run) == 50 - 12
    run.excitation[[47, 44, 40]] = 0.21, 0.21, 0.21
    assert hit_start(run) == 44 - 12
    run.excitation[[47, 44]] = 0.19
    assert hit_start(run) == 50 - 12
    assert hit_start(struck_run((5, 6))) == 0
    run = struck_run((50, 51))
    run.excitation[[60, 300, 301]] = 2.6
    assert hit_times(run, 20.0) == pytest.approx([2.4, 14.9])
    assert hit_times(run, 19.0) == pytest.approx([50 / 19 - 0.1, 60 / 19 - 0.1, 300 / 19 - 0.1])
    assert hit_times(struck_run((1, 2)), 20.0) == [0.0]


def test_outside_a_blow_the_force_is_nought():
    """By twelve samples to either side at least, or three times its own length."""
    for at, margin in (((50, 52), 12), ((50, 56), 18)):
        quiet = _quiet_after_blow(struck_run(at, noise=0.1).excitation)
        assert np.flatnonzero(quiet)[[0, -1]].tolist() == [at[0] - margin, at[1] - 1 + margin]
        assert quiet[at[0]] == 10.0
    assert np.flatnonzero(_quiet_after_blow(struck_run((5, 6), noise=0.1).excitation))[[0, -1]].tolist() == [0, 17]


def test_a_blow_reaches_to_the_first_line_that_has_a_hundredth_of_its_power():
    """Of four samples: |sin(4 x) / sin(x)|^2 over 16, x = pi f / rate, is nil at a quarter of the rate."""
    record = SimpleNamespace(runs=[struck_run((50, 54))], sampling_rate=80.0)
    lines = np.arange(1, 2 * (400 - 38) // 2 + 1) * 80.0 / (2 * (400 - 38))
    power = (np.sin(4 * np.pi * lines / 80) / np.sin(np.pi * lines / 80)) ** 2 / 16
    assert reach(record) == pytest.approx(lines[np.flatnonzero(power < 0.01)[0]])


def test_tables_of_functions_are_filled_below_their_first_line():
    run = SimpleNamespace(responses=np.arange(1.0, 41.0).reshape(20, 2) * 1j, floor=2)
    record = SimpleNamespace(frequencies=0.5 * np.arange(3, 23), step=0.5, runs=[run])
    (found,), samples = table_spectra(record, 6.2)
    assert samples == 2 * 13
    np.testing.assert_array_equal(found.response_force[:3], 0.0)
    np.testing.assert_array_equal(found.response_force[3:], run.responses[:11])
    np.testing.assert_allclose(found.response_response, np.abs(found.response_force) ** 2)
    assert table_spectra(record)[1] == 2 * 22


@pytest.mark.parametrize(
    ("samples", "highest", "expected"),
    [(100_000, 10.0, 5120), (100_000, 80.0, 1024), (2001, 1.0, 500), (100, 10.0, 64)],
)
def test_segments_have_512_lines_up_to_the_highest_or_an_eighth_of_the_record(samples, highest, expected):
    runs = [SimpleNamespace(samples=each) for each in (samples, 10**6)]
    record = SimpleNamespace(runs=runs, sampling_rate=100.0)
    assert _segment(record, highest) == expected


def test_as_many_modes_are_wanted_as_there_are_stories_or_were_asked_for():
    record = SimpleNamespace(stories=3)
    assert [_wanted(record, Options(**more)) for more in ({}, {"count": 2}, {"pick": (1.0, 2.0, 3.0)})] == [3, 2, 3]
    with pytest.raises(InputError, match="pick names 4 modes; a frame of 3 stories"):
        _wanted(record, Options(pick=(1.0, 2.0, 3.0, 4.0)))
    with pytest.raises(InputError, match="count"):
        _wanted(record, Options(count=4))
    items = (candidate(2.0, [1.0]), candidate(4.0, [1.0]))
    said = _out_of_reach(SimpleNamespace(chosen=items[:1], candidates=items), (2.05, 7.0))
    assert said == "pick: no stable pole of its own within 3 % of 7 Hz; there are 2, 4 Hz"
    said = _out_of_reach(SimpleNamespace(chosen=items[:1], candidates=items), (2.05, 2.01))
    assert "of 2.05, 2.01 Hz" in said


def test_entries_of_a_floor_whose_center_nobody_knows_are_off_by_a_uniform_part():
    """Half the sensors' difference over their mean is the root of rotation's share over sway's."""
    findings = [Finding("floors", "", {"floor": 2, "placed": False, "arm": 0.5}), Finding("floors", "", {"floor": 3}),
                Finding("floors", "", {"floor": 3, "placed": False})]  # fmt: skip
    looked = SimpleNamespace(turning=lambda frequency: 0.2 * frequency, findings=findings)
    plain = result_of(None, 1e-6 * np.eye(14))[1]
    found = _about_unknown_centers(looked, plain)
    share = np.minimum(0.2 * np.array([2.0, 7.0]), 1.4)
    off = np.sqrt(share / np.maximum(1 - share, 1e-9) / 3)
    added = off[:, None] * np.abs(STARS) * [0.0, 0.5, 1.0]
    np.testing.assert_allclose(found.mode_shape_std[0], np.hypot(plain.mode_shape_std, added)[0])
    np.testing.assert_allclose(found.entry_std[0], np.hypot(plain.entry_std, added)[0])
    np.testing.assert_allclose(np.diag(found.covariance)[2:5], np.diag(plain.covariance)[2:5] + added[0] ** 2)
    np.testing.assert_allclose(np.diag(found.covariance)[:2], np.diag(plain.covariance)[:2])
    looked.turning = None
    assert _about_unknown_centers(looked, plain) is plain


@pytest.mark.parametrize(("decay", "declared", "told"), [(3.0, None, True), (5.0, None, False), (3.0, True, True)])
def test_whether_a_table_was_cut_off_is_told_by_phases_where_something_is_left(monkeypatch, decay, declared, told):
    """exp(-3) of the first mode is left after a second, of the second less; exp(-5) is not worth a word."""
    source, record = object.__new__(FrfSource), object.__new__(FrfRecord)
    source.samples, source.sampling_rate, source.wrapped = 200, 200.0, None
    object.__setattr__(record, "truncated", declared)
    setting = SimpleNamespace(source=source)
    values = Values(np.array([-decay + 20j, -9.0 + 50j]), np.ones((2, 1)))
    for off in ({True: 3.0, False: 2.0}, {True: 2.0, False: 3.0}):
        monkeypatch.setattr(estimate, "_phase_off", lambda setting, values, left, off=off: off[setting.source.wrapped])
        found = estimate.settle_truncation(record, setting, values)
        assert len(found) == told
        for each in found:
            truncated = off[False] < off[True] if declared is None else declared
            left = pytest.approx(np.exp(-3.0))
            assert each.numbers == {"mode": 1, "left": left, "length": 1.0, "truncated": truncated}
            assert ("as declared" in each.message) is (declared is not None)
            assert declared is not None or source.wrapped is not truncated
    assert estimate.settle_truncation(record, SimpleNamespace(source=None), values) == []


@pytest.mark.parametrize("wrapped", [False, True])
def test_products_are_those_of_decays_folded_back_or_not(wrapped):
    """Receptance phi_i phi_d / (2 i omega_d) a mode; folded after n samples it repeats as a geometric series."""
    rate, value = 40.0, np.array([-0.3 + 22j])
    phi = np.array([0.4, -0.9])
    z = np.exp(value[0] / rate)
    shown = phi * 0.7 / (2j * 22) * z ** np.arange(60)[:, None] / rate
    sequence = 2 * np.real(shown / (1 - z**60) if wrapped else shown)[:, :, None]
    source = SimpleNamespace(impulse=lambda keep: Impulse(sequence, 3, np.array([2]), wrapped), sampling_rate=rate)
    setting = SimpleNamespace(source=source, base=False, quantity="displacement")
    products, at = estimate._products(setting, Values(value, phi[None] + 0j), None)
    np.testing.assert_allclose(products[0, :, 0], 0.7 * phi)
    assert at.tolist() == [2]
    source.impulse = lambda keep: Impulse(sequence, 3, np.array([0]), wrapped)
    assert estimate._products(setting, Values(value, phi[None] + 0j), None)[0] is None
    source.impulse = lambda keep: None
    assert estimate._products(setting, Values(value, phi[None] + 0j), None)[0] is None


def test_the_motion_is_taken_back_by_the_clocks_of_channel_and_force():
    clocks = Offsets(np.array([1e-3, -2e-3, 5e-4]), np.zeros(3), np.zeros(3), 0)
    late = np.array([1e-3, -2e-3]) - 5e-4
    products = np.exp(-30j * late)[:, None] * [[2.0], [3.0]]
    np.testing.assert_allclose(estimate._turned_back(products, -1.0 + 30j, clocks), [[2.0], [3.0]])


def late_modes(seconds, energies=(0.5, 0.3, 0.2)):
    """Candidates whose real shapes are turned by clocks that are late."""
    rows = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.7], [-0.8, 1.0, -0.5]])
    items = [candidate(frequency, row, energy) for frequency, row, energy in zip((2.0, 5.0, 9.0), rows, energies,
             strict=True)]  # fmt: skip
    return [dataclasses.replace(each, shape=each.shape * np.exp(-1j * abs(each.eigenvalue.imag) * seconds))
            for each in items]  # fmt: skip


def test_clocks_are_told_by_two_strong_candidates_of_several_channels():
    late = np.array([0.0, 1e-3, 0.0])
    items = late_modes(late)
    np.testing.assert_allclose(picking._clocks(items), late, atol=1e-6)
    assert picking._clocks(items[:1]) is None
    assert picking._clocks([*items[:1], dataclasses.replace(items[1], physical=False)]) is None
    assert picking._clocks([dataclasses.replace(each, shape=each.shape[:1]) for each in items]) is None
    # What is faint, or the ninth by strength, says nothing, whatever its phases are.
    wrong = dataclasses.replace(items[2], shape=items[2].shape * np.array([1.0, 1j, 1.0]), energy=4e-4)
    np.testing.assert_allclose(picking._clocks([*items[:2], wrong]), late, atol=1e-6)
    louder = dataclasses.replace(wrong, energy=6e-4)
    assert np.max(np.abs(picking._clocks([*items[:2], louder]) - late)) > 1e-5
    np.testing.assert_allclose(picking._clocks([louder, *items[:2] * 4]), late, atol=1e-6)
    # With the turns of the clocks taken back the shapes are real again, in the order that is said.
    real = next(picking._real(items, (2, 0, 1)))
    np.testing.assert_allclose(np.abs(real[0] / real[0, 0]), [1.0, 0.4, 0.8], atol=1e-4)


def test_candidates_are_judged_by_their_phases_without_those_of_clocks():
    """A channel is late, which no candidate is set aside for; one of three has a phase of its own besides."""
    items = late_modes(np.array([0.0, 2e-3, 0.0]), (0.5, 1e-4, 0.2))
    twisted = dataclasses.replace(items[1], shape=items[1].shape * np.exp([0.0, 0.0, 0.8j]))
    found = picking._collinear([items[0], twisted, items[2]], Criteria(least_collinearity=0.95))
    assert [each.physical for each in found] == [True, False, True]
    assert found[1].reason.startswith("modal phase collinearity 0.")


@pytest.mark.parametrize(("share", "physical"), [(0.49, True), (0.51, False)])
def test_a_mode_that_is_mostly_rotation_is_none_of_sway(share, physical):
    (found,) = picking._swaying([candidate(3.0, [1.0])], lambda frequency: share * frequency / 3.0)
    assert found.physical is physical
    assert (f"{100 * share:.0f} % of the motion" in found.reason) is not physical
    assert picking._swaying([found], None) == [found]


def test_a_mode_on_a_part_of_the_data_is_the_middle_of_what_its_orders_show(monkeypatch):
    """Found again in half of the orders at least; the poles of one part are computed once."""
    up, off = [1.0, 0.5], [0.5, -1.0]
    whole = [poles(2, (5.0, 0.02, up)), poles(4, (5.0, 0.02, up)), poles(6, (5.0, 0.02, up)), poles(8, (5.0, 0.02, up))]
    part = [poles(2, (5.1, 0.02, up)), poles(4, (5.2, 0.03, up), (5.01, 0.02, off)), poles(6, (5.4, 0.02, up)),
            poles(8, (9.0, 0.02, up))]  # fmt: skip
    asked = []

    def realized(factor, outputs, rate, orders):
        asked.append((factor, outputs, rate, orders))
        return part

    monkeypatch.setattr(picking, "realize", realized)
    source = SimpleNamespace(factor=lambda keep: "f", outputs=2, sampling_rate=50.0)
    parts = picking.Parts(source, whole)
    item = dataclasses.replace(candidate(5.0, up), members=((0, 0), (1, 0), (2, 0), (3, 0)))
    keep = np.array([True, False])
    value, shape = parts.found_again(item, keep)
    assert abs(value.imag) == pytest.approx(2 * np.pi * np.mean([5.1 * np.sqrt(1 - 4e-4), 5.2 * np.sqrt(1 - 9e-4)]))
    np.testing.assert_allclose(shape[1] / shape[0], 0.5)
    gone = dataclasses.replace(item, members=((1, 0), (2, 0), (3, 0)))
    assert parts.found_again(gone, keep) is None
    assert parts.values([item, gone], keep) is None
    assert parts.values([item, item], keep).eigenvalues.shape == (2,)
    assert asked == [("f", 2, 50.0, [2, 4, 6, 8])]
    assert parts.found_again(item, ~keep) is not None
    assert len(asked) == 2


@pytest.mark.parametrize(
    ("of_shape", "of_frequency", "shaky"), [(0.29, 0.019, None), (0.31, 0.019, True), (0.29, 0.021, False)]
)
def test_a_mode_that_scatters_from_piece_to_piece_is_doubted(of_shape, of_frequency, shaky):
    """Six pieces, left out one at a time; in turn larger and smaller by as much as makes these deviations."""
    item = candidate(5.0, [1.0, 0.5])
    up_and_down = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]) / np.sqrt(5)

    def found_again(item, keep):
        at = int(np.flatnonzero(~keep)[0])
        value = item.eigenvalue * np.exp(up_and_down[at] * of_frequency)
        return value, 3.0j * (item.shape + up_and_down[at] * of_shape * np.array([-0.5, 1.0]))

    source = SimpleNamespace(groups=np.zeros(6, dtype=int), weights=np.ones(6), unit="block")
    parts = SimpleNamespace(source=source, found_again=found_again)
    doubts = estimate.scattering(parts, [item])
    assert list(doubts) == ([] if shaky is None else [item.members])
    assert all(each[1] is shaky for each in doubts.values())

    def lost(item, keep):
        return None if not keep[:4].all() else found_again(item, keep)

    parts.found_again = lost
    assert estimate.scattering(parts, [item])[item.members] == ("without any of 4 of 6 blocks it is not found", False)


def struck_frame(hits, samples=400, decay=0.02):
    """Spectra of unit blows of one sample, so many at each floor, whose answers are known."""
    answers = {floor: np.exp(-decay * np.arange(samples // 2)) * np.cos(0.3 * floor * np.arange(samples // 2)) for floor
               in hits}  # fmt: skip
    spectra = []
    for floor, count in hits.items():
        for _ in range(count):
            H = np.fft.rfft(answers[floor], samples)
            spectra.append(Spectra(H[:, None], np.ones(len(H)), np.abs(H[:, None]) ** 2, floor))
    return answers, spectra


@pytest.mark.parametrize(
    ("hits", "unit", "groups"),
    [({1: 2, 3: 3}, "hit", [0, 0, 1, 1, 1]), ({1: 1, 2: 1, 3: 1}, "driving point", [0, 0, 0]),
     ({1: 1, 3: 2}, "none", []), ({1: 1, 2: 1}, "none", [])],
)  # fmt: skip
def test_hits_answer_to_one_pulse_and_are_left_out_where_others_are_left(hits, unit, groups):
    """A tenth of the largest power is added to that of the force, what follows the blow is taken to near its end."""
    answers, spectra = struck_frame(hits)
    source = FrfSource(spectra, 50.0, 400, 200)
    assert (source.unit, source.groups.tolist(), source.floors.tolist()) == (unit, groups, sorted(hits))
    np.testing.assert_allclose(source.energies, [np.sum(each.response_response) for each in spectra])
    np.testing.assert_allclose(source.weights, 201.0)
    for keep in (None, np.arange(len(spectra)) > 0):
        impulse = source.impulse(keep)
        left = {floor: count - (keep is not None and floor == 1) for floor, count in hits.items()}
        floors = [floor for floor in sorted(hits) if left[floor]]
        assert impulse.driven.tolist() == floors
        assert (impulse.start, len(impulse.sequence)) == (3, 200 - 3 - 12)
        for column, floor in enumerate(floors):
            size = left[floor] / np.sqrt(1.1 * hits[floor])
            np.testing.assert_allclose(impulse.sequence[:, 0, column], size * answers[floor][:185], atol=1e-9)
            np.testing.assert_allclose(impulse.pulse[:, column], [size, 0.0, 0.0], atol=1e-9)
    whole = FrfSource(spectra, 50.0, 400)
    assert len(whole.impulse().sequence) == 400
    with pytest.raises(InputError, match="too few samples are left"):
        FrfSource(spectra, 50.0, 400, 77)
    assert len(FrfSource(spectra, 50.0, 400, 78).impulse().sequence) == 63


def test_what_is_written_of_a_mode_holds_what_no_scatter_shows():
    """Frequencies to 0.02 %, damping to a hundredth of itself where it is known, entries to half a percent."""
    given = from_arrays([2.0, 5.0], STARS[:, :2], damping_ratios=[0.01, 0.02], frequency_std=[1e-4, 3e-4],
                        mode_shape_std=0.012)  # fmt: skip
    np.testing.assert_allclose(given.written_frequency_std, [2e-4, 3e-4])
    np.testing.assert_array_equal(given.written_damping_std, [0.0, 0.0])
    np.testing.assert_allclose(given.written_entry_std, 0.013)
    known = dataclasses.replace(given, damping_std=np.array([5e-5, 4e-4]))
    np.testing.assert_allclose(known.written_damping_std, [1e-4, 4e-4])
    assert "damping_ratio_std" not in given.configuration()
    assert known.configuration()["damping_ratio_std"] == pytest.approx([0.01, 0.02])


def test_the_middle_of_a_cluster_is_that_of_shapes_turned_to_one_phase():
    shape = np.array([1.0 + 0.1j, -0.5j])
    value, middle = center(np.array([1 + 4j, 2 + 3j, 9 + 8j]), np.array([shape, 3j * shape, -2.0 * shape]))
    assert value == 2 + 4j
    np.testing.assert_allclose(middle, 2.0 * shape)
