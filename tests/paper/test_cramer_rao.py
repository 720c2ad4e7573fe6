"""Compare the Cramer-Rao bound with published figures, a frame solved by hand, and an independent information matrix.

The matrix uses nothing from the package: the modes come from M^-1/2 K M^-1/2, the derivatives are central
differences, and the unknown scale of each measured mode is a parameter of the information matrix.
"""

import numpy as np
import pytest
from scipy import linalg

from cvxshear import identify
from cvxshear.paper.setups import Setup, bound, cramer_rao, six_story, three_story

STEP = 1e-5
"""Relative step of the central differences; their error is of order step^2."""


def modal_data(setup, theta):
    """Return logarithms of the measured frequencies, shape (m,), and measured shapes of unit modal mass, shape (m,
    n)."""
    n = setup.stories
    root = np.sqrt(theta[:n])
    drift = np.eye(n) - np.eye(n, k=-1)
    eigenvalues, vectors = np.linalg.eigh((drift.T * theta[n:]) @ drift / np.outer(root, root))
    shapes = vectors / root[:, None]
    # The largest entry of a mode keeps its sign over a step of the differences.
    shapes = shapes * np.sign(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)])
    which = setup.modes - 1
    return 0.5 * np.log(eigenvalues[which]), shapes[np.ix_(setup.measured_floors - 1, which)].T


def by_differences(setup):
    """Return the smallest standard deviations of an unbiased estimator, shape (2N,)."""

    def stacked(theta):
        frequencies, shapes = modal_data(setup, theta)
        return np.concatenate([frequencies, shapes.ravel()])

    truth = setup.truth
    frequencies, shapes = modal_data(setup, truth)
    spread = np.abs(shapes)
    if setup.mode_shape_noise == "additive":
        spread = np.max(spread, axis=1, keepdims=True)
    std = np.concatenate([
        np.full(len(frequencies), setup.frequency_std),
        np.broadcast_to(setup.mode_shape_std * spread, shapes.shape).ravel(),
    ])  # fmt: skip
    slopes = [(stacked(truth + STEP * row) - stacked(truth - STEP * row)) / (2 * STEP) for row in np.diag(truth)]
    scales = linalg.block_diag(*shapes.reshape(len(shapes), -1, 1))
    J = np.hstack([np.array(slopes).T, np.vstack([np.zeros((len(frequencies), len(shapes))), scales])])
    total = np.concatenate([setup.floor_mass, np.zeros(J.shape[1] - setup.stories)])
    Z = linalg.null_space(total[None])
    root = np.linalg.inv(np.linalg.qr((J / std[:, None]) @ Z, mode="r"))
    return truth * np.linalg.norm((Z @ root)[: len(truth)], axis=1)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_it_is_that_of_difference_quotients_with_the_scales_as_parameters(setup):
    np.testing.assert_allclose(bound(setup), by_differences(setup), rtol=1e-7)


def test_the_papers_frame_at_five_percent():
    setup = three_story(0.05)
    percent = 100 * bound(setup) / setup.truth
    np.testing.assert_allclose(percent, [1.29, 2.72, 1.79, 2.20, 1.39, 0.79], atol=0.005)


def test_the_bound_goes_with_the_noise():
    # The frequencies are known to 1e-5, not exactly, which adds to the stiffnesses' deviations.
    np.testing.assert_allclose(bound(three_story(0.04)), 4 * bound(three_story(0.01)), rtol=5e-4)


def test_one_story_by_hand():
    """The total is the mass, so k = m (2 pi f)^2 has twice the frequency's relative standard deviation."""
    setup = Setup(np.array([3.0]), np.array([500.0]), 0.01, frequency_std=2e-3, exact_frequencies=False)
    np.testing.assert_allclose(bound(setup), [0.0, 500.0 * 2 * 2e-3], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_the_total_mass_has_no_scatter(setup):
    n = setup.stories
    total = np.concatenate([np.ones(n), np.zeros(n)])
    covariance = cramer_rao(setup)
    assert total @ covariance @ total < 1e-12 * np.trace(covariance[:n, :n])


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_at_exact_data_the_efficient_method_states_the_bound(setup):
    frame = identify(setup.experiment(*setup.exact())).frame
    stated = np.concatenate([frame.floor_mass_std, frame.story_stiffness_std])
    np.testing.assert_allclose(by_differences(setup), stated, rtol=1e-4)


def test_a_mode_fewer_tells_less():
    setup = three_story(0.02)
    fewer = Setup(setup.floor_mass, setup.story_stiffness, 0.02, modes=np.array([1, 2]))
    assert np.all(bound(fewer) > bound(setup))
