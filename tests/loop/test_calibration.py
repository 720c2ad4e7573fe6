"""Compare a small seeded part of the calibration study (`tests/studies/calibration.py`) with limits of chance."""

import pytest
from scipy import stats

from tests.closed import close_loop
from tests.studies.calibration import EFFECTS, Trial, coverage, outcome
from tests.studies.drawn import chance
from tests.studies.outside import outcome as outcome_outside

SEED = 7_000_000
TALLEST = 4
"""Maximum number of stories: taller frames take longer and are no harder."""

FOUND = [name for name in EFFECTS if name]
"""Effects whose loops `test_loop.py` closes too, with the same seed."""

LEVEL = 0.05
"""Probability that chance fails a good loop. The seeds are fixed, so one loop passes always or never."""


def trials():
    several = [Trial((name,), 3, 11) for name in FOUND]
    pairs = [Trial(("ground_spring", "story_change"), 3, SEED + 50, None, TALLEST)]
    nothing = [
        Trial((), 3, SEED + 100 * at + i, noise, TALLEST)
        for at, noise in enumerate((None, (0.01, 0.01), (0.002, 0.002)), 1)
        for i in range(4)
    ]
    return [*several, *pairs, *nothing]


@pytest.fixture(scope="module")
def outcomes():
    return [outcome(trial, close_loop) for trial in trials()]


def test_little_is_added_where_there_is_nothing(outcomes):
    nothing = [item for item in outcomes if not item.trial.effects]
    assert sum(bool(item.found) for item in nothing) <= int(stats.binom.isf(LEVEL, len(nothing), 0.05))


def test_probabilities_are_honest(outcomes):
    """The number of real effects among the named ones agrees with the sum of their probabilities."""
    odds = [item for each in outcomes for item in each.odds]
    assert len(odds) >= 10
    assert chance([p for p, _ in odds], sum(there for _, there in odds)) > LEVEL


def test_standard_deviations_of_the_averaged_frame_cover_the_truth(outcomes):
    """Each interval holds the truth in 95 of 100 cases. Errors in one frame are correlated: eight count like four."""
    covered, count = coverage(outcomes)
    assert count > 100
    assert covered / count > 0.95 - 2 * (2 * 0.05 * 0.95 / count) ** 0.5
    assert covered / count < 1.0


@pytest.mark.parametrize("kind", ["wall beside the frame", "wall of half the height"])
def test_a_wall_is_found_up_to_its_top(kind):
    """The wall is made from the closed form of a cantilever, under moments, too."""
    found = outcome_outside((kind, 977_001))
    assert [name for name, _ in found.named] == ["wall"]
    assert found.covered[0] >= found.covered[1] - 1
