"""Probabilities of hypotheses, from their likelihoods and priors.

Of hypotheses that exclude each other and of which one is true, hypothesis i has the probability (Bayes)

    p_i = L_i q_i / sum over j of L_j q_j,

L the likelihood of the data and q the prior probability. A conclusion is certain at `cvxshear.util.quantities.SURE`.
"""

import numpy as np
from numpy.typing import ArrayLike

from cvxshear.util.typing import Floats


def weigh(log_likelihoods: ArrayLike, log_priors: ArrayLike = 0.0) -> Floats:
    """Return the probability of each hypothesis; they add up to 1 along the last axis.

    Parameters
    ----------
    log_likelihoods, log_priors : array_like, shape (..., n)
        Each up to a constant. A hypothesis of log likelihood -inf is impossible; one at least must be possible.

    Returns
    -------
    ndarray, shape (..., n)
    """
    scores = np.asarray(log_likelihoods, dtype=np.float64) + np.asarray(log_priors, dtype=np.float64)
    weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))
