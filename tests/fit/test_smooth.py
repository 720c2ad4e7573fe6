"""Test tall frames measured at few floors: the start among smooth frames, and damped steps if plain steps fail."""

import numpy as np
import pytest

from cvxshear import Experiment, backends, identify
from cvxshear.fit.domain import domain_of
from cvxshear.fit.efficient import fitted
from cvxshear.fit.gauss_newton import gauss_newton
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import smooth_start, uniform
from tests.frames import configuration, experiment


def tall(stories, modes, every, seed=3, *, rough=True, frame=None):
    """Return a frame that grows lighter and softer upwards, measured at some floors, with its true parameters."""
    rng = np.random.default_rng(seed)
    mass, stiffness = np.linspace(3e4, 2e4, stories), np.linspace(8e8, 3e8, stories)
    if rough:
        mass, stiffness = mass * rng.uniform(0.95, 1.05, stories), stiffness * rng.uniform(0.9, 1.1, stories)
    test = configuration(
        mass, stiffness, rng=rng, shape_noise=0.01, frequency_noise=0.001,
        modes=list(range(1, modes + 1)), measured_floors=list(range(every, stories + 1, every)),
    )  # fmt: skip
    of = Experiment.from_dict(experiment(mass, stiffness, test, frame=frame and frame(mass)))
    return of, np.concatenate([mass, stiffness])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("stories", "modes", "every"), [(20, 5, 2), (30, 8, 3), (50, 10, 4)])
def test_a_tall_frame_measured_at_few_floors_is_fitted_to_its_noise(stories, modes, every, seed):
    """Start from any point, and from the smooth frame alone. The truth has a chi-square near the number of data."""
    of, truth = tall(stories, modes, every, seed)
    found = identify(of)
    at_truth = Misfit(of).evaluate(truth).chi2
    assert found.converged
    assert found.fit.chi2 <= at_truth
    smooth = fitted(Misfit(of), smooth_start(of, uniform(of)), backends.get("auto"))
    assert smooth.chi2 <= at_truth


def test_what_few_floors_leave_open_is_said():
    """Ten frequencies and shapes at twelve floors do not determine a hundred parameters."""
    found = identify(tall(50, 10, 4)[0])
    assert found.undetermined
    assert None in found.to_dict()["frame"]["story_stiffness"]


def test_the_smooth_start_finds_a_smooth_frame():
    of, truth = tall(40, 8, 2, rough=False)
    start = smooth_start(of, uniform(of))
    np.testing.assert_allclose(start[:40], truth[:40], rtol=0.03)
    np.testing.assert_allclose(start[40:], truth[40:], rtol=0.03)
    assert start[:40].sum() == pytest.approx(truth[:40].sum(), rel=1e-12)


def test_known_floor_masses_stay_as_they_are():
    of, truth = tall(20, 5, 2, frame=lambda mass: {"floor_masses": mass.tolist()})
    start = smooth_start(of, uniform(of))
    np.testing.assert_allclose(start[:20], truth[:20], rtol=1e-12)
    assert np.std(start[20:] / truth[20:]) < 0.1


def test_a_step_that_a_plain_one_would_take_too_far_is_damped():
    """Gauss-Newton alone makes no progress at this start: no halving of its step lowers the misfit enough."""
    of, truth = tall(30, 8, 3)
    misfit, start = Misfit(of), uniform(of, taper=0.6)
    fit = gauss_newton(misfit, start, domain_of(of, (), start), backends.get("auto"))
    assert fit.converged
    assert fit.at.chi2 < misfit.evaluate(truth).chi2 < misfit.evaluate(start).chi2 / 100
