"""Test the measured records of shared/data with the default settings; expected values come from the issue."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.io.modes import modes_from_file
from tests.records.shared import mini_table, needs_mini_table, needs_southampton, southampton

FLEXIBLE = ([3.68, 11.12, 16.60], [(0.427, 0.810, 1), (1, 0.372, -0.773), (-0.745, 1, -0.537)])
STIFF = ([7.82, 25.05, 39.75], [(0.429, 0.831, 1), (1, 0.251, -0.792), (-0.680, 1, -0.653)])


@functools.cache
def mini(name, **options):
    """Return the (cached) result for one record of the mini table."""
    with tempfile.TemporaryDirectory() as folder:
        return modes_from_file(mini_table(Path(folder), name), **options)[0]


@needs_mini_table
@pytest.mark.parametrize(("name", "expected"), [("flexible-northridge", FLEXIBLE), ("stiff-northridge", STIFF)])
def test_mini_table(name, expected):
    """The third floor's clock is 1 to 3 ms late in both records."""
    frequencies, shapes = expected
    result = mini(name)
    np.testing.assert_allclose(result.frequencies, frequencies, rtol=0.005)
    # The expected values are real parts on the main axis, beside the phases of the late clock of floor 3.
    late = [finding.numbers for finding in result.findings if finding.kind == "clock offset"]
    (third,) = (each["seconds"] for each in late if each["channel"] == "floor3_x")
    assert 0.001 < third < 0.003
    assert all(abs(each["seconds"]) < 0.003 for each in late)
    turned = result.mode_shapes.astype(complex)
    turned[:, 2] *= np.exp(-2j * np.pi * result.frequencies * third)
    real = (turned * np.exp(-0.5j * np.angle(np.sum(turned**2, axis=1, keepdims=True)))).real
    largest = np.take_along_axis(real, np.abs(shapes).argmax(axis=1)[:, None], axis=1)
    np.testing.assert_allclose(real / largest, shapes, atol=0.025)
    np.testing.assert_array_equal(result.modes, [1, 2, 3])
    assert result.mass_normalized is False


@needs_mini_table
@pytest.mark.parametrize(("sine", "earthquake"), [("stiff-sine-2.0", "stiff-northridge")])
def test_a_sensor_a_sample_off_changes_no_shape(sine, earthquake):
    """The first floor's sensor is one sample of 120 Hz later in the sine record than in the earthquake record."""
    first, second = mini(sine), mini(earthquake)
    apart = [each.clock_offsets["floor1_x"][0] - each.clock_offsets["floor2_x"][0] for each in (first, second)]
    assert apart[0] - apart[1] == pytest.approx(1 / 120, abs=8e-4)
    np.testing.assert_allclose(first.mode_shapes, second.mode_shapes, atol=0.012)


@needs_mini_table
def test_frequencies_that_depend_on_amplitude_are_found():
    result = mini("flexible-northridge")
    changes = [finding.numbers["change"] for finding in result.findings if finding.kind == "amplitude"]
    assert changes
    assert all(change < 0 for change in changes)


@needs_southampton
def test_southampton(tmp_path):
    result, declared = modes_from_file(southampton(tmp_path), output=tmp_path / "test.toml")
    np.testing.assert_allclose(result.frequencies, [6.512, 17.461, 26.502], rtol=3e-4)
    np.testing.assert_allclose(result.damping_ratios, [0.0017, 0.0024, 0.0022], atol=1e-4)
    scaled = result.mode_shapes / np.max(np.abs(result.mode_shapes), axis=1, keepdims=True)
    np.testing.assert_allclose(scaled, [(0.479, 0.827, 1), (1, 0.358, -0.783), (-0.723, 1, -0.480)], atol=0.005)
    assert result.mass_normalized
    masses = np.diag(np.linalg.inv(result.mode_shapes.T @ result.mode_shapes))
    assert np.all((masses > 4.8) & (masses < 5.4))
    written = cvxshear.load(tmp_path / "test.toml")
    np.testing.assert_allclose(written.configurations[0].frequencies, result.frequencies, rtol=1e-7)
    assert "total_mass" not in declared["frame"]


@needs_southampton
def test_southampton_is_not_reciprocal(tmp_path):
    result, _ = modes_from_file(southampton(tmp_path))
    violations = [finding for finding in result.findings if finding.kind == "reciprocity"]
    largest = max(violations, key=lambda finding: finding.numbers["largest"])
    assert largest.numbers["floors"] == [1, 3]
    assert largest.numbers["largest"] == pytest.approx(0.08, abs=0.01)


@needs_southampton
def test_southampton_was_cut_off(tmp_path):
    """Mode 1 still vibrates at 32 s, exp(-0.0017 * 2 pi 6.51 * 32) = 0.11; its correction affects the masses."""
    result, _ = modes_from_file(southampton(tmp_path))
    leak = next(finding for finding in result.findings if finding.kind == "leakage")
    assert leak.numbers["left"] == pytest.approx(0.108, abs=0.01)
    assert leak.numbers["truncated"] is True
    other, _ = modes_from_file(southampton(tmp_path, "truncated = false"))
    np.testing.assert_allclose(other.frequencies, result.frequencies, rtol=1e-9)
    np.testing.assert_allclose(other.damping_ratios, result.damping_ratios, rtol=1e-9)
    of_diagonal = []
    for item in (result, other):
        mass = np.linalg.inv(item.mode_shapes.T @ item.mode_shapes)
        of_diagonal.append(np.abs(mass - np.diag(np.diag(mass))).max())
    assert of_diagonal[0] < 0.05
    assert of_diagonal[1] > 0.1
