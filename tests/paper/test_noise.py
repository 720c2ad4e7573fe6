"""Test Table 3 and Fig. 6 against random scatter."""

import numpy as np
import pytest


def section_of(reproduction, title):
    """Return the first section whose title begins with these words."""
    return next(each for each in reproduction.sections if each.title.startswith(title))


@pytest.mark.parametrize(
    "title", ["Table 3: error of the mean, 100 samples", "Table 3: error of the mean, 1,000 samples"]
)
def test_chance_explains_table_3(reproduction, title):
    section = section_of(reproduction, title)
    distances = np.array([row.distance for row in section.rows])
    assert len(distances) == 30
    assert np.max(np.abs(distances)) < 3.5
    # If the printed figures came from another method, the distances would not be of order one.
    assert 0.4 < np.sqrt(np.mean(distances**2)) < 1.5
    assert "Chance explains the printed figures." in section.notes[0]


def test_the_standard_error_falls_with_the_samples(reproduction):
    few, many = (section_of(reproduction, f"Table 3: error of the mean, {count} samples") for count in ("100", "1,000"))
    ratios = [a.std_error / b.std_error for a, b in zip(few.rows, many.rows, strict=True)]
    # sqrt(1000 / 100); the standard deviation of 100 samples scatters by 7 %.
    assert np.mean(ratios) == pytest.approx(np.sqrt(10), rel=0.08)


def test_the_mean_is_within_one_percent(reproduction):
    """Test the paper's claim at a noise level with small random scatter."""
    rows = section_of(reproduction, "Table 3: error of the mean, 1,000 samples").rows
    assert max(abs(row.recomputed) for row in rows) < 1.0


def test_the_coefficients_of_variation(reproduction):
    rows = section_of(reproduction, "Fig. 6").rows
    # The reference figures come from another 2,000 samples, rounded to 0.1.
    for row, reference in zip(rows, [4.5, 5.2, 6.5, 8.0, 4.0, 6.0], strict=True):
        assert abs(row.recomputed - reference) < 0.05 + 3 * np.sqrt(2) * row.std_error
