"""The Cramer-Rao bound of a measurement: no unbiased estimator of its masses and stiffnesses scatters less.

Nothing here comes from the estimator. The modes are those of M^-1/2 K M^-1/2, the derivatives central
differences, and the unknown scale of each measured mode is a parameter of its own that the information
matrix carries. The total mass is known, so that the bound is that of the constrained problem,
Z (Z' I Z)^-1 Z' with Z spanning the changes that keep the total (Stoica and Ng, 1998).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from cvxshear.studies.setups import Setup
from cvxshear.util.typing import Floats

STEP = 1e-5
"""Relative step of the central differences: their error is of its square."""


def cramer_rao(setup: Setup) -> Floats:
    """Smallest covariance of floor masses and story stiffnesses.

    Parameters
    ----------
    setup : Setup

    Returns
    -------
    ndarray, shape (2N, 2N)
        Floor masses first, then story stiffnesses; kg and N/m.

    Notes
    -----
    The standard deviation of multiplicative noise depends on the parameters itself. What that tells of them, a
    part 2 sigma^2 of what the entries tell (half a percent at sigma = 5 %), is left out: the declared standard
    deviations are taken as numbers.
    """
    truth = setup.truth
    unit = np.diag(truth)
    frequencies, shapes = _modal_data(setup, truth)
    spread = np.abs(shapes)
    if setup.mode_shape_noise == "additive":
        spread = np.max(spread, axis=1, keepdims=True)
    std = np.concatenate([
        np.full(len(frequencies), setup.frequency_std),
        np.broadcast_to(setup.mode_shape_std * spread, shapes.shape).ravel(),
    ])  # fmt: skip
    slopes = [
        (_stacked(setup, truth + STEP * row) - _stacked(setup, truth - STEP * row)) / (2 * STEP) for row in unit
    ]  # of relative changes, so that kg and N/m share one size
    scales = linalg.block_diag(*shapes.reshape(len(shapes), -1, 1))
    J = np.hstack([np.array(slopes).T, np.vstack([np.zeros((len(frequencies), len(shapes))), scales])])
    total = np.concatenate([setup.floor_mass, np.zeros(J.shape[1] - setup.stories)])
    Z = linalg.null_space(total[None])
    root = np.linalg.inv(np.linalg.qr((J / std[:, None]) @ Z, mode="r"))
    relative = (Z @ root)[: len(truth)]
    covariance: Floats = unit @ relative @ relative.T @ unit
    return covariance


def bound(setup: Setup) -> Floats:
    """Smallest standard deviation of each floor mass and story stiffness, shape (2N,), kg and N/m."""
    result: Floats = np.sqrt(np.diag(cramer_rao(setup)))
    return result


def _modal_data(setup: Setup, theta: Floats) -> tuple[Floats, Floats]:
    """Logarithms of the measured frequencies, shape (m,), and measured shapes of unit modal mass, shape (m, n)."""
    n = setup.stories
    root = np.sqrt(theta[:n])
    drift = np.eye(n) - np.eye(n, k=-1)
    eigenvalues, vectors = np.linalg.eigh((drift.T * theta[n:]) @ drift / np.outer(root, root))
    shapes = vectors / root[:, None]
    # The largest entry of a mode does not change its sign over a step of the differences.
    shapes = shapes * np.sign(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)])
    which = setup.modes - 1
    return 0.5 * np.log(eigenvalues[which]), shapes[np.ix_(setup.measured_floors - 1, which)].T


def _stacked(setup: Setup, theta: Floats) -> Floats:
    frequencies, shapes = _modal_data(setup, theta)
    return np.concatenate([frequencies, shapes.ravel()])
