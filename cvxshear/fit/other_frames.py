"""Other frames that fit few data as well as the identified one.

The frequencies of a frame of known masses are as many numbers as its stories, and their equations have several roots:
of three frequencies and equal floors, often two frames are exact whose stories differ by a factor of three. Fits from
starting points that are drawn from the prior of the frame end at all of them. The search ends after a number of fits in
a row without a new frame. It also finds frames that are not exact but fit within the noise.

The probability of a frame is the prior density of its logarithms (`fit/domain.py:EffectPrior`) times exp(-chi2 / 2),
relative to the sum over all frames that were found.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import linalg, special

from cvxshear.backends import Backend
from cvxshear.effects.state import Scale, heights_of
from cvxshear.fit.domain import MASS_WIDTH, STIFFNESS_WIDTH, EffectPrior, domain_of
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gauss_newton import Fit, gauss_newton
from cvxshear.fit.misfit import Evaluation
from cvxshear.fit.results import OtherFrame
from cvxshear.util.errors import CvxshearError
from cvxshear.util.typing import Floats

MOST_STORIES_WITH_OTHERS = 5
"""Tallest frame whose other frames are looked for: each further story multiplies their number."""

INSEPARABLE = 5e-3
"""Largest relative difference of masses and stiffnesses of one frame. Frequencies of the usual accuracy, 0.2 %, tell
stiffnesses no closer than this."""

LEAST_PROBABILITY = 1e-3
"""Smallest probability of a frame that is listed."""


def may_have_others(estimate: Estimate) -> bool:
    """Whether the data are frequencies alone, or no more than the unknowns, and determine the frame locally."""
    experiment = estimate.experiment
    if experiment.stories > MOST_STORIES_WITH_OTHERS or experiment.static or estimate.uncertainty.null_directions:
        return False
    return estimate.dof <= 0 or not any(each.measured.any() for each in experiment.configurations)


def other_frames(estimate: Estimate, backend: Backend, unsuccessful: int = 20) -> tuple[OtherFrame, ...]:
    """Find the frames besides an estimate that fit the same data, the most probable first.

    Parameters
    ----------
    estimate : Estimate
        A fit without effects.
    backend : Backend
    unsuccessful : int, optional
        Number of fits a story, in a row, without a new frame that end the search.

    Returns
    -------
    tuple of OtherFrame
        Empty if the data determine one frame (`may_have_others`).
    """
    if not may_have_others(estimate):
        return ()
    found, since = [estimate.fit], 0
    worst = estimate.chi2 - 2.0 * np.log(LEAST_PROBABILITY)
    for start in _starts(estimate):
        if since == unsuccessful * estimate.experiment.stories:
            break
        since += 1
        try:
            domain = domain_of(estimate.experiment, (), start)
            fit = gauss_newton(estimate.misfit, start, domain, backend)
        except CvxshearError:
            continue
        if fit.at.chi2 < worst and all(_apart(fit, other) > INSEPARABLE for other in found):
            found.append(fit)
            since = 0
    n = estimate.experiment.stories
    mass, stiffness = (float(np.median(part)) for part in np.split(estimate.theta, 2))
    prior = EffectPrior(Scale(mass, stiffness, heights_of(estimate.experiment)))
    shares = special.softmax([_log_probability(each, prior) for each in found])
    others = [
        OtherFrame(each.theta[:n], each.theta[n:], each.at.chi2, float(share))
        for each, share in zip(found[1:], shares[1:], strict=True)
        if share >= LEAST_PROBABILITY
    ]
    return tuple(sorted(others, key=lambda each: -each.probability))


def _free(estimate: Estimate) -> Floats:
    """Return an orthonormal basis of the changes of the logarithms that the exact priors leave free, shape (2N, f)."""
    basis: Floats = linalg.null_space(estimate.uncertainty.equalities * estimate.theta)
    return basis


def _starts(estimate: Estimate) -> Iterator[Floats]:
    """Draw starting points from the prior of the frame, about the estimate, with its own level of the stiffness."""
    rng = np.random.default_rng(1)
    n, free = estimate.experiment.stories, _free(estimate)
    width = np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], n)
    while True:
        drawn = width * rng.standard_normal(2 * n)
        drawn[n:] -= drawn[n:].mean()
        yield estimate.theta * np.exp(free @ (free.T @ drawn))


def _apart(one: Fit[Evaluation], other: Fit[Evaluation]) -> float:
    """Return the largest relative difference of a mass or a stiffness."""
    return float(np.max(np.abs(np.log(one.theta / other.theta))))


def _log_probability(fit: Fit[Evaluation], prior: EffectPrior) -> float:
    """Return the logarithm of prior density and likelihood, up to a constant."""
    r, _ = prior.residuals(fit.theta, (), {})[2]
    return -0.5 * (fit.at.chi2 + float(r @ r))
