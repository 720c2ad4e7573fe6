"""Test the comparison of a prediction with its record: limits, lines and delays, with expected values by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.response import DampedModel, response, sources
from cvxshear.response import compare as comparing
from cvxshear.response.compare import Transfer, confused_units
from cvxshear.response.recording import without_base_line, without_lines
from tests.response.common import damped_frame, matrices

LINES = np.arange(0.0, 10.0, 0.1)


def resonances(natural, height=1.0, width=0.5):
    """Return functions of two floors with a resonance at each frequency and coherence 1."""
    size = sum(height / (1 + ((LINES - at) / width) ** 2) for at in natural)
    return Transfer(LINES, np.column_stack([size, 2.0j * size]), np.ones((len(LINES), 2)))


def test_lines_belong_to_the_mode_that_they_are_nearest_to():
    natural = np.array([2.02, 2.45, 8.02])
    for mode, (low, high) in enumerate(((1.7, 2.2), (2.3, 2.9), (6.5, 9.6))):
        near = comparing.around(LINES, natural, mode, 0.2)
        np.testing.assert_array_equal(LINES[near], LINES[(low - 1e-9 < LINES) & (high + 1e-9 > LINES)])


def test_errors_of_functions_are_rms_around_each_mode_where_something_drives_it():
    measured, natural = resonances([2.0, 7.0]), np.array([2.0, 7.0])
    predicted = Transfer(LINES, measured.functions * np.array([1.1, 0.8]), measured.coherence)
    np.testing.assert_allclose(comparing.errors(measured, predicted, natural), [[0.1, 0.1], [0.2, 0.2]])
    coherence = np.where((LINES > 4.5)[:, None], [0.59, 0.61], 1.0)
    part = Transfer(LINES, measured.functions, coherence)
    np.testing.assert_allclose(comparing.errors(part, predicted, natural), [[0.1, np.nan], [0.2, 0.2]])


def spectra(natural, made, scatter=0.0, pieces=12):
    """Return pieces whose transfer functions peak at `natural` (in each piece off by `scatter` Hz) and at `made`."""
    off = scatter * np.random.default_rng(4).standard_normal((pieces, 1))
    one = np.ones((pieces, 1, 1))
    seen, modelled = (
        np.array([resonances(np.add(each, shift)).functions for shift in shifts])
        for each, shifts in ((natural, off), (made, 0 * off))
    )
    both = np.concatenate([seen, modelled], axis=2)
    return comparing.PieceSpectra(LINES, np.ones((pieces, len(LINES))), both, one * np.abs(both) ** 2)


def modelled(natural):
    return SimpleNamespace(modes=SimpleNamespace(frequencies=np.array(natural)))


@pytest.mark.parametrize(
    ("scatter", "std", "modes", "told"),
    [
        (0.02, None, None, [1, 2]), (0.02, None, [2], [2]), (0.9, None, None, []), (0.02, [0.2, 0.001], None, [2]),
        (0.02, [np.nan, np.nan], None, [1, 2]),
    ],
)  # fmt: skip
def test_a_shift_is_told_beyond_the_deviations_of_the_record_and_of_the_model(scatter, std, modes, told):
    natural, seen = [2.0, 5.0], [2.3, 5.6]
    found = comparing._shifts(
        spectra(seen, natural, scatter), modelled(natural), None if modes is None else np.array(modes),
        None if std is None else np.array(std),
    )  # fmt: skip
    assert [each.mode for each in found] == told
    for each in found:
        assert each.measured == pytest.approx(seen[each.mode - 1], abs=0.06)
        assert each.modelled == pytest.approx(natural[each.mode - 1], abs=0.02)
        assert f"({100 * (each.measured / each.modelled - 1):+.1f} %, standard deviation " in str(each)


def test_the_deviation_of_a_shift_is_that_of_the_mean_of_its_pieces():
    """Functions that move by little are averaged, so that the peak is at the mean of the pieces."""
    off = 0.02 * np.random.default_rng(4).standard_normal(12)
    (found, _) = comparing._shifts(spectra([2.3, 5.6], [2.0, 5.0], 0.02), modelled([2.0, 5.0]), None, None)
    assert found.std == pytest.approx(np.std(off, ddof=1) / np.sqrt(12) / 2.3, rel=0.4)


def test_one_factor_on_all_floors_is_a_unit_within_a_quarter_of_its_logarithm():
    p = np.random.default_rng(3).standard_normal((400, 3))
    p = p @ (np.eye(3) + 0.3)

    def said(factors):
        return "; ".join(confused_units(p * factors, p))

    for factor, unit in (
        (9.80665, "base motion in g"), (0.10197, "floors in g"), (1000.0, "floors in mm/s2"),
        (1e-3, "base motion in mm/s2"), (100.0, "floors in cm/s2"), (0.01, "base motion in cm/s2"),
        (39.37, "floors in in/s2"),
    ):  # fmt: skip
        assert unit in said(0.8 * factor * np.ones(3))
        assert unit in said(1.25 * factor * np.ones(3))
    assert "near 1000: are the floors in mm/s2?" in said(1000 * np.exp([0.24, 0.24, 0.2]))
    assert said(1000 * np.exp([0.26, 0.26, 0.27])) == said(np.array([1000.0, 1000.0, 1800.0])) == said(np.ones(3)) == ""
    assert said(np.array([1.0, 0.0, 1.0])) == ""


def test_lines_beside_an_expected_motion_are_taken_off():
    """The vibration itself, with an incomplete cycle at its end, has a line; the expected motion explains it."""
    time = np.linspace(-1.0, 1.0, 4000)
    motion, line = np.sin(200 * time + 0.3), 0.3 + 0.2 * time
    run = DrivenRun(motion + 2 * line, 0, np.column_stack([motion + line, motion]))
    record = DrivenRecord((run,), 100.0, "base", np.array([1, 2]))
    (found,) = without_lines(record, [np.column_stack([motion, motion])]).runs
    np.testing.assert_allclose(found.measured, np.column_stack([motion, motion]), atol=1e-9)
    (plain,) = without_base_line(record).runs
    own = np.polyval(np.polyfit(time, motion, 1), time)
    np.testing.assert_allclose(plain.excitation, motion - own, atol=1e-9)


def estimated(p_value, chi2=30.0, dof=10, shape=0.04):
    quality = SimpleNamespace(max_shape_error=shape)
    return SimpleNamespace(p_value=p_value, chi2=chi2, dof=dof, quality=quality)


@pytest.mark.parametrize(
    ("estimate", "expected"),
    [
        (estimated(0.009), (3.0, 0.04)), (estimated(0.011), (1.0, 0.0)), (estimated(None), (1.0, 0.0)),
        (estimated(0.009, dof=0), (1.0, 0.0)), (estimated(0.009, chi2=7.0), (1.0, 0.04)),
        (estimated(0.009, shape=None), (3.0, 0.0)),
    ],
)  # fmt: skip
def test_a_model_that_its_tests_speak_against_is_widened_by_what_they_leave(estimate, expected):
    assert sources._misfit(estimate) == expected
    plain = sources.Fitted(None, (), None, np.eye(2))
    assert (plain.undetermined, plain.misfit, plain.lacking) == ((), 1.0, 0.0)


def test_the_state_of_a_record_is_said_where_it_was_taken_for_granted():
    tests = [SimpleNamespace(state=state) for state in ("a", "b", "b")]
    two, one = SimpleNamespace(configurations=tests), SimpleNamespace(configurations=tests[1:])

    def said(experiment, state, *, named=False):
        remarks = sources.state_remarks(experiment, SimpleNamespace(state=state), tests[1], named=named)
        return [each.split(":")[0] for each in remarks]

    assert said(two, "b") == said(two, None, named=True) == said(one, None) == []
    assert said(two, "c", named=True) == ['the record is of state "c", the model that of "b", as asked']
    assert said(two, "c") == ['the record is of state "c", of which nothing was measured']
    assert said(two, None) == ["the record names no state"]


@pytest.mark.parametrize(
    ("samples", "ratio", "expected"),
    [(10_000, 0.01, 2000), (10_000, 0.02, 1000), (3001, 0.01, 1200), (30, 0.01, 16), (5, 0.01, 5)],
)
def test_pieces_show_a_bandwidth_by_eight_lines_or_are_a_fifth_of_the_record_twice(samples, ratio, expected):
    assert comparing.segment(samples, 50.0, 10.0, ratio) == expected


def welch(a, b, length):
    """Average conj(a) b over half-overlapping pieces, with means removed, under a raised cosine."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    parts = [np.fft.rfft(window * (each[at : at + length] - each[at : at + length].mean())) for each in (a, b)
             for at in range(0, len(a) - length + 1, length // 2)]  # fmt: skip
    half = len(parts) // 2
    return np.mean(np.conj(parts[:half]) * parts[half:], axis=0)


def test_functions_are_of_all_pieces_of_all_runs():
    rng = np.random.default_rng(11)
    forces = [rng.standard_normal(count) for count in (200, 320)]
    heard = [np.convolve(f, [1.0, 0.5, 0.2])[: len(f)] for f in forces]
    answers = [np.column_stack([own, rng.standard_normal(len(own))]) for own in heard]
    found = comparing.PieceSpectra.of(forces, answers, 40.0, 40)
    assert len(found.force) == 9 + 15
    whole, lines = found.transfer(slice(None)), slice(1, 20)
    np.testing.assert_allclose(whole.frequencies, np.arange(21.0))
    for floor in range(2):
        cross, force, power = (
            sum(count * welch(*pair(f, y[:, floor]), 40) for count, f, y in zip((9, 15), forces, answers, strict=True))
            for pair in (lambda f, y: (f, y), lambda f, y: (f, f), lambda f, y: (y, y))
        )
        np.testing.assert_allclose(whole.functions[lines, floor], (cross / force)[lines])
        np.testing.assert_allclose(whole.coherence[lines, floor], (np.abs(cross) ** 2 / force / power).real[lines])
    one = comparing.PieceSpectra.of(forces[:1], answers[:1], 40.0, 40).transfer(slice(1, 2))
    np.testing.assert_allclose(found.transfer(slice(1, 2), np.arange(9)).functions, one.functions)


def test_resonances_peak_between_lines():
    """The logarithm of a bell curve is a parabola."""
    natural = np.array([3.0, 7.0])
    bell = np.exp(-((LINES - 3.13) ** 2))[:, None] * [1.0, 2.0j]

    def at(frequencies, functions, coherence):
        return comparing.peak(Transfer(frequencies, functions, np.full(functions.shape, coherence)), natural, 0)

    assert at(LINES, bell, 0.61) == pytest.approx(3.13)
    assert at(LINES, np.exp(LINES)[:, None] * [1.0, 2.0], 1.0) is None
    assert at(LINES, np.exp(-LINES)[:, None] * [1.0, 2.0], 1.0) is None
    few = np.array([2.4, 3.1, 3.7, 4.5])
    assert at(few[[0, 1, 3]], np.array([[1.0], [2.0], [1.0]]), 1.0) is None
    assert at(few, np.array([[1.0], [2.0], [1.0], [0.5]]), 1.0) is not None


def test_a_prediction_is_compared_in_size_in_time_and_around_each_mode():
    """One recorded floor reads 10 % too much; the other has noise of a fifth of its motion."""
    samples = 4000
    model = DampedModel(*matrices(*damped_frame(3)), np.array([1.0, 1.0, 0.9]))
    excitation = np.random.default_rng(9).standard_normal(samples)
    plain = response(model, DrivenRun(excitation), 0.01)
    shown = plain.acceleration[:, [0, 2]] * [1.0, 0.9]
    record = shown * [1.1, 1.0]
    run = DrivenRun(excitation, responses=np.column_stack([record, np.full(samples, np.nan)]))
    motion = DrivenRecord((run,), 100.0, floors=np.array([1, 3, 2]))
    found = comparing.compared(model, [plain], motion)
    assert found.floors.tolist() == [1, 3]
    np.testing.assert_allclose(found.nrmse, [0.1 / 1.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.rms_ratio, [1 / 1.1, 1.0])
    np.testing.assert_allclose(found.peak_ratio, [1 / 1.1, 1.0])
    np.testing.assert_allclose(found.frf_error, [[0.1 / 1.1] * 3, [0.0] * 3], atol=1e-9)
    assert found.shifts == ()
    bare = DrivenRecord((DrivenRun(excitation),), 100.0)
    assert comparing.compared(model, [plain], bare) is None
