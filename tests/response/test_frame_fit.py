"""What a record says of changed stories, where the likelihood is linear: against normal distributions written out."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cvxshear.response.frame_prior import (
    FORM_STDS,
    GAIN_STDS,
    LEAST_WEIGHT,
    MASS_STDS,
    SCATTER_STDS,
    Gaussian,
    Linear,
    possible_answers,
)
from cvxshear.response.innovations import Likelihood

STORIES, CHANGE, PROBABILITY = 3, 0.5, 0.07
SINGLE, OFF, PROBABILITY_OFF = np.array([0, 1, 2, 4]), 0.8, 0.04
"""Three stories and one gain, the last of five unknowns."""
EITHER = np.zeros(3, dtype=bool)
"""Unknowns that may have either sign."""


def drawn(seed, inflation=1.7):
    """A likelihood of five unknowns, three stories and a gain among them, and where it was linearised."""
    rng = np.random.default_rng(seed)
    return Likelihood(3.0 * rng.standard_normal((6, 5)), rng.standard_normal(6), inflation), rng.standard_normal(5)


def gaussian(changed, form_std, scatter_std=0.003, mass_std=0.0, gain_std=0.001):
    """A prior whose mean, covariance and evidence depend on how well its form is known."""
    wide = (form_std + 20 * scatter_std + 5 * mass_std + 8 * gain_std) ** 2
    spread = np.diag([0.1, 0.2, 0.1, 0.5, 0.5]) ** 2 + 0.3 * form_std + wide * np.eye(5)
    at = SINGLE[list(changed)]
    spread[at, at] += np.where(at < STORIES, CHANGE, OFF) ** 2
    return Gaussian(np.array([0.1, -0.1, 0.0, 0.2, form_std]), spread, -30.0 * form_std)


def log_density(at, p, prior):
    """log of the normal density of what was seen, U x + c of variance `inflation` about zero for the true x."""
    seen = at.U @ (p - prior.mean) - at.c
    spread = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(seen))
    return stats.multivariate_normal.logpdf(seen, np.zeros(len(seen)), spread)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_and_posterior_are_those_of_a_normal_distribution(seed):
    (at, p), prior = drawn(seed), gaussian((), 0.03)
    linear, freed = Linear(at, p, prior), gaussian((0, 2), 0.03)
    alone, both = linear.evidence(CHANGE * np.eye(5, 3)).of([(), (0, 2)], EITHER)
    assert both - alone == pytest.approx(log_density(at, p, freed) - log_density(at, p, prior))
    other = gaussian((), 0.1)
    (found,) = Linear(at, p, other).evidence(CHANGE * np.eye(5, 3)).of([()], EITHER)
    assert found - alone == pytest.approx(log_density(at, p, other) - log_density(at, p, prior) - 30.0 * (0.1 - 0.03))
    mean, covariance = linear.posterior()
    expected = np.linalg.inv(np.linalg.inv(prior.covariance) + at.U.T @ at.U / at.inflation)
    np.testing.assert_allclose(covariance, expected, atol=1e-10)
    seen = at.U @ (p - prior.mean) - at.c
    np.testing.assert_allclose(mean, prior.mean + expected @ at.U.T @ seen / at.inflation, atol=1e-9)


def test_what_is_positive_has_no_evidence_where_it_would_be_negative():
    """One unknown of each sign, seen directly: along a column that must be positive the negative one is left out."""
    at = Likelihood(np.eye(2), np.array([-2.0, 2.0]), 1.0)
    linear = Linear(at, np.zeros(2), Gaussian(np.zeros(2), 0.01 * np.eye(2), 0.0))
    sets = [(), (0,), (1,), (0, 1)]
    either, positive = (linear.evidence(np.eye(2)).of(sets, np.array([side, side])) for side in (False, True))
    assert np.isfinite(positive).tolist() == [True, True, False, False]
    np.testing.assert_array_equal(positive[:2], either[:2])


@pytest.mark.parametrize("seed", range(3))
def test_answers_have_the_probabilities_of_all_sets_of_changes_and_of_all_widths(seed):
    """Odds of 0.07 a changed story, 0.04 a gain; all sizes of form's errors, scatter, masses and gains as probable."""
    at, p = drawn(seed)
    chance = np.array([PROBABILITY] * STORIES + [PROBABILITY_OFF])
    log_odds = np.log(chance / (1 - chance))
    prior = SimpleNamespace(
        single=SINGLE, single_std=np.array([CHANGE] * STORIES + [OFF]), log_odds=log_odds, gaussian=gaussian,
        mass_stds=MASS_STDS, gain_stds=GAIN_STDS, one_sided=np.zeros(len(SINGLE), dtype=bool),
    )  # fmt: skip
    found = possible_answers(at, prior, p)
    logs = {
        (changed, *widths): log_density(at, p, gaussian(changed, *widths)) - 30.0 * widths[0]
        + log_odds[list(changed)].sum()
        for size in range(STORIES + 1)
        for changed in itertools.combinations(range(len(SINGLE)), size)
        for widths in itertools.product(FORM_STDS, SCATTER_STDS, MASS_STDS, GAIN_STDS)
    }  # fmt: skip
    best = max(logs.values())
    kept = {key: np.exp(value - best) for key, value in logs.items() if value > best + np.log(LEAST_WEIGHT)}
    total = sum(kept.values())
    assert len(found) == len(kept) > 4
    assert sum(each.probability for each in found) == pytest.approx(1.0)
    for each in found:
        assert each.probability == pytest.approx(kept[each.prior] / total)
    assert [each.probability for each in found] == sorted((each.probability for each in found), reverse=True)
