"""The Cramer-Rao bound against published figures, a frame that can be done by hand, and the estimator's own matrix."""

import numpy as np
import pytest

from cvxshear import identify
from cvxshear.paper.setups import Setup, bound, cramer_rao, six_story, three_story


def test_the_papers_frame_at_five_percent():
    setup = three_story(0.05)
    percent = 100 * bound(setup) / setup.truth
    np.testing.assert_allclose(percent, [1.29, 2.72, 1.79, 2.20, 1.39, 0.79], atol=0.005)


def test_the_bound_goes_with_the_noise():
    # But for what the frequencies, known to 1e-5 and not exactly, add to the stiffnesses.
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
    """Analytic derivatives with the scales eliminated there, differences with the scales as parameters here."""
    frame = identify(setup.experiment(*setup.exact())).frame
    stated = np.concatenate([frame.floor_mass_std, frame.story_stiffness_std])
    np.testing.assert_allclose(bound(setup), stated, rtol=1e-4)


def test_a_mode_fewer_tells_less():
    setup = three_story(0.02)
    fewer = Setup(setup.floor_mass, setup.story_stiffness, 0.02, modes=np.array([1, 2]))
    assert np.all(bound(fewer) > bound(setup))
