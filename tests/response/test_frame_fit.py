"""Test a record's evidence of changed stories with a linear likelihood, against explicit normal distributions."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cvxshear.response.frame_fit import FittedFrame, _log_evidence, _mixed, _Posterior, refitted
from cvxshear.response.frame_prior import (
    FORM_STDS,
    GAIN_STDS,
    LEAST_WEIGHT,
    MASS_STDS,
    SCATTER_STDS,
    FrameChange,
    FramePrior,
    Gaussian,
    Linear,
    possible_answers,
)
from cvxshear.response.innovations import Likelihood
from cvxshear.response.varied_frame import GAIN_UNIT

STORIES, CHANGE, PROBABILITY = 3, 0.5, 0.07
SINGLE, OFF, PROBABILITY_OFF = np.array([0, 1, 2, 4]), 0.8, 0.04
"""Columns of single changes (three stories, one gain) among five unknowns; deviation and probability of the gain."""
EITHER = np.zeros(3, dtype=bool)
"""Sign constraints: no unknown has one."""


def drawn(seed, inflation=1.7):
    """Draw a likelihood of five unknowns, among them three stories and a gain, and its linearization point."""
    rng = np.random.default_rng(seed)
    return Likelihood(3.0 * rng.standard_normal((6, 5)), rng.standard_normal(6), inflation), rng.standard_normal(5)


def gaussian(changed, form_std, scatter_std=0.003, mass_std=0.0, gain_std=0.001):
    """Return a prior whose mean, covariance and evidence depend on the deviation of the form."""
    wide = (form_std + 20 * scatter_std + 5 * mass_std + 8 * gain_std) ** 2
    spread = np.diag([0.1, 0.2, 0.1, 0.5, 0.5]) ** 2 + 0.3 * form_std + wide * np.eye(5)
    at = SINGLE[list(changed)]
    spread[at, at] += np.where(at < STORIES, CHANGE, OFF) ** 2
    return Gaussian(np.array([0.1, -0.1, 0.0, 0.2, form_std]), spread, -30.0 * form_std)


def log_density(at, p, prior):
    """Return the log density of the normal data U x + c about zero, with variance `inflation`, at the true x."""
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
    """Two directly measured unknowns, one of each sign: the negative one is omitted if its column must be positive."""
    at = Likelihood(np.eye(2), np.array([-2.0, 2.0]), 1.0)
    linear = Linear(at, np.zeros(2), Gaussian(np.zeros(2), 0.01 * np.eye(2), 0.0))
    sets = [(), (0,), (1,), (0, 1)]
    either, positive = (linear.evidence(np.eye(2)).of(sets, np.array([side, side])) for side in (False, True))
    assert np.isfinite(positive).tolist() == [True, True, False, False]
    np.testing.assert_array_equal(positive[:2], either[:2])


@pytest.mark.parametrize("seed", range(3))
def test_answers_have_the_probabilities_of_all_sets_of_changes_and_of_all_widths(seed):
    """The odds are 0.07 for a changed story and 0.04 for a gain; all error widths are equally probable."""
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


def fitted(**more):
    """Return a frame with 14 unknowns: damping, nuisances, gains, a form error and noises.

    The frame has three stories, two sensors and a ground sensor. Each factor is a product of powers of two unknowns.
    """
    rng = np.random.default_rng(8)
    root = 0.1 * rng.standard_normal((17, 17))
    powers = 0.3 * rng.standard_normal((3, 14))

    def story_factors(p):
        factors = np.exp(powers @ p)
        return factors, factors[:, None] * powers

    varied = SimpleNamespace(
        story_factors=story_factors, sizes=(3, 5, 5, 1), dashpots=slice(5, 8), dashpot=np.array([20.0, 30.0, 40.0]),
        gains=3, sensor_gains=slice(10, 13), heavier_floors=0.3 * rng.standard_normal((14, 3)),
    )  # fmt: skip
    setting = SimpleNamespace(floors=np.array([1, 3]), base_measured=True, force_floor=0)
    errors = SimpleNamespace(varied=varied, setting=setting, stories=3, frame=slice(0, 14), size=17)
    wide = rng.standard_normal((17, 17))
    base = 0.1 * wide @ wide.T

    def prior_of(changed, form_std, scatter_std, mass_std, gain_std):
        heavier = np.vstack([varied.heavier_floors, np.zeros((3, 3))])
        return Gaussian(np.full(17, 0.01), base + mass_std**2 * heavier @ heavier.T, 0.0)

    prior = SimpleNamespace(identified=0.002 * np.ones((3, 3)), varied=varied, gaussian=prior_of, others=3)
    answers = (
        FrameChange((1,), 0.03, 0.003, 0.0, 0.001, 0.5), FrameChange((1, 4), 0.03, 0.003, 0.05, 0.001, 0.3),
        FrameChange((0, 7), 0.03, 0.003, 0.1, 0.001, 0.2),
    )  # fmt: skip
    values = {"answers": answers, "p": 0.2 * rng.standard_normal(17), "covariance": root @ root.T} | more
    return FittedFrame(errors, prior, values["p"], values["covariance"], values["answers"], 1.3, True, None, -7.0)


def moved_by(function, at, covariance):
    """Return standard deviations of a function of normal numbers by differences."""
    steps = 1e-6 * np.eye(len(at))
    J = np.array([(function(at + step) - function(at - step)) / 2e-6 for step in steps]).T
    return np.sqrt(np.sum((J @ covariance) * J, axis=1))


def test_a_fitted_frame_says_what_its_unknowns_mean():
    frame = fitted()
    np.testing.assert_allclose(frame.story_probability, [0.2, 0.8, 0.0])
    np.testing.assert_allclose(frame.dashpot_probability, [0.0, 0.3, 0.0])
    np.testing.assert_allclose(frame.gain_probability, [0.0, 0.2, 0.0])
    assert frame.mass_probability == pytest.approx(0.5)
    p, spread = frame.p, frame.covariance
    unit = np.array([20.0, 30.0, 40.0])
    np.testing.assert_allclose(frame.dashpots, (unit * p[5:8], unit * np.sqrt(np.diag(spread)[5:8])))

    def gains(z):
        return np.exp(GAIN_UNIT * z[10:13] * [1, 1, -1]) - 1

    value, std = frame.gains
    np.testing.assert_allclose(value, gains(p))
    np.testing.assert_allclose(std, moved_by(gains, p, spread), rtol=1e-6)


def test_factors_of_stories_are_as_uncertain_as_all_that_moves_them():
    """The variance includes the identified stiffnesses, masses and effects, and the unknowns of the record."""
    frame = fitted()
    factors = frame.errors.varied.story_factors
    expected, J = factors(frame.p[:14])
    np.testing.assert_allclose(frame.factors, expected)
    spread = J @ frame.covariance[:14, :14] @ J.T + 0.002 + J[:, 8:13] @ J[:, 8:13].T
    # Changed floors have probability 0.5. The total of three floors has one floor's deviation over the root of three.
    scale = 0.05 * np.sqrt(0.5 / 3)
    assert frame.scale_std == pytest.approx(scale)
    np.testing.assert_allclose(frame.factors_std, np.sqrt(np.diag(spread) + scale**2))
    mean, std = frame.mean_factor
    assert (mean, std) == (pytest.approx(expected.mean()), pytest.approx(np.sqrt(spread.mean() + scale**2)))
    weights = 1.0 - frame.story_probability

    def against(f):
        return np.array([f[j] / np.average(np.delete(f, j), weights=np.delete(weights, j)) - 1 for j in range(3)])

    change, std = frame.against_others
    np.testing.assert_allclose(change, against(expected))
    np.testing.assert_allclose(std, moved_by(against, expected, spread), rtol=1e-6)
    for key, value in (("base_measured", False), ("force_floor", 2)):
        other = fitted()
        setattr(other.errors.setting, key, value)
        assert other.scale_std == 0.0


def test_a_frame_of_one_story_is_compared_with_itself_as_it_was():
    one = fitted()
    one.errors.stories, one.errors.varied.dashpot = 1, np.zeros(7)
    one.errors.varied.story_factors = lambda p: (np.array([0.9]), np.ones((1, 14)))
    one.prior.identified = np.zeros((1, 1))
    change, std = one.against_others
    assert change == pytest.approx(-0.1)
    assert std == pytest.approx(np.sqrt(one.covariance[:14, :14].sum() + 5))


def test_masses_changed_by_what_a_normal_number_is_given_the_unknowns():
    """The expected values come from the joint precision of masses and unknowns under the best answer with masses."""
    frame = fitted()
    heavier = np.vstack([frame.prior.varied.heavier_floors, np.zeros((3, 3))])
    prior = frame.prior.gaussian((1, 4), 0.03, 0.003, 0.05, 0.001)
    joint = np.block([[0.0025 * np.eye(3), 0.0025 * heavier.T], [0.0025 * heavier, prior.covariance]])
    precision = np.linalg.inv(joint)
    given = np.linalg.inv(precision[:3, :3])
    G = -given @ precision[:3, 3:]
    value, std = frame.mass_change
    np.testing.assert_allclose(value, G @ (frame.p - 0.01), rtol=1e-6)
    np.testing.assert_allclose(std, np.sqrt(np.diag(given + G @ frame.covariance @ G.T)), rtol=1e-6)
    none = fitted(answers=fitted().answers[:1]).mass_change
    np.testing.assert_array_equal(none, np.zeros((2, 3)))


def test_a_mixture_of_answers_has_their_mean_square_about_the_best():
    """The record's log evidence is the best answer's log evidence minus the log of its probability."""
    at, p = drawn(4, inflation=1.2)
    answers = [FrameChange((), 0.03, 0.003, 0.0, 0.001, 0.6), FrameChange((1,), 0.1, 0.01, 0.05, 0.001, 0.2)]
    prior = SimpleNamespace(gaussian=gaussian, log_odds=np.array([-1.0, -2.0, -3.0, -4.0]))
    posterior = SimpleNamespace(along=None, errors=SimpleNamespace(objective=lambda p: 50.0))
    point = SimpleNamespace(likelihood=at, p=p, posterior=posterior)
    found = _mixed(SimpleNamespace(size=5), prior, point, answers, True)
    covariance = np.zeros((5, 5))
    for each, share in zip(answers, (0.75, 0.25), strict=True):
        own = gaussian(*each.prior)
        spread = np.linalg.inv(np.linalg.inv(own.covariance) + at.U.T @ at.U / at.inflation)
        off = own.mean + spread @ at.U.T @ (at.U @ (p - own.mean) - at.c) / at.inflation - p
        covariance += share * (spread + np.outer(off, off))
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-9)
    assert found.inflation == 1.2
    logs = [_log_evidence(point, prior, [each]) for each in answers]
    other = [log_density(at, p, gaussian(*each.prior)) - 30.0 * each.form_std - np.log(each.probability) for each in
             answers]  # fmt: skip
    assert logs[1] - logs[0] == pytest.approx(other[1] - other[0] - 2.0)
    assert found.log_evidence == logs[0]
    posterior.errors.objective = lambda p: 54.0
    assert _log_evidence(point, prior, answers) == pytest.approx(logs[0] - 2.0)
    # These data carry no information on the unknowns. The objective holds the whole misfit.
    nothing = SimpleNamespace(U=0.0 * at.U, c=at.c, inflation=1.0)
    alone = _log_evidence(SimpleNamespace(likelihood=nothing, p=p, posterior=posterior), prior, answers)
    assert alone == pytest.approx(-0.5 * 54.0 - 30.0 * 0.03 - np.log(0.6))


def test_a_frame_that_is_not_fitted_again_without_a_sensor_stays_as_it_was():
    frame = fitted()
    prior = FramePrior(frame.errors.varied, 3, frame.prior.identified, 0.4, 0.05, 0.1, 0.02, None)
    frame = dataclasses.replace(frame, prior=prior, inflation=1.9, converged=False)
    found = refitted(frame, "errors", 14, None, 0)
    left = np.delete(np.arange(17), 14)
    np.testing.assert_array_equal(found.p, frame.p[left])
    np.testing.assert_array_equal(found.covariance, frame.covariance[np.ix_(left, left)])
    assert (found.errors, found.prior.others, found.inflation, found.converged) == ("errors", 2, 1.0, True)
    assert (found.answers, found.log_evidence) == (frame.answers, -7.0)


def test_gauss_newton_sees_the_posterior_of_tempered_innovations():
    """For a linear likelihood, |r|^2 = -2 log(likelihood^(1/inflation) * prior), and J is the derivative of r."""
    at, p = drawn(5)
    prior = gaussian((1,), 0.03)
    errors = SimpleNamespace(
        objective=lambda q: float(np.sum((at.U @ (q - p) + at.c) ** 2)),
        linearised=lambda q, along: Likelihood(at.U, at.U @ (q - p) + at.c, 1.0),
    )
    posterior, q = _Posterior(errors, None, prior, 2.5), p + 0.3

    def expected(q):
        return errors.objective(q) / 2.5 + (q - prior.mean) @ np.linalg.solve(prior.covariance, q - prior.mean)

    point = posterior.evaluate(q)
    assert point.objective == pytest.approx(expected(q))
    assert point.r @ point.r == pytest.approx(expected(q))
    slope = [(expected(q + step) - expected(q - step)) / 2e-4 for step in 1e-4 * np.eye(5)]
    np.testing.assert_allclose(2 * point.J.T @ point.r, slope, rtol=1e-6, atol=1e-5)
    normal = at.U.T @ at.U / 2.5 + np.linalg.inv(prior.covariance)
    np.testing.assert_allclose(point.J.T @ point.J, normal)


def test_what_may_have_changed_by_itself_has_the_odds_of_its_kind():
    """For three stories, dashpots and gains; the stories share the probability of a dashpot."""
    frame = fitted()
    prior = FramePrior(frame.errors.varied, 3, frame.prior.identified, 0.4, 0.05, 0.1, 0.02, None)
    np.testing.assert_array_equal(prior.single, [0, 1, 2, 5, 6, 7, 10, 11, 12])
    chance = 1 / (1 + np.exp(-prior.log_odds))
    np.testing.assert_allclose(chance[:3], 0.1)
    np.testing.assert_allclose((1 - chance[3:6]) ** 3, 0.9)
    np.testing.assert_allclose(chance[6:], 0.02)
    assert prior.one_sided.tolist() == [False] * 3 + [True] * 3 + [False] * 3
    np.testing.assert_array_equal(prior.idle_dashpots((1, 4)), [5, 7])
    np.testing.assert_allclose(prior.single_std[:3], 0.4)
    alone = dataclasses.replace(prior, gain_stds=(0.001,))
    np.testing.assert_array_equal(alone.single, [0, 1, 2, 5, 6, 7])
