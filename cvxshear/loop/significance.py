"""Tests: is a residual significant, is a gain, is one fit worse than another."""

from __future__ import annotations

import numpy as np
from scipy import stats

from cvxshear.identification.efficient import Estimate

FAMILY_LEVEL = 0.05
"""Chance of adding an effect to data that have none, over all candidates of a step together."""

RESIDUAL_LEVEL = 0.01
"""Level at which a residual counts as significant when the verdict is given."""

RIVAL_LEVEL = 0.01
"""Level at which a candidate's fit counts as worse than the accepted one's."""


def log_p_gain(before: Estimate, after: Estimate) -> float:
    """Logarithm of the probability of such a gain in chi-square if `before` were true.

    With declared noise the gain is chi-square distributed with as many degrees of freedom as `after` has more
    parameters; where the noise scale is estimated it is compared to the residual that `after` leaves (F test).
    The logarithm does not run out of range where the gain is overwhelming.
    """
    gain = max(before.chi2 - after.chi2, 0.0)
    more = max(before.dof - after.dof, 1)
    if before.experiment.noise_declared:
        return float(stats.chi2.logsf(gain, more))
    if after.dof <= 0 or after.chi2 <= 0:
        return 0.0
    return float(stats.f.logsf(gain / more / (after.chi2 / after.dof), more, after.dof))


def significant_gain(log_p: float, family: int) -> bool:
    """Whether a gain of this log probability is significant as the best of a family of candidates (Bonferroni)."""
    return bool(log_p + np.log(max(family, 1)) < np.log(FAMILY_LEVEL))


def not_worse(candidate: Estimate, accepted: Estimate) -> bool:
    """Whether the data cannot tell a candidate's fit from the accepted one's.

    Were the candidate true and the two models' predictions D standard deviations apart, its chi-square would
    exceed the other's by more than delta with probability Phi(-(delta + D^2) / (2 D)), at most
    Phi(-sqrt(delta)) whatever D. So the candidate is dropped where sqrt(delta) exceeds the normal quantile of
    the level, delta in units of the noise.
    """
    delta = candidate.chi2 - accepted.chi2
    if not accepted.experiment.noise_declared and accepted.dof > 0 and accepted.chi2 > 0:
        delta *= accepted.dof / accepted.chi2
    return bool(delta <= float(stats.norm.isf(RIVAL_LEVEL)) ** 2)
