"""Random samples have the declared noise."""

import numpy as np
import pytest

from cvxshear import InputError
from cvxshear.paper.setups import Setup, six_story, three_story

MASS, STIFFNESS = np.array([10.0, 7.5, 5.0]), np.array([1800.0, 1200.0, 600.0])


def test_the_exact_modes_are_those_of_the_paper():
    frequencies, shapes = three_story(0.01).exact()
    np.testing.assert_allclose(frequencies, [1.0336, 2.2099, 3.2812], atol=5e-5)
    np.testing.assert_allclose(np.max(np.abs(shapes), axis=1), 1.0)
    np.testing.assert_allclose((shapes * MASS) @ shapes.T * (1 - np.eye(3)), 0.0, atol=1e-12)


def test_multiplicative_noise_goes_with_the_entry_and_the_frequencies_stay_exact():
    setup = three_story(0.04)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(5), 4000)
    assert np.all(frequencies == exact_frequencies)
    # The standard deviation of 4000 samples scatters by 1.1 %.
    np.testing.assert_allclose((shapes / exact).std(axis=0), 0.04, rtol=0.05)


def test_additive_noise_goes_with_the_largest_entry():
    setup = six_story(0.02)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(6), 4000)
    np.testing.assert_allclose((shapes - exact).std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose((frequencies / exact_frequencies).std(axis=0), 1e-3, rtol=0.05)
    assert exact.shape == (4, 5)


def test_an_experiment_declares_noise_total_floors_and_modes():
    setup = six_story()
    experiment = setup.experiment(*setup.exact())
    configuration = experiment.configurations[0]
    assert experiment.frame.total_mass == pytest.approx(52.0)
    assert configuration.modes.tolist() == [1, 2, 3, 4]
    assert configuration.measured_floors.tolist() == [1, 2, 4, 5, 6]
    assert experiment.noise_declared
    assert np.all(configuration.mode_shape_std == 0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"floor_mass": [10.0, -7.5, 5.0]}, "floor_mass"),
        ({"story_stiffness": [1800.0, 1200.0]}, "story_stiffness"),
        ({"mode_shape_std": 0.0}, "mode_shape_std"),
        ({"mode_shape_noise": "multiplied"}, "mode_shape_noise"),
        ({"modes": [1, 4]}, "modes"),
        ({"measured_floors": [2, 1]}, "measured_floors"),
    ],
)
def test_a_setup_that_is_none_is_refused(change, message):
    given = {"floor_mass": MASS, "story_stiffness": STIFFNESS, "mode_shape_std": 0.01, **change}
    with pytest.raises(InputError, match=message):
        Setup(**given)
