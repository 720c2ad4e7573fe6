"""Test standard deviations of modes against least squares, closed forms and random numbers."""

import dataclasses

import numpy as np
import pytest
from scipy import optimize, stats

from cvxshear.records import from_arrays
from cvxshear.records.estimate import independent_std, surrogate
from cvxshear.records.record import Finding

SHAPES = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.7]])
"""Real shapes of two modes at three floors."""


def test_independent_errors_of_shape_entries():
    """The method is least squares with nonnegative variances and a weak preference for equal variances."""
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


def test_a_change_with_amplitude_widens_the_frequency_deviation():
    said = [Finding("amplitude", "", {"mode": mode, "change": change}) for mode, change in ((2, -0.012), (3, 0.006))]
    said += [Finding("sign", "", {"mode": 1, "change": 1.0})]
    given = from_arrays([2.0, 5.0, 9.0], np.eye(3), frequency_std=[0.003, 0.0, 0.004])
    found = dataclasses.replace(given, findings=tuple(said)).written_frequency_std
    spread = [stats.uniform(0.0, 2 * change).std() for change in (0.006, 0.012, 0.006)]
    np.testing.assert_allclose(found, np.hypot([0.003, 0.0, 0.004], spread))


@pytest.mark.parametrize("samples", [40, 41])
def test_surrogates_keep_the_spectra(samples):
    residual = np.random.default_rng(7).standard_normal((samples, 2)).cumsum(axis=0)
    noise = surrogate(residual, np.random.default_rng(8))
    before, after = (np.fft.rfft(each, axis=0) for each in (residual, noise))
    np.testing.assert_allclose(np.abs(after), np.abs(before))
    np.testing.assert_allclose(after[:, 0] * after[:, 1].conj(), before[:, 0] * before[:, 1].conj())
    assert np.std(np.angle(after[1:-1] / before[1:-1])) > 1.0
    np.testing.assert_allclose(noise.mean(axis=0), residual.mean(axis=0))


def test_written_deviations_have_a_minimum():
    """The lower limits are 0.02 % for frequencies, 1 % for known damping ratios and 0.5 % for shape entries."""
    given = from_arrays([2.0, 5.0], SHAPES[:, :2], damping_ratios=[0.01, 0.02], frequency_std=[1e-4, 3e-4],
                        mode_shape_std=0.012)  # fmt: skip
    np.testing.assert_allclose(given.written_frequency_std, [2e-4, 3e-4])
    np.testing.assert_array_equal(given.written_damping_std, [0.0, 0.0])
    np.testing.assert_allclose(given.written_entry_std, 0.013)
    known = dataclasses.replace(given, damping_std=np.array([5e-5, 4e-4]))
    np.testing.assert_allclose(known.written_damping_std, [1e-4, 4e-4])
    assert "damping_ratio_std" not in given.configuration()
    assert known.configuration()["damping_ratio_std"] == pytest.approx([0.01, 0.02])
    assert given.uncertainty_in_words.startswith(
        f"{given.uncertainty}; least values are those of 1 frequencies (0.02 %) and 0 damping ratios (1 %) of 2; "
    )
    assert "of 1 frequencies (0.02 %) and 1 damping ratios (1 %) of 2;" in known.uncertainty_in_words


def test_files_tables_and_json_have_the_same_deviations():
    pytest.importorskip("pandas")
    given = from_arrays([2.0, 5.0], SHAPES[:, :2], damping_ratios=[0.01, 0.02], frequency_std=[1e-4, 3e-4],
                        mode_shape_std=0.012)  # fmt: skip
    plain, table, written = given.to_dict(), given.to_dataframe(), given.configuration()
    np.testing.assert_allclose(plain["frequency_std"], written["frequency_std"])
    np.testing.assert_allclose(table["frequency_std_Hz"] / table["frequency_Hz"], written["frequency_std"])
    assert table.index.tolist() == [1, 2]
    np.testing.assert_array_equal(table[["floor_1", "floor_2"]], given.mode_shapes)
    np.testing.assert_allclose(plain["entry_std"], written["mode_shape_std"])
    np.testing.assert_allclose(plain["damping_std"], table["damping_ratio_std"])
