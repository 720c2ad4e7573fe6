"""Probabilities follow from likelihoods and priors by Bayes."""

import numpy as np

from cvxshear.util.odds import weigh


def test_probabilities_are_likelihood_times_prior_over_their_sum():
    likelihood, prior = np.array([0.2, 0.5, 0.0]), np.array([0.9, 0.05, 0.05])
    with np.errstate(divide="ignore"):
        found = weigh(np.log(likelihood) - 2000.0, np.log(prior))
    np.testing.assert_allclose(found, likelihood * prior / (likelihood @ prior), rtol=1e-12)
    many = weigh(np.log(np.array([[1.0, 3.0], [1.0, 1.0]])))
    np.testing.assert_allclose(many, [[0.25, 0.75], [0.5, 0.5]])
