"""Distance between models of one frame in a test that was not made.

The predictions of two models differ by d, in standard deviations of the test's noise. The uncertainty of each model
moves its own prediction along columns S, one standard deviation per column. So d has the covariance 1 + S S', and the
distance between the models, in standard deviations, is

    D = sqrt(d' (1 + S S')^-1 d).

The same formula holds for effects before any fit: d is then the change of the data by each effect, and S the possible
change by the frame's masses and stiffnesses.

The information of such a test about one effect is the linear model y = G x + e, with the effect's value x, G = D^2 at x
= 1 and var(e) = G. `log_evidence` is the ratio of the probabilities of y with and without the effect: the evidence of
the loop, where Laplace's approximation is exact.
"""

import numpy as np
from scipy.special import log_ndtr

from cvxshear.util.typing import Floats


def separation(differences: Floats, uncertain: Floats) -> Floats:
    """Compute squared distances of models, d' (1 + S S')^-1 d; entries off the diagonal are their scalar products.

    Parameters
    ----------
    differences : ndarray, shape (k, e)
        d, a column a model, in standard deviations of the noise.
    uncertain : ndarray, shape (k, q)
        S.

    Returns
    -------
    ndarray, shape (e, e)
    """
    k, q = uncertain.shape
    if k <= q:
        # The left singular vectors of S span all k dimensions, and no large variance is inverted.
        left, values, _ = np.linalg.svd(uncertain, full_matrices=False)
        along = (left.T @ differences) / np.hypot(1.0, values)[:, None]
        return np.asarray(along.T @ along, dtype=np.float64)
    # The same as the residual of d after a regularized fit by the columns of S.
    basis = np.linalg.qr(np.concatenate([uncertain, np.eye(q)]))[0]
    left = np.concatenate([differences, np.zeros((q, differences.shape[1]))])
    left = left - basis @ (basis.T @ left)
    return np.asarray(left.T @ left, dtype=np.float64)


def log_evidence(information: float, y: Floats, mean: float, std: float, side: int = 0) -> Floats:
    """Compute the log evidence ratio of the models with and without an effect of one parameter.

    With a normal prior of the effect's value x about `mean`, and data y with var(y) = G,

        (1 + s^2 G)^(-1/2) exp(m^2 / (2 v) - mean^2 / (2 s^2)),  v = 1 / (G + 1 / s^2),  m = v (y + mean / s^2),

    times 2 Phi(m / sqrt(v)) if physics allows values on one side of zero only.

    Parameters
    ----------
    information : float
        G, about the effect's value, with the frame marginalized.
    y : ndarray
        G x + e.
    mean, std : float
        Prior of the effect's value.
    side : int, optional
        1 or -1 if the value can only be on that side of zero, else 0.

    Returns
    -------
    ndarray
        Log evidence ratios, in the shape of y.
    """
    v = 1 / (information + 1 / std**2)
    m = v * (y + mean / std**2)
    found: Floats = m**2 / (2 * v) - mean**2 / (2 * std**2) - np.log1p(std**2 * information) / 2
    return found if side == 0 else found + np.log(2) + log_ndtr(side * m / np.sqrt(v))
