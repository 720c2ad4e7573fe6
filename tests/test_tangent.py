"""The linearised model at a fit, against fits and finite differences."""

import numpy as np
import pytest

from cvxshear import Experiment, backends
from cvxshear.effects import Place, Placed, named
from cvxshear.identification.efficient import efficient
from cvxshear.identification.misfit import Misfit
from cvxshear.loop.candidates import fit_candidate
from cvxshear.loop.fitter import Fitter
from cvxshear.loop.tangent import Tangent
from tests.frames import configuration, experiment, modes_of

MASS = np.array([21e3, 19e3, 19.5e3, 18e3, 17e3])
STIFFNESS = np.array([30e6, 36e6, 33e6, 27e6, 22e6])
MISSED = 150.0


@pytest.fixture(scope="module")
def base():
    """The shear model fitted to two tests, the second with a small mass at floor 3 that nobody wrote down."""
    rng = np.random.default_rng(0)
    added = np.array([0.0, 2e3, 4e3, 0.0, 6e3])
    first, second = (
        configuration(MASS, STIFFNESS, each, rng=rng, shape_noise=0.01, frequency_noise=0.001) for each in (None, added)
    )
    frequencies, shapes = modes_of(MASS + added + MISSED * np.eye(5)[2], STIFFNESS)
    second["frequencies"] = (frequencies * (1 + 0.001 * rng.standard_normal(5))).tolist()
    second["mode_shapes"] = (shapes + 0.01 * rng.standard_normal(shapes.shape)).tolist()
    of = Experiment.from_dict(experiment(MASS, STIFFNESS, first, second, frame={"total_mass": float(MASS.sum())}))
    return efficient(of, backends.get("auto"))


@pytest.fixture(scope="module")
def placed():
    return Placed(named(["added_mass"])[0], Place(floor=3, configuration="test 2"))


def test_a_candidate_s_own_column_gives_the_slope_of_chi_square(base, placed):
    """By finite differences; the column itself leaves out what the free scales of the shapes follow."""
    column = Tangent(base).sensitivity(placed)
    misfit = Misfit(base.experiment, [placed])
    ahead, behind = (misfit.evaluate(np.append(base.theta, at), derivatives=False).chi2 for at in (1.0, -1.0))
    assert 2 * column[:, 0] @ base.fit.at.r == pytest.approx((ahead - behind) / 2, rel=1e-4)


def test_the_promised_gain_and_the_predicted_minimum_are_those_of_the_fit_for_a_small_effect(base, placed):
    tangent = Tangent(base)
    fitted = fit_candidate(tangent, placed, Fitter(backends.get("auto")), 1e-6).estimate
    assert tangent.score(placed).determined
    assert tangent.score(placed).gain == pytest.approx(base.chi2 - fitted.chi2, rel=0.05)
    np.testing.assert_allclose(tangent.predicted(placed)[:10], fitted.theta[:10], rtol=2e-3)
    assert tangent.predicted(placed)[10] == pytest.approx(fitted.theta[10], rel=0.1)


def test_the_prediction_keeps_the_effect_within_its_bounds(base):
    spring = Placed(named(["ground_spring"])[0], Place(floor=2))
    (parameter,) = spring.effect.parameters
    assert parameter.lower <= Tangent(base).predicted(spring)[-1] <= parameter.upper


def test_the_triangle_of_an_evaluation_stands_for_its_rows(base):
    at = base.fit.at
    U, c = at.triangle
    rng = np.random.default_rng(1)
    steps = base.theta[:, None] * 1e-3 * rng.standard_normal((10, 4))
    rows = np.sum((at.J @ steps + at.r[:, None]) ** 2, axis=0)
    short = np.sum((U @ steps + c[:, None]) ** 2, axis=0)
    np.testing.assert_allclose(np.diff(rows), np.diff(short), rtol=1e-8)
