"""A small seeded part of the calibration study against what chance leaves; the whole of it is tests.calibration."""

import pytest
from scipy import stats

from tests.calibration import Trial, coverage, false_additions, outcome, reliability

SEED = 7_000_000
TALLEST = 4
"""Stories: taller frames take longer and are no harder."""

FOUND = (
    "joint_rotation", "axial_columns", "base_rocking", "ground_spring", "added_mass", "mass_coupling", "sensor_gain",
    "story_change", "gravity",
)  # fmt: skip
LEVEL = 1e-3
"""Probability that chance fails a sound library; the seeds being fixed, it fails always or never."""


def trials():
    several = [Trial((name,), 3, SEED + at, None, TALLEST) for at, name in enumerate(FOUND)]
    pairs = [Trial(("ground_spring", "story_change"), 3, SEED + 50, None, TALLEST)]
    nothing = [
        Trial((), 3, SEED + 100 * at + i, noise, TALLEST)
        for at, noise in enumerate((None, (0.01, 0.01), (0.002, 0.002)), 1)
        for i in range(4)
    ]
    return [*several, *pairs, *nothing]


@pytest.fixture(scope="module")
def outcomes():
    return [outcome(trial) for trial in trials()]


def least(count, probability):
    """Fewest of so many that chance leaves."""
    return int(stats.binom.ppf(LEVEL, count, probability))


def test_exactly_the_right_set_in_three_configurations(outcomes):
    there = [item for item in outcomes if item.wanted]
    assert sum(item.word == "exact" for item in there) >= least(len(there), 0.97)


def test_nothing_is_added_where_there_is_nothing(outcomes):
    rows = false_additions(outcomes)
    added, frames = sum(count for count, _ in rows.values()), sum(count for _, count in rows.values())
    assert frames == 12
    assert added <= int(stats.binom.isf(LEVEL, frames, 0.05))


def test_probabilities_are_honest(outcomes):
    """Of what is named, as many are there as their probabilities add up to."""
    rows = reliability(outcomes)
    named, there = sum(row[2] for row in rows), sum(row[3] for row in rows)
    assert named >= 10
    mean = sum(row[2] * row[4] for row in rows) / named
    assert there >= least(named, mean)


def test_standard_deviations_of_the_averaged_frame_cover_the_truth(outcomes):
    """Each interval holds it in 95 of 100; masses and stiffnesses of one frame err together, so frames are counted."""
    covered, count = coverage(outcomes)
    assert covered / count > 0.95 - 4 * (0.05 * 0.95 / count) ** 0.5 * 2
    assert covered / count < 1.0
